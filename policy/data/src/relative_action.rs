//! Actions relative to the tip at the observation: what networks predict, against the absolute
//! targets that chunks carry.
//!
//! Seven numbers an arm: translation from the measured tip in the RCM frame (m), rotation vector in
//! the frame of the measured tip (rad), and the jaw angle as it is (rad). Absolute poses would
//! carry the arm's calibration into the network. Of several arms, each is relative to its own tip
//! in its own RCM frame, and a step has the arms' numbers one after another.
//!
//! With `p` and `R` of tip and target: `dp = p_target - p_tip`, `r = log(R_tip^T R_target)`; back,
//! `p_target = p_tip + dp`, `R_target = R_tip exp(r)`. All steps of a chunk are relative to the one
//! observation that the chunk answers, not each to the step before, so errors do not add up.

use hal::{ArmObservation, Chunk, Observation, Pose, TipTarget};
use nalgebra::{Quaternion, Translation3, UnitQuaternion, Vector3};

/// Name of this representation in checkpoints.
pub const REPRESENTATION: &str = "observation_relative";

/// Numbers in the relative action of one arm.
pub const RELATIVE_ACTION_DIM: usize = 7;

/// Name of absolute actions in checkpoints: what a dataset's `action` holds, so what a policy
/// predicts that LeRobot trained on one. Eight numbers an arm: position in the RCM frame (m),
/// quaternion x, y, z, w (any length), jaw (rad).
pub const ABSOLUTE_REPRESENTATION: &str = "absolute_pose";

/// Numbers in the absolute action of one arm.
pub const ABSOLUTE_ACTION_DIM: usize = 8;

/// Numbers in the action of one arm in `representation`; none if there is no such representation.
#[must_use]
pub fn action_dim(representation: &str) -> Option<usize> {
    match representation {
        REPRESENTATION => Some(RELATIVE_ACTION_DIM),
        ABSOLUTE_REPRESENTATION => Some(ABSOLUTE_ACTION_DIM),
        _ => None,
    }
}

/// A pose from `x y z qx qy qz qw`, as datasets store it.
#[must_use]
pub fn pose_from_numbers(numbers: &[f64; 7]) -> Pose {
    let [x, y, z, qx, qy, qz, qw] = *numbers;
    let rotation = UnitQuaternion::from_quaternion(Quaternion::new(qw, qx, qy, qz));
    Pose::from_parts(Translation3::new(x, y, z), rotation)
}

/// The action that takes the tip from `tip_in_rcm` to `target_in_rcm` with the jaw at `jaw`.
///
/// The rotation vector's length is at most a half turn; near that its direction can flip.
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

/// The chunks that relative `actions` mean, one for each arm of `observation`: row-major, a step's
/// arms one after another.
///
/// `actions` is `[steps, arms, 7]`, not normalised; numbers of an incomplete row are ignored. Every
/// chunk has the stamp of the first arm's state, so that arms stay in step.
#[must_use]
pub fn absolute_chunks(
    observation: &Observation<'_>,
    actions: &[f32],
    sequence: u64,
    step_ns: u64,
) -> Vec<Chunk> {
    chunks::<RELATIVE_ACTION_DIM>(observation, actions, sequence, step_ns, |arm, row| {
        absolute_target(&arm.tip_in_rcm, row)
    })
}

/// The chunks that `actions` in `representation` mean; those of an unknown one are taken for
/// relative.
///
/// A quaternion of no length makes a target with NaN in it, which the controller refuses.
#[must_use]
pub fn chunks_of(
    representation: &str,
    observation: &Observation<'_>,
    actions: &[f32],
    sequence: u64,
    step_ns: u64,
) -> Vec<Chunk> {
    if representation != ABSOLUTE_REPRESENTATION {
        return absolute_chunks(observation, actions, sequence, step_ns);
    }
    chunks::<ABSOLUTE_ACTION_DIM>(observation, actions, sequence, step_ns, |_, row| {
        let [x, y, z, qx, qy, qz, qw, jaw] = *row;
        TipTarget::new(&pose_from_numbers(&[x, y, z, qx, qy, qz, qw]), jaw)
    })
}

