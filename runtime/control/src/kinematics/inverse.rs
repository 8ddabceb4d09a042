//! Tip pose to joints, in closed form. Hot path: bounded, no allocation, no I/O, no lock.

use core::f64::consts::TAU;
use core::fmt;

use hal::joints::ROLL;
use hal::psm::{POSITION_MAX, POSITION_MIN, WRIST_M};
use hal::{JOINT_COUNT, JointVector, Pose};

use super::forward::INSERTION_OFFSET_M;

/// The wrist must stay this far from the RCM, m: closer, the first joints have no direction.
const WRIST_DISTANCE_MIN_M: f64 = 1e-3;

/// Rounding allowed on a joint limit, rad (m).
const LIMIT_TOLERANCE: f64 = 1e-9;

/// Why a pose has no joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum IkError {
    /// The pose holds NaN or infinity.
    NotFinite,
    /// The wrist-yaw axis passes through the remote centre, or the wrist is there.
    AtRemoteCentre {
        /// Distance that was too short, m.
        distance_m: f64,
    },
    /// The pose needs a joint outside its range.
    OutOfRange {
        /// Joint index.
        joint: usize,
        /// The value it would need, rad (m).
        value: f64,
    },
}

impl fmt::Display for IkError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::NotFinite => write!(f, "the pose is not finite"),
            Self::AtRemoteCentre { distance_m } => {
                write!(f, "the wrist is {distance_m} m from the remote centre")
            }
            Self::OutOfRange { joint, value } => {
                write!(f, "joint {joint} would have to be at {value}")
            }
        }
    }
}

impl std::error::Error for IkError {}

/// The joints that put the tip at `tip_in_rcm`, with the roll's full turns chosen nearest to
/// `near_roll` (rad).
///
/// # Errors
/// [`IkError`]; joints outside the dVRK's ranges are refused.
pub fn inverse(tip_in_rcm: &Pose, near_roll: f64) -> Result<JointVector, IkError> {
    let joints = solve(tip_in_rcm, near_roll)?;
    let outside = |&joint: &usize| {
        let low = POSITION_MIN[joint] - LIMIT_TOLERANCE;
        let high = POSITION_MAX[joint] + LIMIT_TOLERANCE;
        !(low..=high).contains(&joints[joint])
    };
    match (0..JOINT_COUNT).find(outside) {
        Some(joint) => Err(IkError::OutOfRange {
            joint,
            value: joints[joint],
        }),
        None => Ok(joints),
    }
}

/// Like [`inverse`], but a joint outside `low..=high` is brought to its nearest limit; the flag
/// tells whether one was.
///
/// # Errors
/// [`IkError::NotFinite`] and [`IkError::AtRemoteCentre`].
pub fn inverse_clamped(
    tip_in_rcm: &Pose,
    near_roll: f64,
    low: &JointVector,
    high: &JointVector,
) -> Result<(JointVector, bool), IkError> {
    let mut joints = solve(tip_in_rcm, near_roll)?;
    // A turn that leaves the range is unwound before it is clamped.
    if joints[ROLL] > high[ROLL] && joints[ROLL] - TAU >= low[ROLL] {
        joints[ROLL] -= TAU;
    } else if joints[ROLL] < low[ROLL] && joints[ROLL] + TAU <= high[ROLL] {
        joints[ROLL] += TAU;
    }
    let mut clamped = false;
    for joint in 0..JOINT_COUNT {
        let inside = joints[joint].max(low[joint]).min(high[joint]);
        clamped |= (inside - joints[joint]).abs() > LIMIT_TOLERANCE;
        joints[joint] = inside;
    }
    Ok((joints, clamped))
}

/// The closed form: the wrist-yaw axis is known from the rotation, so the link to the wrist-pitch
/// axis lies along the part of the tip's position that is normal to it. From the wrist point follow
/// the first three joints, from what remains of the rotation the last three.
fn solve(tip_in_rcm: &Pose, near_roll: f64) -> Result<JointVector, IkError> {
    let rotation = tip_in_rcm.rotation.to_rotation_matrix();
    let rotation = rotation.matrix();
    let tip_m = tip_in_rcm.translation.vector;
    if !(tip_m.iter().chain(rotation.iter()).all(|x| x.is_finite()) && near_roll.is_finite()) {
        return Err(IkError::NotFinite);
    }
    let x = rotation.column(0).into_owned();
    let approach = rotation.column(2).into_owned();

    let normal_part = tip_m - x * tip_m.dot(&x);
    let normal_m = normal_part.norm();
    if normal_m < WRIST_DISTANCE_MIN_M {
        return Err(IkError::AtRemoteCentre {
            distance_m: normal_m,
        });
    }
    let wrist_link = normal_part / normal_m;
    let wrist_m = tip_m - wrist_link * WRIST_M;
    let distance_m = wrist_m.norm();
    if distance_m < WRIST_DISTANCE_MIN_M {
        return Err(IkError::AtRemoteCentre { distance_m });
    }

    let shaft = wrist_m / distance_m;
    let yaw = shaft.x.atan2(-shaft.z);
    let pitch = -shaft.y.atan2(shaft.x.hypot(shaft.z));
    let (s1, c1) = yaw.sin_cos();
    let (s2, c2) = pitch.sin_cos();
    let pitch_axis = nalgebra::Vector3::new(-c1, 0.0, -s1);
    let shaft_side = nalgebra::Vector3::new(-s1 * s2, -c2, c1 * s2);

    let wrist_pitch = shaft.dot(&x).atan2(shaft.dot(&wrist_link));
    let (s5, c5) = wrist_pitch.sin_cos();
    let rolled_side = wrist_link * s5 - x * c5;
    let roll = rolled_side
        .dot(&pitch_axis)
        .atan2(rolled_side.dot(&shaft_side));
    let turns = ((near_roll - roll) / TAU).round();

    let wrist_pitch_axis = x.cross(&wrist_link);
    let wrist_yaw = (-approach.dot(&wrist_pitch_axis)).atan2(approach.dot(&wrist_link));
    Ok(JointVector::new(
        yaw,
        pitch,
        distance_m + INSERTION_OFFSET_M,
        roll + turns * TAU,
        wrist_pitch,
        wrist_yaw,
    ))
}
