//! A patient of a seed.
//!
//! The deformation maps world to nominal: `(p + sum of by_i sin(along_i . p + phase_i)) / scale`
//! over three waves. A wave's Jacobian has the norm `|by| |along|`, at most
//! `4.5 sqrt(3) * 2 pi / 260` = 0.19, so three of them stay below 1: the map is a diffeomorphism,
//! and voxels are looked up by it without inverting anything.
//!
//! Organs move by up to 4 mm along each axis and vary by -14 to 5 % in size; if the lattice test
//! finds that two might overlap, the same variation is tried at three quarters, a half, a quarter
//! and not at all.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use hal::random::SplitMix64;

use super::anatomy::{self, CARVES, Part};

/// Spacing of the points at which parts are compared, mm.
const LATTICE_MM: f64 = 3.0;

/// Two parts that both come this near to a point of the lattice might overlap: half of a cell's
/// diagonal.
const NEAR_MM: f64 = 2.6;

/// One wave of the deformation.
///
/// Moves points by a sine of the place.
#[derive(Clone, Debug)]
struct Wave {
    /// Radians per mm.
    along: Vector3<f64>,
    /// Radians.
    phase: f64,
    /// How far it moves at its crest, mm.
    by: Vector3<f64>,
}

/// A part with the box around it, nominal mm.
#[derive(Clone, Debug)]
pub(super) struct Placed {
    pub(super) part: Part,
    /// The lower corner of the box.
    low: Vector3<f64>,
    /// The upper corner of the box.
    high: Vector3<f64>,
}

impl Placed {
    /// The box is cut at the heights between which the part is.
    fn new(part: Part) -> Self {
        let [mut low, mut high] = part.shape.bounds();
        if let Some([below, above]) = part.between {
            low.z = low.z.max(below);
            high.z = high.z.min(above);
        }
        Self { part, low, high }
    }

    /// Distance from its surface, negative inside, or something above `far` if it is farther than
    /// that.
    fn distance(&self, p: &Point3<f64>, far: f64) -> f64 {
        let outside = (self.low - p.coords).sup(&(p.coords - self.high)).max();
        if outside > far {
            return outside;
        }
        let d = self.part.shape.distance(p);
        self.part
            .between
            .map_or(d, |[below, above]| d.max(below - p.z).max(p.z - above))
    }

    /// Whether `p` is in it. Heights at which it ends belong to it below and not above.
    pub(super) fn contains(&self, p: &Point3<f64>) -> bool {
        let inside = p.coords >= self.low && p.coords < self.high;
        let height = self
            .part
            .between
            .is_none_or(|[below, above]| (below..above).contains(&p.z));
        inside && height && self.part.shape.distance(p) < 0.0
    }

    /// Whether its box has points from `low` to `high` along `axis`.
    pub(super) fn reaches(&self, axis: usize, low: f64, high: f64) -> bool {
        self.low[axis] <= high && self.high[axis] >= low
    }
}

/// The shapes of a seed and how they lie in the world.
#[derive(Clone, Debug)]
pub struct Patient {
    /// Its seed.
    pub seed: u64,
    /// How much larger than the nominal anatomy, along x, y and z.
    pub scale: [f64; 3],
    /// How much wider and deeper than without fat.
    pub fat: f64,
    /// The share of the variation of organs that was possible: 1, or less if they would have
    /// overlapped.
    pub variation: f64,
    /// In the order in which later ones carve earlier ones.
    pub(super) parts: Vec<Placed>,
    /// Three.
    waves: Vec<Wave>,
}

/// The nominal parts, varied by `share` of what `random` says.
///
/// Always draws the same numbers, whatever `share` is, so that smaller shares are the same patient
/// less varied.
fn varied(mut random: SplitMix64, share: f64) -> Vec<Placed> {
    anatomy::parts()
        .into_iter()
        .map(|mut part| {
            let by = Vector3::from_fn(|_, _| 4.0 * share * random.signed_unit());
            let size = 1.0 + share * random.between(-0.14, 0.05);
            if part.varies {
                part.shape = part.shape.varied(&by, size);
            } else if part.between.is_none() {
                // Bones and vessels stay where they are.
                part.shape = part
                    .shape
                    .varied(&Vector3::zeros(), 1.0 - share * random.between(0.0, 0.12));
            }
            Placed::new(part)
        })
        .collect()
}

/// Whether parts may overlap: the later carves the earlier.
fn may_carve(later: &str, earlier: &str) -> bool {
    let vertebrae = later.starts_with("vertebra") || later == "sacrum";
    vertebrae && earlier.starts_with("vertebra") || CARVES.contains(&(later, earlier))
}

