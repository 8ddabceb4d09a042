//! What is drawn anew for each episode beyond the places of things: the needle, the cameras'
//! places, light and colours, lenses.

mod lens;

use std::collections::BTreeMap;

use hal::TipTarget;
use nalgebra::{Translation3, UnitQuaternion};
use serde::{Deserialize, Serialize};
use trocar_render::Light;
use trocar_world::rng::Rng;

use super::{TaskConfig, TaskScene, View, scene_visuals};

pub use lens::Lens;

/// What can be varied.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Variation {
    /// The needle is one of those of the scene file that come to rest on the ground, each as
    /// likely.
    Needles,
    /// Cameras stand as in [`View::View1`].
    Views,
    /// Light and colours differ within the bounds of [`Appearance`].
    Light,
    /// All of [`Self::EFFECTS`] differ within the bounds of [`Lens`].
    Lens,
    /// The lens' distortion alone, as it is with [`Self::Lens`].
    Distortion,
    /// The light that the corners lose.
    Vignette,
    /// The light that the sensor collects.
    Exposure,
    /// The sensor's noise.
    Noise,
    /// Smoke before the lens.
    Smoke,
    /// Blood on the lens.
    Blood,
    /// Condensate on the lens.
    Fog,
}

impl Variation {
    /// All that there is to vary.
    pub const ALL: [Self; 4] = [Self::Needles, Self::Views, Self::Light, Self::Lens];

    /// The single effects that [`Self::Lens`] has together.
    pub const EFFECTS: [Self; 7] = [
        Self::Distortion,
        Self::Vignette,
        Self::Exposure,
        Self::Noise,
        Self::Smoke,
        Self::Blood,
        Self::Fog,
    ];

    /// The name on the command line and in results.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Needles => "needles",
            Self::Views => "views",
            Self::Light => "light",
            Self::Lens => "lens",
            Self::Distortion => "distortion",
            Self::Vignette => "vignette",
            Self::Exposure => "exposure",
            Self::Noise => "noise",
            Self::Smoke => "smoke",
            Self::Blood => "blood",
            Self::Fog => "fog",
        }
    }
}

/// Something was to be varied that a task has no choice of.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{task} {}; it can vary {}", refusal(*variation), names(can))]
pub struct CannotVary {
    /// The task.
    pub task: String,
    /// The requested one.
    pub variation: Variation,
    /// What can be varied.
    pub can: Vec<Variation>,
}

const fn refusal(variation: Variation) -> &'static str {
    match variation {
        Variation::Needles => "has no choice of needles",
        Variation::Views => "has its cameras moved by the view already",
        Variation::Light => "has no light",
        Variation::Lens
        | Variation::Distortion
        | Variation::Vignette
        | Variation::Exposure
        | Variation::Noise
        | Variation::Smoke
        | Variation::Blood
        | Variation::Fog => "has no lens",
    }
}

fn names(variations: &[Variation]) -> String {
    let names: Vec<_> = variations.iter().map(|it| it.name()).collect();
    names.join(", ")
}

/// How far the end of the light guide is moved along the lens' x and y at most, m.
const GUIDE_SHIFT_M: f64 = 0.02;
/// How far it is turned about these axes at most, rad.
const GUIDE_TURN_RAD: f64 = 0.12;
/// Greatest factor of the brightness of the guide, and one over the least; evenly in its logarithm.
const INTENSITY_FACTOR: f64 = 1.6;
/// The same of the light from all around.
const AMBIENT_FACTOR: f64 = 1.6;
/// Greatest warmth either way: by this share red is raised and blue lowered. 0.2 is about 5100 K,
/// -0.2 about 9000 K, where the file's light counts as 6500 K.
const WARMTH: f64 = 0.2;
/// Greatest factor of a surface's colour, one for all three channels, and one over the least.
const BRIGHTNESS_FACTOR: f64 = 1.25;
/// By how much each channel of a surface's colour is raised or lowered besides.
const TINT: f64 = 0.1;

/// How an episode is lit and coloured, against the scene file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Appearance {
    /// By how much the end of the light guide is moved along the lens' x and y, m.
    pub guide_shift_m: [f64; 2],
    /// By how much it is turned about them, rad.
    pub guide_turn_rad: [f64; 2],
    /// Factor of the guide's brightness.
    pub intensity: f64,
    /// Factor of the brightness of the light from all around.
    pub ambient: f64,
    /// See [`Light::warmth`].
    pub warmth: f64,
    /// Factors of the colours, linear RGB, by the name of what has them.
    pub tints: BTreeMap<String, [f32; 3]>,
}

