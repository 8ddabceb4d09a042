//! The training block: a hollow triangular prism with blunt corners, as mass properties, convex
//! pieces and mesh.

use core::f64::consts::PI;

use hal::Mesh;
use hal::config::{ConfigError, Source};
use nalgebra::{Point3, Vector2, Vector3};
use serde::Deserialize;

/// Shape and mass of a block.
///
/// The block frame has its origin in the middle of the block and z along the hole, which is
/// hexagonal. The three corners point along 0°, 120° and 240°, the three sides face 60°, 180° and
/// 300°.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlockShape {
    /// Distance of the sides from the axis, m.
    pub side_m: f64,
    /// Distance of the blunt corners from the axis, m.
    pub corner_m: f64,
    /// Distance of the hole's walls from the axis, m.
    pub hole_m: f64,
    /// Height along the hole, m.
    pub height_m: f64,
    /// Mass, kg.
    pub mass_kg: f64,
}

/// Faces around the axis: corners and sides in turn.
const FACES: usize = 6;

impl BlockShape {
    /// Checks the ranges of a block read from `source` at the dotted `key`.
    ///
    /// # Errors
    /// [`ConfigError::OutOfRange`].
    pub fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        source.check_range(&format!("{key}.side_m"), self.side_m, 0.002, 0.02)?;
        // Sharper than twice the side's distance there is no triangle.
        source.check_range(
            &format!("{key}.corner_m"),
            self.corner_m,
            1.05 * self.side_m,
            1.95 * self.side_m,
        )?;
        source.check_range(
            &format!("{key}.hole_m"),
            self.hole_m,
            0.001,
            self.side_m - 0.000_5,
        )?;
        source.check_range(&format!("{key}.height_m"), self.height_m, 0.003, 0.03)?;
        source.check_range(&format!("{key}.mass_kg"), self.mass_kg, 0.001, 0.05)
    }

    /// Unit normal of the side `side` (0 to 2), in the block frame.
    #[must_use]
    pub fn side_normal(&self, side: u32) -> Vector3<f64> {
        let (sin, cos) = (PI / 3.0 * f64::from(2 * side + 1)).sin_cos();
        Vector3::new(cos, sin, 0.0)
    }

    /// Corner points of the six convex pieces between hole and surface: four of the lower end,
    /// counter-clockwise seen from above, and the four above them.
    #[must_use]
    pub fn pieces(&self) -> [[[Point3<f64>; 4]; 2]; FACES] {
        let inner = corners(&[self.hole_m; FACES]);
        let outer = corners(&self.faces());
        core::array::from_fn(|face| {
            let before = (face + FACES - 1) % FACES;
            let quad = [inner[before], outer[before], outer[face], inner[face]];
            [-0.5, 0.5].map(|end| quad.map(|p| Point3::new(p.x, p.y, end * self.height_m)))
        })
    }

    /// The block in its own frame.
    #[must_use]
    pub fn mesh(&self) -> Mesh {
        Mesh::merged(self.pieces().map(Mesh::hexahedron))
    }

    /// Moments of inertia about the middle along the frame's axes, kg m².
    #[must_use]
    pub fn inertia(&self) -> Vector3<f64> {
        let (outer, outer_second) = moments(&corners(&self.faces()));
        let (inner, inner_second) = moments(&corners(&[self.hole_m; FACES]));
        // Three-fold symmetry: all directions across the axis are alike.
        let about_axis = (outer_second - inner_second) / (outer - inner);
        let across = 0.5 * about_axis + self.height_m * self.height_m / 12.0;
        Vector3::new(across, across, about_axis) * self.mass_kg
    }

    /// Distances of the faces from the axis.
    const fn faces(&self) -> [f64; FACES] {
        let (corner, side) = (self.corner_m, self.side_m);
        [corner, side, corner, side, corner, side]
    }
}

/// Where each face of a prism around the axis meets the next one.
fn corners(distances_m: &[f64; FACES]) -> [Vector2<f64>; FACES] {
    let step = PI / 3.0;
    let mut angle = 0.0;
    core::array::from_fn(|face| {
        let (here, next) = (distances_m[face], distances_m[(face + 1) % FACES]);
        let (sin, cos) = f64::sin_cos(angle);
        angle += step;
        // Along this face from the foot of its normal to the next face.
        let along = (next - here * step.cos()) / step.sin();
        Vector2::new(here * cos - along * sin, here * sin + along * cos)
    })
}

/// Area and polar second moment about the origin of a polygon around it.
fn moments(corners: &[Vector2<f64>; FACES]) -> (f64, f64) {
    let mut sums = (0.0, 0.0);
    for (index, a) in corners.iter().enumerate() {
        let b = corners[(index + 1) % FACES];
        let cross = a.x * b.y - a.y * b.x;
        sums.0 += 0.5 * cross;
        sums.1 += cross * (a.dot(a) + a.dot(&b) + b.dot(&b)) / 12.0;
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::*;

    const BLOCK: BlockShape = BlockShape {
        side_m: 0.005,
        corner_m: 0.008,
        hole_m: 0.003_6,
        height_m: 0.014_5,
        mass_kg: 0.01,
    };

    /// Whether (x, y) lies between hole and surface.
    fn solid(x: f64, y: f64) -> bool {
        let reach = |face: u32| {
            let (sin, cos) = (PI / 3.0 * f64::from(face)).sin_cos();
            cos * x + sin * y
        };
        let faces = BLOCK.faces();
        (0..6)
            .zip(faces)
            .all(|(face, distance)| reach(face) < distance)
            && (0..6).any(|face| reach(face) > BLOCK.hole_m)
    }

    #[test]
    fn inertia_equals_that_of_many_beads() {
        let (mut count, mut sum) = (0.0, 0.0);
        for column in -1000..1000 {
            for row in -1000..1000 {
                let (x, y) = (f64::from(column) * 1e-5, f64::from(row) * 1e-5);
                if solid(x, y) {
                    count += 1.0;
                    sum += x * x + y * y;
                }
            }
        }
        let about_axis = sum / count * BLOCK.mass_kg;
        let inertia = BLOCK.inertia();
        assert!((inertia.z / about_axis - 1.0).abs() < 2e-3, "{inertia}");
        let across = 0.5 * about_axis + BLOCK.mass_kg * BLOCK.height_m.powi(2) / 12.0;
        assert!((inertia.x / across - 1.0).abs() < 2e-3, "{inertia}");
    }

    #[test]
    fn pieces_leave_the_hole_free_and_end_at_the_sides() {
        let points: Vec<_> = BLOCK.pieces().into_iter().flatten().flatten().collect();
        for point in &points {
            let flat = point.xy().coords.norm();
            assert!((0.003_6..0.0091).contains(&flat), "{point}");
        }
        for side in 0..3 {
            let normal = BLOCK.side_normal(side);
            let reach = points.iter().map(|p| normal.dot(&p.coords));
            let furthest = reach.fold(0.0, f64::max);
            assert!(
                (furthest - BLOCK.side_m).abs() < 1e-12,
                "{side}: {furthest}"
            );
        }
    }
}
