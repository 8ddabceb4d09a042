//! The organ surface: a gently rolling patch of back muscle, or a table of heights, as a height
//! over the xy-plane.

mod drawn;

use core::f64::consts::TAU;
use std::sync::Arc;

use hal::config::{ConfigError, Source};
use nalgebra::{Unit, Vector3};
use serde::Deserialize;

use crate::tissue::Ground;

/// What things lie on.
#[derive(Clone, Debug)]
pub enum Organ {
    /// A rolling patch on a table.
    Rolling(OrganShape),
    /// Heights that were measured; around them there is nothing.
    Measured(Arc<Ground>),
}

/// A rectangular patch around the scene's origin whose height is a sum of three waves.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OrganShape {
    /// Extent along x, m.
    pub length_m: f64,
    /// Extent along y, m.
    pub width_m: f64,
    /// Bound on the height's distance from zero, m.
    pub amplitude_m: f64,
    /// Longest wavelength, m.
    pub wavelength_m: f64,
}

/// Height that stands for a measured organ where it does not reach, m: what is above that place has
/// fallen off.
const OFF_M: f64 = -1.0;

impl Organ {
    /// Height of the surface above the scene's xy-plane at (`x`, `y`), m; of a measured one -1 m
    /// beyond it.
    #[must_use]
    pub fn height_m(&self, x: f64, y: f64) -> f64 {
        match self {
            Self::Rolling(shape) => shape.height_m(x, y),
            Self::Measured(ground) => ground.height_m(x, y).unwrap_or(OFF_M),
        }
    }

    /// Unit normal of the surface at (`x`, `y`), pointing up, scene frame.
    #[must_use]
    pub fn normal(&self, x: f64, y: f64) -> Unit<Vector3<f64>> {
        match self {
            Self::Rolling(shape) => shape.normal(x, y),
            Self::Measured(ground) => ground
                .normal(x, y)
                .map_or_else(Vector3::z_axis, Unit::new_unchecked),
        }
    }

    /// Whether there is a surface over (`x`, `y`).
    #[must_use]
    pub fn covers(&self, x: f64, y: f64) -> bool {
        match self {
            Self::Rolling(shape) => shape.covers(x, y),
            Self::Measured(ground) => ground.height_m(x, y).is_some(),
        }
    }
}

/// One wave: share of the amplitude, waves per longest wavelength along x and y, phase.
const WAVES: [(f64, f64, f64, f64); 3] = [
    (0.55, 0.75, 0.65, 0.4),
    (0.30, -0.45, 1.15, 2.1),
    (0.15, 1.5, 0.9, 4.0),
];