impl Appearance {
    fn draw(seed: u64, things: &[&'static str]) -> Self {
        let mut rng = Rng::stream(seed, "light");
        let mut about = |half: f64| rng.range(-half, half);
        let guide_shift_m = [about(GUIDE_SHIFT_M), about(GUIDE_SHIFT_M)];
        let guide_turn_rad = [about(GUIDE_TURN_RAD), about(GUIDE_TURN_RAD)];
        Self {
            guide_shift_m,
            guide_turn_rad,
            intensity: about(INTENSITY_FACTOR.ln()).exp(),
            ambient: about(AMBIENT_FACTOR.ln()).exp(),
            warmth: about(WARMTH),
            tints: things
                .iter()
                .map(|&name| (name.to_owned(), tint(seed, name)))
                .collect(),
        }
    }

    /// `light` as this episode has it.
    pub(crate) fn lit(&self, light: &Light) -> Light {
        let [x, y] = self.guide_shift_m;
        let [a, b] = self.guide_turn_rad;
        let turn = UnitQuaternion::from_euler_angles(a, b, 0.0);
        Light {
            guide_in_scene: light.guide_in_scene * Translation3::new(x, y, 0.0) * turn,
            intensity: light.intensity * self.intensity,
            ambient: light.ambient * self.ambient,
            warmth: self.warmth,
            ..*light
        }
    }

    /// Factors of the colours of the visuals called `names`.
    pub(crate) fn tints_of(&self, names: &[&'static str]) -> Vec<[f32; 3]> {
        let tint = |&name| self.tints.get(name).copied().unwrap_or([1.0; 3]);
        names.iter().map(tint).collect()
    }
}

/// What is called alike looks alike; no tint depends on what else there is.
fn tint(seed: u64, name: &str) -> [f32; 3] {
    let mut rng = Rng::stream(seed, &format!("tint {name}"));
    let bright = rng.range(-1.0, 1.0) * BRIGHTNESS_FACTOR.ln();
    [(); 3].map(|()| {
        #[expect(clippy::cast_possible_truncation, reason = "colours are f32")]
        let factor = (bright.exp() * (1.0 + rng.range(-TINT, TINT))) as f32;
        factor
    })
}

/// What was drawn for one episode.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Drawn {
    /// The needle, if that is varied.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub needle: Option<String>,
    /// By how much the standing cameras are moved, if they are: place (m) and quaternion x, y, z, w
    /// of each in its frame of the scene file.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub cameras: BTreeMap<String, [f64; 7]>,
    /// Light and colours, if they are varied.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub light: Option<Appearance>,
    /// Lens and sensor of each camera, if any of their effects is varied.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub lenses: BTreeMap<String, Lens>,
}

impl TaskConfig {
    /// The same task, in which `variations` are drawn anew for each episode; single effects of
    /// lenses go without saying beside [`Variation::Lens`].
    ///
    /// # Errors
    /// [`CannotVary`] for needles of a task that has one only, and for views of one that is not
    /// seen from [`View::Train`].
    pub fn with_variations(mut self, variations: &[Variation]) -> Result<Self, CannotVary> {
        let can = |task: &Self, variation| match variation {
            Variation::Needles => task.scene.needles().len() > 1,
            Variation::Views => task.view == View::Train,
            Variation::Light
            | Variation::Lens
            | Variation::Distortion
            | Variation::Vignette
            | Variation::Exposure
            | Variation::Noise
            | Variation::Smoke
            | Variation::Blood
            | Variation::Fog => true,
        };
        for &variation in variations {
            if !can(&self, variation) {
                let others = Variation::ALL.into_iter();
                return Err(CannotVary {
                    variation,
                    can: others.filter(|&other| can(&self, other)).collect(),
                    task: self.name,
                });
            }
        }
        let effects = Variation::EFFECTS.into_iter();
        let effects = effects.filter(|_| !variations.contains(&Variation::Lens));
        self.varied = Variation::ALL
            .into_iter()
            .chain(effects)
            .filter(|variation| variations.contains(variation))
            .collect();
        if self.varied.contains(&Variation::Views) {
            self.view = View::View1;
        }
        if self.varied.contains(&Variation::Needles) {
            self.needles_drawn = self.resting_needles();
        }
        Ok(self)
    }

    /// What is drawn for the episode `seed`.
    #[must_use]
    pub fn drawn(&self, seed: u64) -> Drawn {
        let varies = |variation| self.varied.contains(&variation);
        let moved = self
            .cameras
            .iter()
            .filter(|camera| varies(Variation::Views) && camera.carrier().is_none());
        Drawn {
            needle: self.drawn_needle(seed),
            cameras: moved
                .map(|camera| {
                    let shift = self.view.shift(camera, seed);
                    let numbers = TipTarget::new(&shift, 0.0).pose_numbers();
                    (camera.name.clone(), numbers)
                })
                .collect(),
            light: varies(Variation::Light).then(|| {
                let visuals = scene_visuals(self);
                let names: Vec<_> = visuals.iter().map(|visual| visual.name).collect();
                Appearance::draw(seed, &names)
            }),
            lenses: self
                .cameras
                .iter()
                .filter(|_| varies(Variation::Lens) || Variation::EFFECTS.into_iter().any(varies))
                .map(|camera| {
                    let lens = Lens::draw(seed, camera);
                    (camera.name.clone(), lens.with(&self.varied, camera))
                })
                .collect(),
        }
    }

    /// What is particular to the task in the episode `seed`.
    pub(crate) fn scene_of(&self, seed: u64) -> Box<dyn TaskScene> {
        let mut scene = self.scene.clone();
        if let Some(needle) = self.drawn_needle(seed) {
            // It is one of the scene's needles.
            let _chosen = scene.choose_needle(&needle);
        }
        scene
    }

    fn drawn_needle(&self, seed: u64) -> Option<String> {
        if !self.varied.contains(&Variation::Needles) {
            return None;
        }
        let mut needles = self.needles_drawn.clone();
        let index = Rng::stream(seed, "needle variant").below(needles.len());
        (index < needles.len()).then(|| needles.swap_remove(index))
    }
}

#[cfg(test)]
mod tests;
