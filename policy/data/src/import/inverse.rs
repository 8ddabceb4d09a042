//! Joints of a patient-side manipulator from the pose of its tip, in closed form.
//!
//! The wrist-yaw axis is known from the tip's rotation, and the link from the wrist-pitch axis to
//! the tip is normal to it and lies in the plane of that axis and the RCM. So the wrist-pitch axis
//! is known; yaw, pitch and insertion follow from where it is, the wrist's three joints from the
//! remaining rotation.

use std::f64::consts::TAU;

use hal::joints::{JOINT_NAMES, ROLL};
use hal::psm::{POSITION_MAX, POSITION_MIN, RCC_M, TIP_FROM_WRIST_YAW, TOOL_M, WRIST_M};
use hal::{JOINT_COUNT, Pose};
use nalgebra::{Matrix3, Vector3};

/// What rounding, calibration and noise may add at a limit, rad (m).
pub(super) const SLACK: f64 = 0.02;
/// Closer to the RCM the first joints have no direction, m. Beyond it rounding and noise are small
/// against the distance.
const WRIST_DISTANCE_MIN_M: f64 = 1e-3;

/// Why the arm can't be there.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum OutOfReach {
    /// The tip or the wrist is at the remote centre.
    AtRemoteCentre,
    /// A joint would have to be beyond its limits.
    Joint {
        /// Index of the joint.
        joint: usize,
        /// Where it would have to be, rad (m).
        value: f64,
    },
}

impl std::fmt::Display for OutOfReach {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match *self {
            Self::AtRemoteCentre => write!(f, "it is at the remote centre"),
            Self::Joint { joint, value } => {
                let (name, min, max) =
                    (JOINT_NAMES[joint], POSITION_MIN[joint], POSITION_MAX[joint]);
                write!(f, "{name} = {value:.4} is outside [{min:.3}, {max:.3}]")
            }
        }
    }
}

/// The joints (rad, insertion m) that put the tip at `tip_in_rcm`, with the roll's full turn
/// nearest to `near_roll` (rad).
///
/// For the dVRK's patient-side manipulator with a Large Needle Driver only; other chains are not
/// solved here. Of the two poses of the wrist it takes the one whose link points away from the RCM.
/// Costs a few trigonometric functions and does not iterate.
///
/// # Errors
/// [`OutOfReach`] if there are none within the arm's limits and [`SLACK`].
pub(super) fn joints_at(
    tip_in_rcm: &Pose,
    near_roll: f64,
) -> Result<[f64; JOINT_COUNT], OutOfReach> {
    let tip_m = tip_in_rcm.translation.vector;
    let tip_from_wrist = Matrix3::from_fn(|row, column| TIP_FROM_WRIST_YAW[row][column]);
    let wrist = tip_in_rcm.rotation.to_rotation_matrix().matrix() * tip_from_wrist.transpose();
    let yaw_axis: Vector3<f64> = wrist.column(2).into_owned();
    let link = direction(tip_m - yaw_axis * tip_m.dot(&yaw_axis))?.0;
    let (shaft, depth_m) = direction(tip_m - link * WRIST_M)?;

    let yaw = shaft.x.atan2(-shaft.z);
    let pitch = -shaft.y.atan2(shaft.x.hypot(shaft.z));
    let ((s1, c1), (s2, c2)) = (yaw.sin_cos(), pitch.sin_cos());
    // The carriage's axes in the RCM frame; the third is the shaft.
    let across = Vector3::new(-s1 * s2, -c2, c1 * s2);
    let aside = shaft.cross(&across);
    let pitch_axis = link.cross(&yaw_axis);
    let roll = (-pitch_axis.dot(&across)).atan2(pitch_axis.dot(&aside));
    let (s4, c4) = roll.sin_cos();
    let wrist_pitch = link
        .dot(&(across * c4 + aside * s4))
        .atan2(link.dot(&shaft));
    let finger: Vector3<f64> = wrist.column(0).into_owned();
    let wrist_yaw = finger.dot(&link).atan2(finger.dot(&pitch_axis));

    let mut joints = [
        yaw,
        pitch,
        depth_m + RCC_M - TOOL_M,
        roll,
        wrist_pitch,
        wrist_yaw,
    ];
    joints[ROLL] += TAU * ((near_roll - roll) / TAU).round();
    unwind(&mut joints[ROLL]);
    within_limits(joints)
}

/// Direction and length of `vector` from the RCM. Fails closer than [`WRIST_DISTANCE_MIN_M`].
fn direction(vector: Vector3<f64>) -> Result<(Vector3<f64>, f64), OutOfReach> {
    let length = vector.norm();
    if length < WRIST_DISTANCE_MIN_M {
        return Err(OutOfReach::AtRemoteCentre);
    }
    Ok((vector / length, length))
}

/// Takes back a turn that leads beyond the roll's limits.
fn unwind(roll: &mut f64) {
    if *roll > POSITION_MAX[ROLL] + SLACK {
        *roll -= TAU;
    } else if *roll < POSITION_MIN[ROLL] - SLACK {
        *roll += TAU;
    }
}

/// The joints, or the first that is beyond its limits.
fn within_limits(joints: [f64; JOINT_COUNT]) -> Result<[f64; JOINT_COUNT], OutOfReach> {
    let outside = |&joint: &usize| {
        let limits = POSITION_MIN[joint] - SLACK..=POSITION_MAX[joint] + SLACK;
        !limits.contains(&joints[joint])
    };
    match (0..JOINT_COUNT).find(outside) {
        None => Ok(joints),
        Some(joint) => Err(OutOfReach::Joint {
            joint,
            value: joints[joint],
        }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::import::chain::tip_in_rcm;
    use hal::psm::DH;
    use hal::random::SplitMix64;

    /// Joints anywhere within the limits, insertion from where the wrist is beyond the RCM on.
    fn drawn(random: &mut SplitMix64) -> [f64; JOINT_COUNT] {
        std::array::from_fn(|joint| {
            let low = if joint == 2 {
                0.03
            } else {
                POSITION_MIN[joint]
            };
            low + random.unit() * (POSITION_MAX[joint] - low)
        })
    }

    #[test]
    fn joints_are_those_that_forward_kinematics_was_given() {
        let mut random = SplitMix64::named("joints", 11);
        for _ in 0..2000 {
            let joints = drawn(&mut random);
            let pose = tip_in_rcm(&DH, &joints);
            let found = joints_at(&pose, joints[ROLL]).unwrap();
            for joint in 0..JOINT_COUNT {
                let apart = (found[joint] - joints[joint]).abs();
                assert!(apart < 1e-9, "{joints:?} {found:?}");
            }
        }
    }

    #[test]
    fn roll_stays_within_its_limits() {
        let joints = [0.1, -0.2, 0.1, 2.5, 0.3, -0.4];
        let pose = tip_in_rcm(&DH, &joints);
        let found = joints_at(&pose, 8.0).unwrap();
        assert!((found[ROLL] - 2.5).abs() < 1e-9, "{found:?}");
        let found = joints_at(&pose, -2.0).unwrap();
        assert!((found[ROLL] - (2.5 - TAU)).abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn what_is_out_of_reach_names_the_joint() {
        let pose = tip_in_rcm(&DH, &[0.0, 0.0, 0.3, 0.0, 0.0, 0.0]);
        let error = joints_at(&pose, 0.0).unwrap_err();
        let told = error.to_string();
        assert_eq!(told, "insertion = 0.3000 is outside [0.000, 0.240]");
        assert_eq!(
            joints_at(&Pose::identity(), 0.0),
            Err(OutOfReach::AtRemoteCentre)
        );
    }
}