impl OrganShape {
    /// Checks the ranges of an organ read from `source` at the dotted `key`.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`].
    pub fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        source.check_range(&format!("{key}.length_m"), self.length_m, 0.02, 0.5)?;
        source.check_range(&format!("{key}.width_m"), self.width_m, 0.02, 0.5)?;
        source.check_range(&format!("{key}.amplitude_m"), self.amplitude_m, 0.0, 0.005)?;
        source.check_range(&format!("{key}.wavelength_m"), self.wavelength_m, 0.03, 1.0)
    }

    /// Height of the surface above the scene's xy-plane at (`x`, `y`), m; defined beyond the patch
    /// too.
    #[must_use]
    pub fn height_m(&self, x: f64, y: f64) -> f64 {
        self.waves(x, y)
            .map(|(share, _, _, phase)| share * phase.sin())
            .sum::<f64>()
            * self.amplitude_m
    }

    /// Unit normal of the surface at (`x`, `y`), pointing up, scene frame.
    #[must_use]
    pub fn normal(&self, x: f64, y: f64) -> Unit<Vector3<f64>> {
        let (mut slope_x, mut slope_y) = (0.0, 0.0);
        for (share, wave_x, wave_y, phase) in self.waves(x, y) {
            slope_x += share * wave_x * phase.cos();
            slope_y += share * wave_y * phase.cos();
        }
        let slope = Vector3::new(
            -slope_x * self.amplitude_m,
            -slope_y * self.amplitude_m,
            1.0,
        );
        Unit::new_normalize(slope)
    }

    /// Whether (`x`, `y`) lies on the patch.
    #[must_use]
    pub fn covers(&self, x: f64, y: f64) -> bool {
        x.abs() <= 0.5 * self.length_m && y.abs() <= 0.5 * self.width_m
    }

    /// Share, wave numbers along x and y (rad/m) and phase (rad) of every wave at (`x`, `y`).
    fn waves(&self, x: f64, y: f64) -> impl Iterator<Item = (f64, f64, f64, f64)> {
        let unit = TAU / self.wavelength_m;
        WAVES.into_iter().map(move |(share, per_x, per_y, offset)| {
            let (wave_x, wave_y) = (per_x * unit, per_y * unit);
            (share, wave_x, wave_y, wave_x * x + wave_y * y + offset)
        })
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use hal::Mesh;

    use super::*;

    pub(crate) const BACK_MUSCLE: OrganShape = OrganShape {
        length_m: 0.12,
        width_m: 0.09,
        amplitude_m: 0.001_5,
        wavelength_m: 0.09,
    };

    #[test]
    fn normal_is_the_gradient_of_the_height() {
        let step = 1e-6;
        for index in 0..100 {
            let (x, y) = (
                -0.06 + 0.001_2 * f64::from(index),
                0.04 - 0.000_8 * f64::from(index),
            );
            let slope_x = (BACK_MUSCLE.height_m(x + step, y) - BACK_MUSCLE.height_m(x - step, y))
                / (2.0 * step);
            let slope_y = (BACK_MUSCLE.height_m(x, y + step) - BACK_MUSCLE.height_m(x, y - step))
                / (2.0 * step);
            let expected = Vector3::new(-slope_x, -slope_y, 1.0).normalize();
            assert!((BACK_MUSCLE.normal(x, y).into_inner() - expected).norm() < 1e-6);
            assert!(BACK_MUSCLE.height_m(x, y).abs() <= 0.001_5);
        }
    }

    /// The corners of all triangles, and whether each lies inside of the rim: its corners on the
    /// surface of physics.
    fn triangles(mesh: &Mesh) -> Vec<([Vector3<f64>; 3], bool)> {
        let at = |index: u32| Vector3::from(mesh.positions[index as usize].map(f64::from));
        let on_surface = |p: &Vector3<f64>| (BACK_MUSCLE.height_m(p.x, p.y) - p.z).abs() < 1e-7;
        mesh.indices
            .chunks_exact(3)
            .map(|triangle| [0, 1, 2].map(|k| at(triangle[k])))
            .map(|corners| (corners, corners.iter().all(on_surface)))
            .collect()
    }

    #[test]
    fn meshes_follow_the_surface_and_face_up() {
        for (mesh, least_m2) in [
            (BACK_MUSCLE.mesh(), 0.0070),
            (BACK_MUSCLE.lobed_mesh(), 0.0060),
        ] {
            let mut drawn_m2 = 0.0;
            for ([a, b, c], inside) in triangles(&mesh) {
                let across = (b - a).cross(&(c - a));
                if inside {
                    assert!(across.z > 0.0);
                    drawn_m2 += 0.5 * across.z;
                    let middle = (a + b + c) / 3.0;
                    let apart = BACK_MUSCLE.height_m(middle.x, middle.y) - middle.z;
                    assert!(apart.abs() < 2e-5, "{apart} at {middle}");
                }
            }
            assert!(drawn_m2 > least_m2, "{drawn_m2}");
            assert!(mesh.indices.len() / 3 <= 8000);
        }
    }

    #[test]
    fn rims_fall_off_outwards_and_normals_face_outside() {
        for mesh in [BACK_MUSCLE.mesh(), BACK_MUSCLE.lobed_mesh()] {
            let lowest = mesh.positions.iter().map(|p| p[2]).fold(0.0, f32::min);
            assert!(lowest < -0.025, "{lowest}");
            for triangle in mesh.indices.chunks_exact(3) {
                let [a, b, c] = [0, 1, 2]
                    .map(|k| Vector3::from(mesh.positions[triangle[k] as usize].map(f64::from)));
                let across = (b - a).cross(&(c - a));
                for &index in triangle {
                    let normal = Vector3::from(mesh.normals[index as usize].map(f64::from));
                    assert!(normal.dot(&across) > 0.0);
                    assert!((normal.norm() - 1.0).abs() < 1e-5);
                }
            }
        }
    }
}
