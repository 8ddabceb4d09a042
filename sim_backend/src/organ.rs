//! The organ surface: a gently rolling patch of back muscle, as a smooth height over the xy-plane.

use core::f64::consts::TAU;

use hal::config::{ConfigError, Source};
use nalgebra::{Unit, Vector3};
use serde::Deserialize;

use crate::needle::{ratio, single};
use crate::visual::Mesh;

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

/// Cells of the drawn grid along x and y: 2400 triangles.
const CELLS: [usize; 2] = [40, 30];

/// Cells of the grid that contact physics uses: 216 triangles, less than 0.1 mm from the drawn surface.
const CONTACT_CELLS: [usize; 2] = [12, 9];

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

    /// Height of the surface above the scene's xy-plane at (`x`, `y`), m; defined beyond the patch too.
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

    /// The patch as 2400 triangles in the scene frame.
    #[must_use]
    pub fn mesh(&self) -> Mesh {
        let mut mesh = Mesh::default();
        for row in 0..=CELLS[1] {
            for column in 0..=CELLS[0] {
                let (x, y) = self.grid_point(CELLS, column, row);
                mesh.positions
                    .push(single(Vector3::new(x, y, self.height_m(x, y))));
                mesh.normals.push(single(self.normal(x, y).into_inner()));
            }
        }
        let [columns, rows] = CELLS.map(|cells| u32::try_from(cells).unwrap_or(0));
        for row in 0..rows {
            for column in 0..columns {
                let here = row * (columns + 1) + column;
                let above = here + columns + 1;
                mesh.indices
                    .extend([here, here + 1, above + 1, here, above + 1, above]);
            }
        }
        mesh
    }

    /// Heights on the grid that contact physics uses, rows along y from its lower end, columns along x.
    pub(crate) fn contact_heights(&self) -> Vec<Vec<f64>> {
        let row_of = |row| {
            let height = |column| {
                let (x, y) = self.grid_point(CONTACT_CELLS, column, row);
                self.height_m(x, y)
            };
            (0..=CONTACT_CELLS[0]).map(height).collect()
        };
        (0..=CONTACT_CELLS[1]).map(row_of).collect()
    }

    fn grid_point(&self, cells: [usize; 2], column: usize, row: usize) -> (f64, f64) {
        (
            (ratio(column, cells[0]) - 0.5) * self.length_m,
            (ratio(row, cells[1]) - 0.5) * self.width_m,
        )
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

    #[test]
    fn mesh_follows_the_surface_and_faces_up() {
        let mesh = BACK_MUSCLE.mesh();
        assert!(mesh.indices.len() / 3 <= 2500);
        for triangle in mesh.indices.chunks_exact(3) {
            let [a, b, c] = [0, 1, 2]
                .map(|k| Vector3::from(mesh.positions[triangle[k] as usize].map(f64::from)));
            assert!((b - a).cross(&(c - a)).z > 0.0);
            let middle = (a + b + c) / 3.0;
            assert!((BACK_MUSCLE.height_m(middle.x, middle.y) - middle.z).abs() < 2e-5);
        }
    }
}
