//! How far the instrument is from every boundary in space. Hot path: bounded, no allocation, no I/O, no lock.

use hal::psm::SHAFT_RADIUS_M;
use nalgebra::Vector3;

use crate::control::config::{FORBIDDEN_MAX, Geometry};
use crate::kinematics::Frames;

/// Box sides for two points, three links for each sphere.
pub(super) const CLEARANCES: usize = 12 + 3 * FORBIDDEN_MAX;

/// A clearance that cannot matter, m.
const FAR_M: f64 = 10.0;

/// One distance for each boundary, m.
pub(super) type Clearances = [f64; CLEARANCES];

/// The box for the control point and the finger tips, and the spheres that no part may enter, in the RCM frame.
#[derive(Clone, Debug)]
pub(super) struct Boundaries {
    workspace_min_m: Vector3<f64>,
    workspace_max_m: Vector3<f64>,
    spheres: [Option<(Vector3<f64>, f64)>; FORBIDDEN_MAX],
}

impl Boundaries {
    pub(super) fn new(geometry: &Geometry) -> Self {
        let mut spheres = [None; FORBIDDEN_MAX];
        for (slot, sphere) in spheres.iter_mut().zip(&geometry.forbidden) {
            *slot = Some((sphere.center_m, sphere.radius_m));
        }
        Self {
            workspace_min_m: geometry.workspace_min_m,
            workspace_max_m: geometry.workspace_max_m,
            spheres,
        }
    }

    /// How far the instrument is from every boundary, m; negative beyond it.
    pub(super) fn clearances(&self, frames: &Frames) -> Clearances {
        let mut clearances = [FAR_M; CLEARANCES];
        let (planes, links) = clearances.split_at_mut(12);
        let points = [frames.tip_m, frames.finger_m];
        for (slot, index) in planes.iter_mut().zip(0..) {
            let point_m = points[index / 6];
            let axis = index % 3;
            let above = index % 6 < 3;
            *slot = if above {
                point_m[axis] - self.workspace_min_m[axis]
            } else {
                self.workspace_max_m[axis] - point_m[axis]
            };
        }
        let corners = [
            Vector3::zeros(),
            frames.wrist_m,
            frames.tip_m,
            frames.finger_m,
        ];
        for (slots, sphere) in links.chunks_exact_mut(3).zip(&self.spheres) {
            let Some((center_m, radius_m)) = sphere else {
                continue;
            };
            for (slot, ends) in slots.iter_mut().zip(corners.windows(2)) {
                *slot =
                    distance_to_segment(center_m, &ends[0], &ends[1]) - radius_m - SHAFT_RADIUS_M;
            }
        }
        clearances
    }
}

fn distance_to_segment(point_m: &Vector3<f64>, from_m: &Vector3<f64>, to_m: &Vector3<f64>) -> f64 {
    let along = to_m - from_m;
    let offset = point_m - from_m;
    let length_squared = along.norm_squared();
    if length_squared < 1e-18 {
        return offset.norm();
    }
    let fraction = (offset.dot(&along) / length_squared).clamp(0.0, 1.0);
    (offset - along * fraction).norm()
}