/// Two parts that might overlap and must not, or one that might leave the torso; by name.
///
/// None is proof that there are none, as far as distances change no faster than places do.
///
/// The lattice is 3 mm, so each point is within 2.6 mm of one of its own; two solids with a common
/// point both come that near to it. Planes run in parallel, and the first conflict in their order
/// is given.
fn conflict(parts: &[Placed]) -> Option<(String, String)> {
    let heights: Vec<i32> = (-100..=100).collect();
    heights.par_iter().find_map_first(|&height| {
        let z = f64::from(height) * LATTICE_MM;
        let near: Vec<&Placed> = parts
            .iter()
            .filter(|part| part.reaches(2, z - NEAR_MM, z + NEAR_MM))
            .collect();
        (-40..=40).find_map(|j| conflict_in_row(&near, f64::from(j) * LATTICE_MM, z))
    })
}

/// Only parts whose boxes reach the row are asked. The skin counts as in the leanest patient.
fn conflict_in_row(parts: &[&Placed], y: f64, z: f64) -> Option<(String, String)> {
    let here = |part: &&&Placed| part.reaches(1, y - NEAR_MM, y + NEAR_MM);
    let parts: Vec<&Placed> = parts.iter().filter(here).copied().collect();
    let mut close: Vec<&Placed> = Vec::new();
    (-58..=58).find_map(|i| {
        let p = Point3::new(f64::from(i) * LATTICE_MM, y, z);
        close.clear();
        close.extend(
            parts
                .iter()
                .filter(|part| part.distance(&p, NEAR_MM) <= NEAR_MM),
        );
        let name = |part: &Placed| part.part.name.clone();
        if let Some(first) = close.first()
            && anatomy::torso_distance(&p, 1.0) > -NEAR_MM
        {
            return Some((name(first), "the skin".to_owned()));
        }
        close.iter().enumerate().find_map(|(k, later)| {
            let earlier = close[..k]
                .iter()
                .find(|earlier| !may_carve(&later.part.name, &earlier.part.name))?;
            Some((name(later), name(earlier)))
        })
    })
}

impl Patient {
    /// The patient of `seed`; any seed has one.
    ///
    /// Costs up to five searches for conflicts, on all cores.
    #[must_use]
    pub fn new(seed: u64) -> Self {
        let mut random = SplitMix64::named("patient", seed);
        let scale = [
            random.between(0.9, 1.1),
            random.between(0.92, 1.15),
            random.between(0.94, 1.06),
        ];
        let fat = random.between(1.0, 1.12);
        let waves = (0..3).map(|_| wave(&mut random)).collect();
        let organs = SplitMix64::named("organs", seed);
        // The nominal anatomy itself, at the end, has no conflict; a test says so.
        let shares = [1.0, 0.75, 0.5, 0.25, 0.0];
        let found = shares.iter().find_map(|&share| {
            let parts = varied(organs.clone(), share);
            conflict(&parts).is_none().then_some((parts, share))
        });
        let (parts, variation) = found.unwrap_or_else(|| (varied(organs, 0.0), 0.0));
        Self {
            seed,
            scale,
            fat,
            variation,
            parts,
            waves,
        }
    }

    /// The point of the nominal anatomy that is at `p` of the world, mm.
    pub(super) fn nominal(&self, p: &Point3<f64>) -> Point3<f64> {
        let bent = self.waves.iter().fold(p.coords, |sum, wave| {
            sum + wave.by * (wave.along.dot(&p.coords) + wave.phase).sin()
        });
        Point3::from(bent.component_div(&Vector3::from(self.scale)))
    }

    /// How far nominal and world points differ at most along an axis, besides the scale, mm.
    pub(super) fn bend_mm(&self) -> f64 {
        self.waves.iter().map(|wave| wave.by.amax()).sum()
    }

    /// The part that a nominal point belongs to, by index, and whether one lies in several that
    /// must not overlap.
    pub(super) fn part_at(&self, p: &Point3<f64>, near: &[usize]) -> (Option<usize>, bool) {
        let mut found: Option<usize> = None;
        let mut overlap = false;
        for &index in near {
            if !self.parts[index].contains(p) {
                continue;
            }
            if let Some(earlier) = found {
                overlap |= !may_carve(&self.parts[index].part.name, &self.parts[earlier].part.name);
            }
            found = Some(index);
        }
        (found, overlap)
    }
}

/// Lengths are 260 to 420 mm, in a direction that is even over the sphere.
fn wave(random: &mut SplitMix64) -> Wave {
    let direction = Vector3::from_fn(|_, _| random.normal());
    let length_mm = random.between(260.0, 420.0);
    Wave {
        along: direction.normalize() * (std::f64::consts::TAU / length_mm),
        phase: random.between(0.0, std::f64::consts::TAU),
        by: Vector3::from_fn(|_, _| 4.5 * random.signed_unit()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn nominal_anatomy_has_no_conflict() {
        let found = conflict(&varied(SplitMix64::new(0), 0.0));
        assert_eq!(found, None);
    }
}
