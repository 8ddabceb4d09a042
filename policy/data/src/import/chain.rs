//! Where the tip is: the product of an arm's Denavit-Hartenberg rows, whichever arm it is.
//!
//! Modified Denavit-Hartenberg (Craig): `T = Rx(alpha) Tx(a) Rz(theta) Tz(d)` a row, where the
//! joint's value is added to `theta`, or to `d` if it slides.

use std::path::Path;

use hal::psm::{DhRow, TIP_FROM_WRIST_YAW};
use hal::{JOINT_COUNT, Pose, files};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::ImportError;
use crate::dataset::TIP_POSE_WIDTH;

/// Reads another arm's chain: JSON with six rows `[twist, length, offset along, offset about,
/// slides]` in rad and m, modified Denavit-Hartenberg as in [`DhRow`]. The tip frame lies to the
/// last joint's as that of the patient-side manipulator.
///
/// # Errors
/// [`ImportError::Io`]; [`ImportError::Chain`] for another number of rows, another type, or a
/// number beyond ±100.
pub fn read_chain(path: &Path) -> Result<[DhRow; JOINT_COUNT], ImportError> {
    let refuse = |reason: String| ImportError::Chain {
        path: path.to_owned(),
        reason,
    };
    let text = files::read(path, "a chain", files::JSON_SIZE_MAX);
    let text = text.map_err(|source| ImportError::Io {
        path: path.to_owned(),
        source,
    })?;
    type Row = (f64, f64, f64, f64, bool);
    let expected = "expected six rows [twist, length, offset along, offset about, slides]";
    let rows: Vec<Row> =
        serde_json::from_slice(&text).map_err(|error| refuse(format!("{error}; {expected}")))?;
    let rows: [Row; JOINT_COUNT] = rows
        .try_into()
        .map_err(|rows: Vec<Row>| refuse(format!("has {} rows, expected 6", rows.len())))?;
    for (row, (alpha, a, d, theta, _)) in (1..).zip(&rows) {
        let numbers = [alpha, a, d, theta];
        if let Some(value) = numbers.into_iter().find(|value| value.abs() > 100.0) {
            let reason = format!("row {row}: {value} is outside [-100, 100] (rad, m)");
            return Err(refuse(reason));
        }
    }
    Ok(rows.map(|(alpha, a, d, theta, prismatic)| DhRow {
        alpha,
        a,
        d,
        theta,
        prismatic,
    }))
}

/// The tip's pose in the RCM frame at `joints` (rad, insertion m).
///
/// Rotation and position are accumulated separately; the last factor is the fixed rotation from the
/// wrist-yaw frame to the tip frame.
pub(super) fn tip_in_rcm(chain: &[DhRow; JOINT_COUNT], joints: &[f64]) -> Pose {
    let mut rotation = Matrix3::identity();
    let mut position_m = Vector3::zeros();
    for (row, &joint) in chain.iter().zip(joints) {
        let (along, about) = match row.prismatic {
            true => (row.d + joint, row.theta),
            false => (row.d, row.theta + joint),
        };
        let ((sa, ca), (st, ct)) = (row.alpha.sin_cos(), about.sin_cos());
        position_m += rotation * Vector3::new(row.a, -sa * along, ca * along);
        #[rustfmt::skip]
        let turn = Matrix3::new(
            ct, -st, 0.0,
            st * ca, ct * ca, -sa,
            st * sa, ct * sa, ca,
        );
        rotation *= turn;
    }
    let tip = Matrix3::from_fn(|row, column| TIP_FROM_WRIST_YAW[row][column]);
    let rotation = Rotation3::from_matrix_unchecked(rotation * tip);
    Pose::from_parts(
        Translation3::from(position_m),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

/// Poses as datasets have them. Of a turn's two quaternions each has the one that is nearer to the
/// one before; the first has its greatest number positive.
///
/// `q` and `-q` are the same rotation, and a network that regresses one of them must not see the
/// sign flip within an episode.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct PoseNumbers {
    /// The quaternion x, y, z, w of the step before; none in the first.
    before: Option<[f64; 4]>,
}

impl PoseNumbers {
    /// `pose` as x, y, z (m) and a unit quaternion x, y, z, w.
    pub(super) fn of(&mut self, pose: &Pose) -> [f64; TIP_POSE_WIDTH] {
        let turn = pose.rotation.coords;
        let mut turn = [turn.x, turn.y, turn.z, turn.w];
        let side = match self.before {
            Some(before) => before.iter().zip(turn).map(|(a, b)| a * b).sum(),
            None => turn.iter().fold(
                0.0_f64,
                |most, &part| {
                    if part.abs() > most.abs() { part } else { most }
                },
            ),
        };
        if side < 0.0 {
            turn = turn.map(|part| -part);
        }
        self.before = Some(turn);
        let at = pose.translation.vector;
        [at.x, at.y, at.z, turn[0], turn[1], turn[2], turn[3]]
    }
}
