//! Forward kinematics for the checker: the product of the elementary motions of each row of the
//! arm's table.
//!
//! Each row of `hal::psm::DH` is `Rx(alpha) Tx(a) Rz(theta) Tz(d)` (Craig's modified convention),
//! multiplied as quaternions and translations. A jaw angle below zero presses the fingers together,
//! and moves nothing.

use hal::psm::{DH, DhRow, FINGER_M, JAW_MAX, TIP_FROM_WRIST_YAW};
use hal::{JointVector, Pose};
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Parts of the instrument.
pub(super) const LINKS: usize = 4;

/// What limits call the parts of the instrument, in the order of [`Instrument::links`].
pub(super) const LINK_NAMES: [&str; LINKS] = ["shaft", "wrist", "left_finger", "right_finger"];

/// What limits call the points that the workspace is for, in the order of [`Instrument::points`].
pub(super) const POINT_NAMES: [&str; 3] = ["control_point", "left_finger_tip", "right_finger_tip"];

/// The points of the instrument that limits speak of, scene frame, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Instrument {
    /// Where the shaft begins.
    pub(super) remote_centre: Point3<f64>,
    /// Where the shaft ends, on the wrist-pitch axis.
    pub(super) wrist_pitch: Point3<f64>,
    /// On the wrist-yaw axis: the tip of speeds and of the workspace.
    pub(super) control_point: Point3<f64>,
    /// Left, towards the tip frame's y, and right.
    pub(super) finger_tips: [Point3<f64>; 2],
    /// Of the tip frame.
    pub(super) rotation: UnitQuaternion<f64>,
}

impl Instrument {
    /// Where the instrument is at `joints` with the jaw at `jaw` rad.
    pub(super) fn new(scene_from_rcm: &Pose, joints: &JointVector, jaw: f64) -> Self {
        let mut frame = *scene_from_rcm;
        let mut wrist_pitch = frame;
        for (row, &value) in DH.iter().zip(joints.iter()) {
            // The frame before the last sits on the wrist-pitch axis.
            wrist_pitch = frame;
            frame *= link_from_next(row, value);
        }
        let tip = frame * tip_from_last();
        let half = 0.5 * jaw.clamp(0.0, JAW_MAX);
        let finger_tip =
            |side: f64| tip * Point3::new(0.0, FINGER_M * side * half.sin(), FINGER_M * half.cos());
        Self {
            remote_centre: scene_from_rcm.translation.vector.into(),
            wrist_pitch: frame_origin(&wrist_pitch),
            control_point: frame_origin(&tip),
            finger_tips: [finger_tip(1.0), finger_tip(-1.0)],
            rotation: tip.rotation,
        }
    }

    /// Both ends of every part's centre line.
    pub(super) const fn links(&self) -> [(Point3<f64>, Point3<f64>); LINKS] {
        let [left, right] = self.finger_tips;
        [
            (self.remote_centre, self.wrist_pitch),
            (self.wrist_pitch, self.control_point),
            (self.control_point, left),
            (self.control_point, right),
        ]
    }

    /// The points that the workspace is for.
    pub(super) const fn points(&self) -> [Point3<f64>; 3] {
        let [left, right] = self.finger_tips;
        [self.control_point, left, right]
    }
}

/// Tip pose in the RCM frame at `joints`.
///
/// Multiplied out row by row, where the controller has a closed form: a mistake in one is not
/// repeated in the other.
#[must_use]
pub fn tip_in_rcm(joints: &JointVector) -> Pose {
    let rows = DH.iter().zip(joints.iter());
    let last = rows.fold(Pose::identity(), |chain, (row, &value)| {
        chain * link_from_next(row, value)
    });
    last * tip_from_last()
}

fn frame_origin(frame: &Pose) -> Point3<f64> {
    frame.translation.vector.into()
}

/// From the last row's frame, that of the wrist's yaw, to the tip's.
fn tip_from_last() -> UnitQuaternion<f64> {
    let tip = TIP_FROM_WRIST_YAW;
    let rotation = Matrix3::from_fn(|row, column| tip[row][column]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation))
}

/// `Rx(alpha) Tx(a) Rz(theta) Tz(d)` with the joint's value in its place.
fn link_from_next(row: &DhRow, value: f64) -> Pose {
    let (theta, d) = if row.prismatic {
        (row.theta, row.d + value)
    } else {
        (row.theta + value, row.d)
    };
    let about_x = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), row.alpha);
    let about_z = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), theta);
    about_x * Translation3::new(row.a, 0.0, 0.0) * about_z * Translation3::new(0.0, 0.0, d)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_home_the_shaft_points_straight_down() {
        let mut joints = JointVector::zeros();
        joints[2] = 0.12;
        let scene_from_rcm = Pose::translation(0.01, 0.02, 0.15);
        let at = Instrument::new(&scene_from_rcm, &joints, 0.0);
        let wrist = 0.15 - (0.12 - 0.4318 + 0.4162);
        for (point, height) in [
            (at.remote_centre, 0.15),
            (at.wrist_pitch, wrist),
            (at.control_point, wrist - 0.0091),
            (at.finger_tips[0], wrist - 0.0091 - 0.0102),
            (at.finger_tips[1], wrist - 0.0091 - 0.0102),
        ] {
            let expected = Point3::new(0.01, 0.02, height);
            assert!((point - expected).norm() < 1e-12, "{at:?}");
        }
    }

    #[test]
    fn fingers_open_by_half_the_jaw_angle_to_either_side() {
        let joints = JointVector::new(0.3, -0.2, 0.13, 0.7, 0.4, -0.5);
        let tip = tip_in_rcm(&joints);
        let lean = |jaw: f64| {
            let at = Instrument::new(&Pose::identity(), &joints, jaw);
            at.finger_tips.map(|point| {
                let seen = tip.inverse_transform_point(&point);
                assert!(seen.x.abs() < 1e-15 && (seen.coords.norm() - FINGER_M).abs() < 1e-15);
                seen.y.atan2(seen.z)
            })
        };
        for (jaw, half) in [
            (0.8, 0.4),
            (0.0, 0.0),
            (-0.5, 0.0),
            (1.39, 0.695),
            (2.0, JAW_MAX / 2.0),
        ] {
            let [left, right] = lean(jaw);
            assert!(
                (left - half).abs() < 1e-12 && (right + half).abs() < 1e-12,
                "{jaw}"
            );
        }
    }
}
