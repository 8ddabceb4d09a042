//! Lenses and sensors that differ from episode to episode.

use hal::{Distortion, Intrinsics};
use serde::{Deserialize, Serialize};
use trocar_render::Optics;
use trocar_world::rng::Rng;

use super::Variation;
use crate::task::CameraConfig;

/// By which share the ray in the furthest corner of the pinhole's picture is moved outwards by the
/// radial distortion of the second power: inwards mostly, as endoscopes do. `k1` follows from it
/// and the field of view.
const RADIAL: [f64; 2] = [-0.12, 0.02];
/// The same of the fourth power, `k2`.
const RADIAL_FOURTH: [f64; 2] = [0.0, 0.03];
/// Greatest `p1` and `p2` either way.
const TANGENTIAL: f64 = 0.004;
/// Greatest share of the light that the corner loses.
const VIGNETTE: f64 = 0.5;
/// Greatest factor of the exposure, and one over the least; evenly in its logarithm.
const EXPOSURE_FACTOR: f64 = 1.4;
/// Greatest noise of a brightness of 1, of that brightness.
const SHOT_NOISE: f64 = 0.03;
/// Greatest noise of the dark.
const READ_NOISE: f64 = 0.004;
/// In which share of the episodes there is smoke, and blood and condensate on each lens.
const DIRTY: f64 = 0.3;
/// Most smoke, 1/m: over 12 cm it takes 45 % of the light.
const SMOKE_PER_M: f64 = 5.0;
/// Most blood; see [`Optics::blood`].
const BLOOD: f64 = 0.6;
/// Most condensate; see [`Optics::fog`].
const FOG: f64 = 0.5;

/// What the lens and the sensor of one camera are like in an episode; see [`Optics`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Lens {
    /// The lens' distortion, the scene file's included: `k1`, `k2`, `p1`, `p2` of [`Distortion`].
    pub distortion: [f64; 4],
    /// Share of the light that is lost in the corner, the scene file's included.
    pub vignette: f64,
    /// Factor of the light that the sensor collects.
    pub exposure: f64,
    /// Noise of a brightness of 1.
    pub shot_noise: f64,
    /// Noise of the dark.
    pub read_noise: f64,
    /// Smoke, 1/m; 0 in most episodes, the same for all cameras.
    pub smoke_per_m: f64,
    /// Blood on the lens; 0 in most episodes.
    pub blood: f64,
    /// Condensate on the lens; 0 in most episodes.
    pub fog: f64,
    /// Chooses spots, plumes and noise.
    pub seed: u32,
}

impl Lens {
    /// That of `camera` in the episode `seed`. No camera's depends on what others there are.
    pub(super) fn draw(seed: u64, camera: &CameraConfig) -> Self {
        let intrinsics = camera.intrinsics();
        let mut air = Rng::stream(seed, "smoke");
        let mut rng = Rng::stream(seed, &format!("lens {}", camera.name));
        let corner =
            |centre: f64, size: u32, focal: f64| centre.max(f64::from(size) - centre) / focal;
        let r2 = corner(intrinsics.cx, intrinsics.width, intrinsics.fx).powi(2)
            + corner(intrinsics.cy, intrinsics.height, intrinsics.fy).powi(2);
        let [k1, k2, p1, p2] = intrinsics.distortion.coefficients();
        let mut within = |[low, high]: [f64; 2]| rng.range(low, high);
        Self {
            distortion: [
                k1 + within(RADIAL) / r2,
                k2 + within(RADIAL_FOURTH) / (r2 * r2),
                p1 + within([-TANGENTIAL, TANGENTIAL]),
                p2 + within([-TANGENTIAL, TANGENTIAL]),
            ],
            // Of what the lens of the scene file lets through.
            vignette: camera.vignette + (1.0 - camera.vignette) * within([0.0, VIGNETTE]),
            exposure: within([-1.0, 1.0].map(|it| it * EXPOSURE_FACTOR.ln())).exp(),
            shot_noise: within([0.0, SHOT_NOISE]),
            read_noise: within([0.0, READ_NOISE]),
            smoke_per_m: sometimes(&mut air, SMOKE_PER_M),
            blood: sometimes(&mut rng, BLOOD),
            fog: sometimes(&mut rng, FOG),
            seed: u32::try_from(rng.next_u64() >> 32).unwrap_or_default(),
        }
    }

    /// What is left of it with the effects in `varied` alone, on `camera`, which is what it is
    /// without them.
    pub(super) fn with(self, varied: &[Variation], camera: &CameraConfig) -> Self {
        let has = |effect| varied.contains(&Variation::Lens) || varied.contains(&effect);
        let or = |effect, drawn: f64, none: f64| if has(effect) { drawn } else { none };
        Self {
            distortion: if has(Variation::Distortion) {
                self.distortion
            } else {
                camera.distortion
            },
            vignette: or(Variation::Vignette, self.vignette, camera.vignette),
            exposure: or(Variation::Exposure, self.exposure, 1.0),
            shot_noise: or(Variation::Noise, self.shot_noise, 0.0),
            read_noise: or(Variation::Noise, self.read_noise, 0.0),
            smoke_per_m: or(Variation::Smoke, self.smoke_per_m, 0.0),
            blood: or(Variation::Blood, self.blood, 0.0),
            fog: or(Variation::Fog, self.fog, 0.0),
            seed: self.seed,
        }
    }

