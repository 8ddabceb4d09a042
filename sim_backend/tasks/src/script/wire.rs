//! How to take a needle that lies flat.
//!
//! Both grasps point the instrument straight down, the hinge along the wire. Of the two yaws that
//! do so, half a turn apart, the one within a quarter turn of the home rotation is taken. The
//! control point is a finger's length above the finger tips.

use core::f64::consts::{FRAC_PI_2, PI};

use hal::Pose;
use hal::psm::FINGER_M;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};
use trocar_world::needle::NeedleShape;

use super::hand::straight_down;

/// Distance between the closed finger tips and the ground at the grasp, m. The less, the further
/// the tips reach beyond the wire.
const TIP_CLEARANCE_M: f64 = 0.000_1;

/// Thickness of a finger around the wire, m.
const FINGER_REACH_M: f64 = 0.0015;

/// The highest point of the ground under closed fingers at `grasp` that open along `opening`, m;
/// open, their tips are higher than closed.
fn highest_under_fingers(
    grasp: &Point3<f64>,
    opening: &Vector3<f64>,
    ground_m: impl Fn(f64, f64) -> f64,
) -> f64 {
    [-FINGER_REACH_M, 0.0, FINGER_REACH_M]
        .into_iter()
        .map(|reach_m| grasp + opening * reach_m)
        .map(|point| ground_m(point.x, point.y))
        .fold(f64::NEG_INFINITY, f64::max)
}

/// The pose of the control point in which closing the jaw grips the wire `along_m` from the middle
/// of its arc.
///
/// The tool points straight down and opens across the wire; the finger tips stay clear of the
/// ground, whose height over the scene's x and y is `ground_m`.
pub(crate) fn wire_grasp(
    needle: &NeedleShape,
    needle_in_scene: &Pose,
    along_m: f64,
    ground_m: impl Fn(f64, f64) -> f64,
) -> Pose {
    let tangent = needle_in_scene * Vector3::y();
    // Of the two ways to lay the jaw across the wire, the one nearer to the home rotation.
    let mut yaw = (-tangent.x).atan2(tangent.y);
    if yaw.abs() > FRAC_PI_2 {
        yaw -= PI.copysign(yaw);
    }
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * straight_down();
    let middle = needle_in_scene * Point3::new(needle.arc_radius_m, 0.0, 0.0);
    let grasp = middle + tangent * along_m;
    let floor_m = highest_under_fingers(&grasp, &(rotation * Vector3::y()), ground_m);
    let tip_z = floor_m.max(grasp.z - needle.wire_radius_m) + TIP_CLEARANCE_M;
    Pose::from_parts(
        Translation3::new(grasp.x, grasp.y, tip_z + FINGER_M),
        rotation,
    )
}

/// The pose of the control point in which closing the jaw grips the wire at `angle_rad` from the
/// middle of its arc, towards the needle's point, with the finger tips `beyond_m` beyond the wire's
/// middle line.
///
/// The tool points straight down and opens across the wire, as near to the home rotation as that
/// goes.
pub(crate) fn wire_hold(
    needle: &NeedleShape,
    needle_in_scene: &Pose,
    angle_rad: f64,
    beyond_m: f64,
) -> Pose {
    let (sin, cos) = angle_rad.sin_cos();
    let tangent = needle_in_scene * Vector3::new(-sin, cos, 0.0);
    let mut yaw = (-tangent.x).atan2(tangent.y);
    if yaw.abs() > FRAC_PI_2 {
        yaw -= PI.copysign(yaw);
    }
    let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * straight_down();
    let grasp = needle_in_scene * (Point3::new(cos, sin, 0.0) * needle.arc_radius_m);
    Pose::from_parts(
        Translation3::new(grasp.x, grasp.y, grasp.z + FINGER_M - beyond_m),
        rotation,
    )
}
