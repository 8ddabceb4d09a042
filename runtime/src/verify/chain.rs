//! Forward kinematics for the checker: the product of the elementary motions of each row of the arm's table.

use hal::psm::{DH, DhRow, FINGER_M, TIP_FROM_WRIST_YAW};
use hal::{JointVector, Pose};
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// The points of the instrument's centre line that limits speak of, RCM frame, m; the line begins in the RCM.
#[derive(Clone, Copy, Debug)]
pub(super) struct Instrument {
    pub(super) wrist_pitch: Point3<f64>,
    pub(super) control_point: Point3<f64>,
    pub(super) finger_tips: Point3<f64>,
}

/// Tip pose in the RCM frame at `joints`.
///
/// Multiplied out row by row, where the controller has a closed form: a mistake in one is not repeated in the other.
#[must_use]
pub fn tip_in_rcm(joints: &JointVector) -> Pose {
    let tip = TIP_FROM_WRIST_YAW;
    let rotation = Matrix3::from_fn(|row, column| tip[row][column]);
    rcm_from_link(joints, DH.len())
        * UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation))
}

/// Where the instrument is at `joints`.
pub(super) fn instrument(joints: &JointVector) -> Instrument {
    let tip = tip_in_rcm(joints);
    Instrument {
        // The fifth frame sits on the wrist-pitch axis.
        wrist_pitch: rcm_from_link(joints, DH.len() - 1)
            .translation
            .vector
            .into(),
        control_point: tip.translation.vector.into(),
        finger_tips: tip * Point3::new(0.0, 0.0, FINGER_M),
    }
}

fn rcm_from_link(joints: &JointVector, links: usize) -> Pose {
    let rows = DH.iter().zip(joints.iter()).take(links);
    rows.fold(Pose::identity(), |chain, (row, &value)| {
        chain * link_from_next(row, value)
    })
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

/// Distance from `point` to the segment from `start` to `end`.
pub(super) fn distance_to_segment(
    point: &Point3<f64>,
    start: &Point3<f64>,
    end: &Point3<f64>,
) -> f64 {
    let along = end - start;
    let length_squared = along.norm_squared();
    let fraction = if length_squared > 0.0 {
        (point - start).dot(&along) / length_squared
    } else {
        0.0
    };
    (point - (start + along * fraction.clamp(0.0, 1.0))).norm()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn at_home_the_shaft_points_straight_down() {
        let mut joints = JointVector::zeros();
        joints[2] = 0.12;
        let at = instrument(&joints);
        let depth = 0.12 - 0.4318 + 0.4162;
        assert!(
            (at.wrist_pitch - Point3::new(0.0, 0.0, -depth)).norm() < 1e-12,
            "{at:?}"
        );
        assert!(
            (at.control_point - Point3::new(0.0, 0.0, -depth - 0.0091)).norm() < 1e-12,
            "{at:?}"
        );
        assert!(
            (at.finger_tips - Point3::new(0.0, 0.0, -depth - 0.0091 - 0.0102)).norm() < 1e-12,
            "{at:?}"
        );
    }

    #[test]
    fn distance_ends_at_the_ends() {
        let (start, end) = (Point3::origin(), Point3::new(0.0, 0.0, 1.0));
        let distance = |x, z| distance_to_segment(&Point3::new(x, 0.0, z), &start, &end);
        assert!((distance(2.0, 0.5) - 2.0).abs() < 1e-15);
        assert!((distance(3.0, 5.0) - 5.0).abs() < 1e-15);
        assert!((distance(3.0, -4.0) - 5.0).abs() < 1e-15);
        assert!((distance_to_segment(&end, &start, &start) - 1.0).abs() < 1e-15);
    }
}
