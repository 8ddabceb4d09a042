//! The front of a flap that was dissected off an organ: the surface before it is cut away, so that
//! a finger fits under its free edge.

use hal::Mesh;
use hal::mesh::single;
use nalgebra::{Point3, Vector3};

/// How deep it is, m: the lower finger of an open jaw and the wrist behind it.
const DEPTH_M: f64 = 0.010;
/// How far, along y, the wall under the flap is from its upper to its lower end, m; from the upper
/// end to the end of the floor; and the slope that leads from there up to the surface again. The
/// wall's slope, 1.25 at most, and an organ's are less than what is felt at all (`relief`).
const WALL_M: f64 = 0.012;
const FLOOR_M: f64 = 0.028;
const SLOPE_M: f64 = 0.030;
/// The slopes at both ends, along x, m.
const ENDS_M: f64 = 0.015;
/// Edges of the mesh in it at most, m.
const EDGE_M: f64 = 0.001_5;

/// Where the surface is cut away: before a line along x.
#[derive(Clone, Copy, Debug)]
pub(in crate::task) struct Incision {
    /// Where the wall begins, scene y, m; it goes on towards -y.
    pub(in crate::task) front_m: f64,
    /// Its middle, scene x, m.
    pub(in crate::task) middle_m: f64,
    /// Half its length along x at full depth, m.
    pub(in crate::task) half_m: f64,
}

impl Incision {
    /// How much lower the surface is at (`x`, `y`), m, and how much that grows along x and along y.
    fn depth_m(&self, x: f64, y: f64) -> (f64, [f64; 2]) {
        let before_m = self.front_m - y;
        let (wall, wall_slope) = eased(before_m, WALL_M);
        let (back, back_slope) = eased(before_m - FLOOR_M, SLOPE_M);
        let beside_m = x - self.middle_m;
        let (end, end_slope) = eased(beside_m.abs() - self.half_m, ENDS_M);
        let across = wall * (1.0 - back);
        let across_slope = wall_slope * (1.0 - back) - wall * back_slope;
        let along = 1.0 - end;
        let slope = [
            -across * end_slope * beside_m.signum(),
            -across_slope * along,
        ];
        (DEPTH_M * across * along, slope.map(|slope| DEPTH_M * slope))
    }

    /// How long edges of the mesh may be at `at`, m; none where it is not cut.
    pub(super) fn edge_m(&self, at: &Point3<f64>) -> Option<f64> {
        (self.depth_m(at.x, at.y).0 > 0.0).then_some(EDGE_M)
    }

    /// Cuts `mesh` (scene frame).
    pub(super) fn cut(&self, mesh: &mut Mesh) {
        for (position, normal) in mesh.positions.iter_mut().zip(&mut mesh.normals) {
            let mut at = Vector3::from(position.map(f64::from));
            let (depth_m, slope) = self.depth_m(at.x, at.y);
            if depth_m > 0.0 {
                at.z -= depth_m;
                *position = single(&at);
                let before = Vector3::from(normal.map(f64::from));
                let sheared = before + Vector3::new(slope[0], slope[1], 0.0) * before.z;
                *normal = single(&sheared.normalize());
            }
        }
    }
}

/// From 0 to 1 while `at` goes from 0 to `length`, level at both ends; and its slope.
fn eased(at: f64, length: f64) -> (f64, f64) {
    let share = (at / length).clamp(0.0, 1.0);
    (
        share * share * (3.0 - 2.0 * share),
        6.0 * share * (1.0 - share) / length,
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Its slope is that of its depth; at full length it is 10 mm deep, and level where it ends.
    #[test]
    fn an_incision_is_as_deep_as_its_slope_says() {
        let incision = Incision {
            front_m: -0.016,
            middle_m: 0.0,
            half_m: 0.030,
        };
        let depth_m = |x: f64, y: f64| incision.depth_m(x, y).0;
        assert_eq!(incision.depth_m(0.0, -0.016), (0.0, [0.0; 2]));
        assert_eq!(incision.depth_m(0.0, -0.075), (0.0, [0.0; 2]));
        assert!((depth_m(0.030, -0.032) - DEPTH_M).abs() < 1e-9);
        assert!(depth_m(0.046, -0.030).abs() < 1e-12);
        let step_m = 1e-7;
        for index in 0..400_u32 {
            let (x, y) = (
                -0.05 + 0.000_25 * f64::from(index),
                -0.075 + 0.000_15 * f64::from(index),
            );
            let (_, slope) = incision.depth_m(x, y);
            let along = [
                depth_m(x + step_m, y) - depth_m(x - step_m, y),
                depth_m(x, y + step_m) - depth_m(x, y - step_m),
            ];
            for axis in 0..2 {
                let apart = along[axis] / (2.0 * step_m) - slope[axis];
                assert!(apart.abs() < 1e-4, "{apart} at {x}, {y}");
            }
        }
    }
}