    /// `intrinsics` with this distortion.
    pub(crate) const fn of(&self, intrinsics: &Intrinsics) -> Intrinsics {
        Intrinsics {
            distortion: Distortion::new(self.distortion),
            ..*intrinsics
        }
    }

    /// What else it does to pictures.
    pub(crate) const fn optics(&self) -> Optics {
        Optics {
            vignette: self.vignette,
            exposure: self.exposure,
            shot_noise: self.shot_noise,
            read_noise: self.read_noise,
            smoke_per_m: self.smoke_per_m,
            blood: self.blood,
            fog: self.fog,
            seed: self.seed,
            moment: 0,
        }
    }
}

/// 0, or in [`DIRTY`] of the cases anything up to `most`.
fn sometimes(rng: &mut Rng, most: f64) -> f64 {
    let (is_dirty, amount) = (rng.chance(DIRTY), rng.range(0.0, most));
    if is_dirty { amount } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::TaskConfig;

    /// For one seed an effect alone is what it is among all, and the rest is as if nothing were
    /// varied.
    #[test]
    fn a_single_effect_is_that_of_all_together() {
        let task = |varied: &[Variation]| {
            let task = TaskConfig::shipped("needle-lift");
            task.with_variations(varied).unwrap()
        };
        let amounts = |lens: &Lens| {
            [
                (Variation::Vignette, lens.vignette),
                (Variation::Exposure, lens.exposure),
                (Variation::Noise, lens.shot_noise),
                (Variation::Noise, lens.read_noise),
                (Variation::Smoke, lens.smoke_per_m),
                (Variation::Blood, lens.blood),
                (Variation::Fog, lens.fog),
            ]
        };
        let whole = task(&[Variation::Smoke, Variation::Lens]);
        assert_eq!(whole.varied, [Variation::Lens]);
        for effect in Variation::EFFECTS {
            let single = task(&[effect]);
            assert_eq!(single.varied, [effect]);
            for (seed, camera) in
                (0..20).flat_map(|seed| single.cameras.iter().map(move |it| (seed, it)))
            {
                let [found, all] =
                    [&single, &whole].map(|task| task.drawn(seed).lenses[&camera.name].clone());
                let distortion = if effect == Variation::Distortion {
                    all.distortion
                } else {
                    camera.distortion
                };
                assert_eq!((found.distortion, found.seed), (distortion, all.seed));
                for ((which, found), (_, all)) in amounts(&found).into_iter().zip(amounts(&all)) {
                    let none = f64::from(u8::from(which == Variation::Exposure));
                    let wanted = if which == effect { all } else { none };
                    assert_eq!(
                        found.to_bits(),
                        wanted.to_bits(),
                        "seed {seed}: {effect:?}, {which:?}"
                    );
                }
            }
        }
    }

    #[test]
    fn lenses_keep_to_their_bounds_and_use_them() {
        let task = TaskConfig::shipped("needle-lift");
        let task = task.with_variations(&[Variation::Lens]).unwrap();
        let mut extremes = [[0.5_f64; 2]; 11];
        let mut dirty = [0_u32; 3];
        for seed in 0..2000 {
            let drawn = task.drawn(seed).lenses;
            assert_eq!(drawn.len(), task.cameras.len());
            for camera in &task.cameras {
                let (lens, intrinsics) = (&drawn[&camera.name], camera.intrinsics());
                let folds = seed % 20 == 0 && lens.of(&intrinsics).field().is_none();
                assert!(!folds, "seed {seed}");
                let r = 0.5 * 512.0 / intrinsics.fx;
                let r2 = 2.0 * r * r;
                let [k1, k2, p1, p2] = lens.distortion;
                let share = |value: f64, [low, high]: [f64; 2]| (value - low) / (high - low);
                let either = [-TANGENTIAL, TANGENTIAL];
                let log = EXPOSURE_FACTOR.ln();
                let shares = [
                    share(k1 * r2, RADIAL),
                    share(k2 * r2 * r2, RADIAL_FOURTH),
                    share(p1, either),
                    share(p2, either),
                    lens.vignette / VIGNETTE,
                    share(lens.exposure.ln(), [-log, log]),
                    lens.shot_noise / SHOT_NOISE,
                    lens.read_noise / READ_NOISE,
                    lens.smoke_per_m / SMOKE_PER_M,
                    lens.blood / BLOOD,
                    lens.fog / FOG,
                ];
                for (value, [low, high]) in shares.into_iter().zip(&mut extremes) {
                    assert!(
                        (-1e-9..=1.0 + 1e-9).contains(&value),
                        "seed {seed}: {value}"
                    );
                    (*low, *high) = (low.min(value), high.max(value));
                }
                let amounts = [lens.smoke_per_m, lens.blood, lens.fog];
                for (count, amount) in dirty.iter_mut().zip(amounts) {
                    *count += u32::from(amount > 0.0);
                }
            }
            let smoke = drawn.values().map(|lens| lens.smoke_per_m.to_bits());
            assert_eq!(smoke.collect::<std::collections::BTreeSet<_>>().len(), 1);
        }
        for [low, high] in extremes {
            assert!(low < 0.02 && high > 0.98, "{low} {high}");
        }
        assert!(
            dirty.iter().all(|count| (1500..2100).contains(count)),
            "{dirty:?}"
        );
    }
}
