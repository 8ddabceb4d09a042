//! Actions relative to the tip at the observation: what networks predict, against the absolute targets that chunks carry.
//!
//! Seven numbers: translation from the measured tip in the RCM frame (m), rotation vector in the frame of the measured
//! tip (rad), and the jaw angle as it is (rad). Absolute poses would carry the arm's calibration into the network.

use hal::{Pose, TipTarget};
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};

/// Name of this representation in checkpoints.
pub const REPRESENTATION: &str = "observation_relative";

/// Numbers in a relative action.
pub const RELATIVE_ACTION_DIM: usize = 7;

/// A pose from `x y z qx qy qz qw`, as datasets store it.
#[must_use]
pub fn pose_from_numbers(numbers: &[f64; 7]) -> Pose {
    let [x, y, z, qx, qy, qz, qw] = *numbers;
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(qw, qx, qy, qz));
    Pose::from_parts(Translation3::new(x, y, z), rotation)
}

/// The action that takes the tip from `tip_in_rcm` to `target_in_rcm` with the jaw at `jaw`.
#[must_use]
pub fn relative_action(
    tip_in_rcm: &Pose,
    target_in_rcm: &Pose,
    jaw: f64,
) -> [f64; RELATIVE_ACTION_DIM] {
    let translation = target_in_rcm.translation.vector - tip_in_rcm.translation.vector;
    let rotation = (tip_in_rcm.rotation.inverse() * target_in_rcm.rotation).scaled_axis();
    [
        translation.x,
        translation.y,
        translation.z,
        rotation.x,
        rotation.y,
        rotation.z,
        jaw,
    ]
}

/// The target that `action` means for a tip at `tip_in_rcm`.
#[must_use]
pub fn absolute_target(tip_in_rcm: &Pose, action: &[f64; RELATIVE_ACTION_DIM]) -> TipTarget {
    let [dx, dy, dz, rx, ry, rz, jaw] = *action;
    let translation = tip_in_rcm.translation.vector + Vector3::new(dx, dy, dz);
    let rotation = tip_in_rcm.rotation * UnitQuaternion::from_scaled_axis(Vector3::new(rx, ry, rz));
    TipTarget::new(
        &Pose::from_parts(Translation3::from(translation), rotation),
        jaw,
    )
}

#[cfg(test)]
mod tests {
    use super::{absolute_target, pose_from_numbers, relative_action};
    use crate::rng::SplitMix64;

    #[test]
    fn composing_a_relative_action_gives_back_the_target() {
        let mut random = SplitMix64::new(11);
        for _ in 0..1000 {
            let tip = pose_from_numbers(&core::array::from_fn(|_| random.signed_unit()));
            let target = pose_from_numbers(&core::array::from_fn(|_| random.signed_unit()));
            let back = absolute_target(&tip, &relative_action(&tip, &target, 0.3));
            let pose = back.tip_in_rcm();
            assert!((pose.translation.vector - target.translation.vector).norm() < 1e-12);
            assert!(
                pose.rotation.angle_to(&target.rotation) < 1e-7,
                "{}",
                pose.rotation.angle_to(&target.rotation)
            );
            assert!((back.jaw - 0.3).abs() < 1e-15);
        }
    }

    #[test]
    fn translation_is_in_the_rcm_frame_and_rotation_in_the_tool_frame() {
        let half = core::f64::consts::FRAC_1_SQRT_2;
        // The tool is turned by a quarter about the RCM's z.
        let tip = pose_from_numbers(&[0.0, 0.0, 0.0, 0.0, 0.0, half, half]);
        let target = absolute_target(&tip, &[0.01, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0]);
        assert!((target.position_m[0] - 0.01).abs() < 1e-15);
        let turned_about = (target.tip_in_rcm().rotation * tip.rotation.inverse()).scaled_axis();
        assert!((turned_about.y - 0.1).abs() < 1e-12, "{turned_about}");
    }
}
