//! The peg board: a plate whose top is the scene's xy-plane, with round-headed pegs, on a table.

use hal::config::{ConfigError, Source};
use hal::{Mesh, Pose};
use nalgebra::{Point3, Vector3};
use serde::Deserialize;
use trocar_render::shapes::{capsule, cuboid, placed};
use trocar_world::Shape;

/// How many pegs a board has.
pub(super) const PEGS: usize = 6;

/// Half the size of the table under the board, m.
const TABLE_HALF_M: f64 = 0.25;

/// How deep the pegs reach into the plate, m.
const ROOT_M: f64 = 0.002;

/// A peg board.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BoardShape {
    /// Extent of the plate along x, m.
    pub length_m: f64,
    /// Extent along y, m.
    pub width_m: f64,
    /// Thickness, m.
    pub thickness_m: f64,
    /// Radius of the pegs, m.
    pub peg_radius_m: f64,
    /// Height of the pegs above the plate, m.
    pub peg_height_m: f64,
    /// Where the pegs stand, x and y, m.
    pub pegs_m: [[f64; 2]; PEGS],
}

impl BoardShape {
    pub(super) fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        let check = |name: &str, value, low, high| {
            source.check_range(&format!("{key}.{name}"), value, low, high)
        };
        check("length_m", self.length_m, 0.02, 0.4)?;
        check("width_m", self.width_m, 0.02, 0.4)?;
        check("thickness_m", self.thickness_m, ROOT_M, 0.05)?;
        check("peg_radius_m", self.peg_radius_m, 0.000_5, 0.005)?;
        check("peg_height_m", self.peg_height_m, 0.005, 0.04)?;
        for (index, peg) in self.pegs_m.iter().enumerate() {
            let halves = [0.5 * self.length_m, 0.5 * self.width_m];
            for (axis, half) in halves.into_iter().enumerate() {
                check(&format!("pegs_m.{index}.{axis}"), peg[axis], -half, half)?;
            }
        }
        Ok(())
    }

    /// Plate, pegs and table for the physics.
    pub(super) fn solids(&self) -> Vec<Shape> {
        let (x, y) = (0.5 * self.length_m, 0.5 * self.width_m);
        let table = Shape::Block {
            low: Point3::new(-TABLE_HALF_M, -TABLE_HALF_M, -self.thickness_m - 0.02),
            high: Point3::new(TABLE_HALF_M, TABLE_HALF_M, -self.thickness_m),
        };
        let plate = Shape::Block {
            low: Point3::new(-x, -y, -self.thickness_m),
            high: Point3::new(x, y, 0.0),
        };
        let pegs = self.pegs_m.map(|[x, y]| Shape::Capsule {
            from: Point3::new(x, y, -ROOT_M),
            to: Point3::new(x, y, self.peg_height_m - self.peg_radius_m),
            radius_m: self.peg_radius_m,
        });
        [table, plate].into_iter().chain(pegs).collect()
    }

    /// Whether (`x`, `y`) lies over the plate.
    pub(super) fn covers(&self, x: f64, y: f64) -> bool {
        x.abs() <= 0.5 * self.length_m && y.abs() <= 0.5 * self.width_m
    }

    /// The plate in the scene frame.
    pub(super) fn mesh(&self) -> Mesh {
        let half = Vector3::new(self.length_m, self.width_m, self.thickness_m) * 0.5;
        placed(cuboid(half), &Pose::translation(0.0, 0.0, -half.z))
    }

    /// One peg, its foot at the origin.
    pub(super) fn peg_mesh(&self) -> Mesh {
        let radius_m = self.peg_radius_m;
        capsule(radius_m, -ROOT_M, self.peg_height_m - radius_m, 20)
    }
}
