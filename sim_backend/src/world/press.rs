//! The instrument pressing into the tissue: springs and friction at sample points on fingers and wrist.

use hal::Pose;
use hal::psm::FINGER_M;
use nalgebra::{Point3, Vector3};

use super::chain::Wrench;
use super::config::Press;
use super::solids::{FINGER_THICKNESS_M, FINGER_WIDTH_M, WRIST_RADIUS_M};
use crate::organ::OrganShape;
use crate::tissue;

/// Below this tangential speed friction fades, m/s: it damps, it does not stick.
const SLIDING_M_S: f64 = 0.02;

/// Sample points of one finger, in its frame: the corners of its end and the middle of its outer face.
pub(super) fn finger_points(finger: &Pose, side: f64) -> [Point3<f64>; 5] {
    let outer = side * FINGER_THICKNESS_M;
    let half = 0.5 * FINGER_WIDTH_M;
    [
        finger * Point3::new(-half, 0.0, FINGER_M),
        finger * Point3::new(half, 0.0, FINGER_M),
        finger * Point3::new(-half, outer, FINGER_M),
        finger * Point3::new(half, outer, FINGER_M),
        finger * Point3::new(0.0, outer, 0.5 * FINGER_M),
    ]
}

/// Lowest points of the two balls that end the wrist: on the wrist-pitch and the wrist-yaw axis.
pub(super) fn wrist_points(wrist: &Pose, tip: &Pose) -> [Point3<f64>; 2] {
    [wrist, tip].map(|frame| Point3::from(frame.translation.vector - Vector3::z() * WRIST_RADIUS_M))
}

/// Ground that gives way.
pub(super) trait SoftGround {
    /// Height of its surface over (`x`, `y`), scene frame, m; none where it ends.
    fn height_m(&self, x: f64, y: f64) -> Option<f64>;

    /// Unit normal of the surface there, up; to be asked only where there is a height.
    fn normal(&self, x: f64, y: f64) -> Vector3<f64>;
}

impl SoftGround for OrganShape {
    fn height_m(&self, x: f64, y: f64) -> Option<f64> {
        self.covers(x, y).then(|| Self::height_m(self, x, y))
    }

    fn normal(&self, x: f64, y: f64) -> Vector3<f64> {
        Self::normal(self, x, y).into_inner()
    }
}

impl SoftGround for tissue::Ground {
    fn height_m(&self, x: f64, y: f64) -> Option<f64> {
        Self::height_m(self, x, y)
    }

    fn normal(&self, x: f64, y: f64) -> Vector3<f64> {
        Self::normal(self, x, y).unwrap_or_else(Vector3::z)
    }
}

/// Force and moment about `centre` that the tissue puts on `points`, which were at `before` one millisecond ago.
pub(super) fn pressed(
    config: &Press,
    ground: &impl SoftGround,
    points: &[Point3<f64>],
    before: &[Point3<f64>],
    centre: &Vector3<f64>,
) -> Wrench {
    let mut wrench = Wrench::zero();
    for (point, earlier) in points.iter().zip(before) {
        let Some(height_m) = ground.height_m(point.x, point.y) else {
            continue;
        };
        let sunk_m = height_m - point.z;
        if sunk_m <= 0.0 {
            continue;
        }
        let normal = ground.normal(point.x, point.y);
        let velocity = (point - earlier) * 1e3;
        let rising = velocity.dot(&normal);
        let load =
            (config.stiffness_n_m * sunk_m * normal.z - config.damping_n_s_m * rising).max(0.0);
        let sliding = velocity - normal * rising;
        let drag = sliding * (config.friction * load / sliding.norm().max(SLIDING_M_S));
        wrench.push(&(point.coords - centre), &(normal * load - drag));
    }
    wrench
}
