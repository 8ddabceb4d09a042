//! What all scripts do with a hand: point it down, raise it, see whether it has arrived.

use hal::Pose;
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::motion::{Motion, Placement};

/// How far the measured tip may be from its target at the end of a motion, m.
const ARRIVED_M: f64 = 0.0006;
/// How long to wait for that, s; then the part goes on wherever the tip is.
pub(crate) const ARRIVED_PATIENCE_S: f64 = 0.6;

/// `placement`, higher by `height_m`.
pub(crate) fn raised(placement: Placement, height_m: f64) -> Placement {
    placement.with_tip(Translation3::new(0.0, 0.0, height_m) * placement.tip_in_scene)
}

/// The tip rotation at home: approach along -z of the scene, jaw opening along x.
pub(crate) fn straight_down() -> UnitQuaternion<f64> {
    let columns = Matrix3::from_columns(&[Vector3::y(), Vector3::x(), -Vector3::z()]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns))
}

/// Whether the measured tip is where the motion ends. Its rotation is not looked at.
pub(crate) fn settled(motion: &Motion, tip_in_scene: &Pose) -> bool {
    let tip = tip_in_scene.translation.vector;
    (tip - motion.end().tip_in_scene.translation.vector).norm() < ARRIVED_M
}