/// Splits `[steps, arms, N]` into a chunk an arm; none without an arm.
fn chunks<const N: usize>(
    observation: &Observation<'_>,
    actions: &[f32],
    sequence: u64,
    step_ns: u64,
    target: impl Fn(&ArmObservation, &[f64; N]) -> TipTarget,
) -> Vec<Chunk> {
    let arms = observation.arms;
    let Some(first) = arms.first() else {
        return Vec::new();
    };
    let (rows, _) = actions.as_chunks::<N>();
    let chunk = |(index, arm): (usize, &ArmObservation)| {
        let targets: Vec<TipTarget> = rows
            .iter()
            .skip(index)
            .step_by(arms.len())
            .map(|row| target(arm, &row.map(f64::from)))
            .collect();
        Chunk::new(first.state.stamp, sequence, step_ns, &targets)
    };
    arms.iter().enumerate().map(chunk).collect()
}

#[cfg(test)]
mod tests {
    use hal::{ArmObservation, ArmState, JointVector, Observation, TimeNs};

    use super::{absolute_chunks, absolute_target, pose_from_numbers, relative_action};
    use hal::random::SplitMix64;

    #[test]
    fn each_arm_gets_its_own_chunk_relative_to_its_own_tip() {
        let arm = |z: f64, stamp| ArmObservation {
            state: ArmState::at_rest(TimeNs(stamp), JointVector::zeros(), 0.0),
            tip_in_rcm: pose_from_numbers(&[0.0, 0.0, z, 0.0, 0.0, 0.0, 1.0]),
        };
        let observation = Observation {
            arms: &[arm(-0.1, 7), arm(-0.2, 7)],
            frames: &[],
        };
        // Two steps; the x of each number says which row it came from.
        let mut actions = [0.0; 28];
        for (row, numbers) in actions.chunks_exact_mut(7).enumerate() {
            numbers[0] = f32::from(u8::try_from(row).unwrap());
            numbers[6] = 0.5;
        }
        let chunks = absolute_chunks(&observation, &actions, 3, 40);
        assert_eq!(chunks.len(), 2);
        for (index, (chunk, z)) in chunks.iter().zip([-0.1, -0.2]).enumerate() {
            assert_eq!(
                (chunk.observed_at, chunk.sequence, chunk.step_ns, chunk.len),
                (TimeNs(7), 3, 40, 2)
            );
            for (step, target) in chunk.valid_targets().iter().enumerate() {
                let row = f64::from(u8::try_from(2 * step + index).unwrap());
                assert!((target.position_m[0] - row).abs() < 1e-12, "{target:?}");
                assert!((target.position_m[2] - z).abs() < 1e-12, "{target:?}");
                assert!((target.jaw - 0.5).abs() < 1e-12, "{target:?}");
            }
        }
        let alone = Observation {
            arms: &observation.arms[..1],
            frames: &[],
        };
        let [chunk] = absolute_chunks(&alone, &actions, 3, 40)[..] else {
            panic!("one arm, one chunk");
        };
        assert_eq!(chunk.len, 4);
    }

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

    /// Translation is in the RCM frame and rotation in the tool frame.
    #[test]
    fn translation_is_in_rcm_and_rotation_in_tool_frame() {
        let half = core::f64::consts::FRAC_1_SQRT_2;
        // The tool is turned by a quarter about the RCM's z.
        let tip = pose_from_numbers(&[0.0, 0.0, 0.0, 0.0, 0.0, half, half]);
        let target = absolute_target(&tip, &[0.01, 0.0, 0.0, 0.1, 0.0, 0.0, 0.0]);
        assert!((target.position_m[0] - 0.01).abs() < 1e-15);
        let turned_about = (target.tip_in_rcm().rotation * tip.rotation.inverse()).scaled_axis();
        assert!((turned_about.y - 0.1).abs() < 1e-12, "{turned_about}");
    }
}
