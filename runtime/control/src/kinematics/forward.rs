//! Joints to tip: axes, points, pose and Jacobian. Hot path: bounded, no allocation, no I/O, no
//! lock.

use hal::psm::{FINGER_M, RCC_M, TOOL_M, WRIST_M};
use hal::{JointVector, Pose};
use nalgebra::{Matrix3, Matrix6, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Distance from the RCM to the wrist-pitch axis is the insertion less this, m.
pub(super) const INSERTION_OFFSET_M: f64 = RCC_M - TOOL_M;

/// The joint axes and points of one configuration, in the RCM frame.
///
/// The product of the DH rows (`hal::psm::DH`), multiplied out: every axis is a combination of the
/// previous two, so no matrix product is needed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frames {
    /// Axis of the yaw joint, unit.
    pub yaw_axis: Vector3<f64>,
    /// Axis of the pitch joint, unit.
    pub pitch_axis: Vector3<f64>,
    /// Direction of the shaft away from the RCM, unit; insertion and roll axis.
    pub shaft: Vector3<f64>,
    /// Axis of the wrist-pitch joint, unit.
    pub wrist_pitch_axis: Vector3<f64>,
    /// Direction from the wrist-pitch axis to the tip, unit.
    pub wrist_link: Vector3<f64>,
    /// Axis of the wrist-yaw joint, unit.
    pub wrist_yaw_axis: Vector3<f64>,
    /// Approach direction, the tip's z, unit.
    pub approach: Vector3<f64>,
    /// Where the wrist-pitch axis meets the shaft, m.
    pub wrist_m: Vector3<f64>,
    /// The control point on the wrist-yaw axis, m.
    pub tip_m: Vector3<f64>,
    /// Where the finger tips are when the jaw is closed, m.
    pub finger_m: Vector3<f64>,
}

impl Frames {
    /// The axes and points at `joints`.
    #[must_use]
    pub fn at(joints: &JointVector) -> Self {
        let (s1, c1) = joints[0].sin_cos();
        let (s2, c2) = joints[1].sin_cos();
        let (s4, c4) = joints[3].sin_cos();
        let (s5, c5) = joints[4].sin_cos();
        let (s6, c6) = joints[5].sin_cos();
        let pitch_axis = Vector3::new(-c1, 0.0, -s1);
        let shaft = Vector3::new(s1 * c2, -s2, -c1 * c2);
        let shaft_side = Vector3::new(-s1 * s2, -c2, c1 * s2);
        let rolled_side = shaft_side * c4 + pitch_axis * s4;
        let wrist_pitch_axis = pitch_axis * c4 - shaft_side * s4;
        let wrist_link = rolled_side * s5 + shaft * c5;
        let wrist_yaw_axis = rolled_side * c5 - shaft * s5;
        let approach = wrist_link * c6 - wrist_pitch_axis * s6;
        let wrist_m = shaft * (joints[2] - INSERTION_OFFSET_M);
        let tip_m = wrist_m + wrist_link * WRIST_M;
        Self {
            yaw_axis: Vector3::new(0.0, -1.0, 0.0),
            pitch_axis,
            shaft,
            wrist_pitch_axis,
            wrist_link,
            wrist_yaw_axis,
            approach,
            wrist_m,
            tip_m,
            finger_m: tip_m + approach * FINGER_M,
        }
    }

    /// The tip frame: x against the wrist-yaw axis, z the approach direction.
    #[must_use]
    pub fn tip_in_rcm(&self) -> Pose {
        let x = -self.wrist_yaw_axis;
        let y = self.approach.cross(&x);
        let rotation =
            Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, y, self.approach]));
        Pose::from_parts(
            Translation3::from(self.tip_m),
            UnitQuaternion::from_rotation_matrix(&rotation),
        )
    }

    /// Geometric Jacobian of the tip; see [`jacobian`].
    #[must_use]
    pub fn tip_jacobian(&self) -> Matrix6<f64> {
        let lever = self.tip_m - self.wrist_m;
        let mut jacobian = Matrix6::zeros();
        let mut set = |column: usize, linear: Vector3<f64>, angular: Vector3<f64>| {
            jacobian
                .fixed_view_mut::<3, 1>(0, column)
                .copy_from(&linear);
            jacobian
                .fixed_view_mut::<3, 1>(3, column)
                .copy_from(&angular);
        };
        set(0, self.yaw_axis.cross(&self.tip_m), self.yaw_axis);
        set(1, self.pitch_axis.cross(&self.tip_m), self.pitch_axis);
        set(2, self.shaft, Vector3::zeros());
        set(3, self.shaft.cross(&lever), self.shaft);
        set(
            4,
            self.wrist_pitch_axis.cross(&lever),
            self.wrist_pitch_axis,
        );
        set(5, Vector3::zeros(), self.wrist_yaw_axis);
        jacobian
    }
}

/// Tip pose at `joints`, in the RCM frame.
///
/// Source: dVRK `PSM.json` and `LARGE_NEEDLE_DRIVER_400006.json`.
#[must_use]
pub fn forward(joints: &JointVector) -> Pose {
    Frames::at(joints).tip_in_rcm()
}

/// Tip Jacobian at `joints`.
///
/// Rows `[vx vy vz wx wy wz]` in the RCM frame (m/s, rad/s), columns in joint order (per rad/s,
/// insertion per m/s). Singular where the wrist meets the RCM and at a wrist pitch of a quarter
/// turn, which the joint limits exclude.
#[must_use]
pub fn jacobian(joints: &JointVector) -> Matrix6<f64> {
    Frames::at(joints).tip_jacobian()
}
