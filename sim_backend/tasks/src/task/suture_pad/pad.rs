//! The suture pad: a plate whose top is the scene's xy-plane, with an upright lip that has a hole
//! through it.

use hal::config::{ConfigError, Source};
use hal::{Mesh, Pose};
use nalgebra::{Point3, Vector3};
use serde::Deserialize;
use trocar_render::shapes::{cuboid, placed};
use trocar_world::Shape;

use super::cast::Cast;

/// Half the size of the table under the pad, m.
const TABLE_HALF_M: f64 = 0.25;

/// Thickness of the ink, m.
const INK_M: f64 = 0.000_05;

/// A suture pad. The lip stands across y; its square hole goes through it along y over the scene's
/// origin.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PadShape {
    /// Extent of the plate along x, m.
    pub length_m: f64,
    /// Extent along y, m.
    pub width_m: f64,
    /// Thickness, m.
    pub thickness_m: f64,
    /// Extent of the lip along x, m.
    pub lip_length_m: f64,
    /// Height of the lip, m.
    pub lip_height_m: f64,
    /// Where the lip begins, y, m.
    pub lip_front_m: f64,
    /// Thickness of the lip along y, which is the length of the hole, m.
    pub lip_thickness_m: f64,
    /// Height of the hole's middle, m.
    pub hole_height_m: f64,
    /// Half the side of the hole, m.
    pub hole_half_m: f64,
}

impl PadShape {
    pub(super) fn check(&self, source: &Source, key: &str) -> Result<(), ConfigError> {
        let check = |name: &str, value, low, high| {
            source.check_range(&format!("{key}.{name}"), value, low, high)
        };
        check("length_m", self.length_m, 0.02, 0.4)?;
        check("width_m", self.width_m, 0.02, 0.4)?;
        check("thickness_m", self.thickness_m, 0.002, 0.05)?;
        check("lip_length_m", self.lip_length_m, 0.01, self.length_m)?;
        check("lip_height_m", self.lip_height_m, 0.004, 0.05)?;
        let back_m = 0.5 * self.width_m;
        check("lip_thickness_m", self.lip_thickness_m, 0.001, 0.02)?;
        check(
            "lip_front_m",
            self.lip_front_m,
            -back_m,
            back_m - self.lip_thickness_m,
        )?;
        let beside_m = 0.45 * self.lip_length_m;
        check(
            "hole_half_m",
            self.hole_half_m,
            0.000_5,
            beside_m.min(0.005),
        )?;
        check(
            "hole_height_m",
            self.hole_height_m,
            self.hole_half_m,
            self.lip_height_m - self.hole_half_m,
        )
    }

    /// Where the lip ends, y, m.
    #[must_use]
    pub const fn lip_back_m(&self) -> f64 {
        self.lip_front_m + self.lip_thickness_m
    }

    /// The middle of the hole, scene frame.
    #[must_use]
    pub fn hole(&self) -> Point3<f64> {
        let middle_m = self.lip_front_m + 0.5 * self.lip_thickness_m;
        Point3::new(0.0, middle_m, self.hole_height_m)
    }

    /// Whether (`x`, `y`) lies over the plate.
    pub(super) fn covers(&self, x: f64, y: f64) -> bool {
        x.abs() <= 0.5 * self.length_m && y.abs() <= 0.5 * self.width_m
    }

    /// Table, plate and the lip's four parts around the hole, for the physics.
    pub(super) fn solids(&self) -> Vec<Shape> {
        let table = [
            [-TABLE_HALF_M, -TABLE_HALF_M, -self.thickness_m - 0.02],
            [TABLE_HALF_M, TABLE_HALF_M, -self.thickness_m],
        ];
        let shape = |[low, high]: [[f64; 3]; 2]| Shape::Block {
            low: Point3::from(low),
            high: Point3::from(high),
        };
        [table].into_iter().chain(self.boxes()).map(shape).collect()
    }

    /// What is drawn, in the scene frame: skin with the lip, fat, muscle, and the ink around the
    /// hole.
    pub(super) fn meshes(&self) -> [Mesh; 4] {
        let [skin, fat, muscle] = Cast::of(self).layers();
        [skin, fat, muscle, self.ink()]
    }

    /// A square frame on both sides of the lip.
    pub(super) fn ink(&self) -> Mesh {
        let (inner, outer) = (self.hole_half_m + 0.000_4, self.hole_half_m + 0.001_1);
        let middle = self.hole_height_m;
        let sides = [
            [[-outer, inner], [outer, outer]],
            [[-outer, -outer], [outer, -inner]],
            [[-outer, -inner], [-inner, inner]],
            [[inner, -inner], [outer, inner]],
        ];
        let fronts = [self.lip_front_m, self.lip_back_m()];
        Mesh::merged(fronts.into_iter().flat_map(|y| {
            sides.map(|[low, high]| {
                block([
                    [low[0], y - INK_M, middle + low[1]],
                    [high[0], y + INK_M, middle + high[1]],
                ])
            })
        }))
    }

    /// Lowest and highest corners of the plate and of the lip left of, right of, under and over the
    /// hole.
    fn boxes(&self) -> [[[f64; 3]; 2]; 5] {
        let (x, y) = (0.5 * self.length_m, 0.5 * self.width_m);
        let (end, hole) = (0.5 * self.lip_length_m, self.hole_half_m);
        let (under, over) = (self.hole_height_m - hole, self.hole_height_m + hole);
        let lip = |x: [f64; 2], z: [f64; 2]| {
            [
                [x[0], self.lip_front_m, z[0]],
                [x[1], self.lip_back_m(), z[1]],
            ]
        };
        let top = self.lip_height_m;
        [
            [[-x, -y, -self.thickness_m], [x, y, 0.0]],
            lip([-end, -hole], [0.0, top]),
            lip([hole, end], [0.0, top]),
            lip([-hole, hole], [0.0, under]),
            lip([-hole, hole], [over, top]),
        ]
    }
}

/// A box by its lowest and highest corners.
fn block([low, high]: [[f64; 3]; 2]) -> Mesh {
    let (low, high) = (Vector3::from(low), Vector3::from(high));
    let middle = (low + high) * 0.5;
    placed(
        cuboid((high - low) * 0.5),
        &Pose::translation(middle.x, middle.y, middle.z),
    )
}
