//! The simulator's own kinematics: the rows of the arm's table multiplied out, one frame a joint.

use hal::psm::{DH, DhRow, JAW_MAX, TIP_FROM_WRIST_YAW};
use hal::{JOINT_COUNT, JointVector, Pose};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// Where every link of the arm is, in the scene frame.
#[derive(Clone, Debug)]
pub(crate) struct Chain {
    /// Frame after each joint; the joint moves about (along) its z.
    pub(crate) frames: [Pose; JOINT_COUNT],
    /// Tip frame: origin on the wrist-yaw axis, z along the closed fingers, x along their hinge.
    pub(crate) tip: Pose,
}

/// A force with its moment about a named point.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Wrench {
    /// N.
    pub(crate) force: Vector3<f64>,
    /// N m.
    pub(crate) moment: Vector3<f64>,
}

impl Wrench {
    pub(crate) fn add(&mut self, other: &Self) {
        self.force += other.force;
        self.moment += other.moment;
    }
}

impl Chain {
    /// The links at `joints` (rad, insertion m) of an arm whose remote centre is at
    /// `scene_from_rcm`.
    pub(crate) fn new(scene_from_rcm: &Pose, joints: &JointVector) -> Self {
        let mut frame = *scene_from_rcm;
        let frames = core::array::from_fn(|joint| {
            frame *= link(&DH[joint], joints[joint]);
            frame
        });
        Self {
            frames,
            tip: frame * tip_from_last(),
        }
    }

    /// Frame of a finger: the tip frame turned about its x by half the opening, `side` +1 for the
    /// left finger, which opens towards +y, and -1 for the right one.
    pub(crate) fn finger(&self, jaw: f64, side: f64) -> Pose {
        let half = 0.5 * jaw.clamp(0.0, JAW_MAX);
        self.tip * UnitQuaternion::from_axis_angle(&Vector3::x_axis(), -side * half)
    }

    /// Joint efforts that a wrench, with its moment taken about the tip frame's origin, puts on the
    /// joints.
    pub(crate) fn joint_efforts(&self, wrench: &Wrench) -> JointVector {
        let mut efforts = JointVector::zeros();
        for (joint, frame) in self.frames.iter().enumerate() {
            let axis = frame.rotation * Vector3::z();
            efforts[joint] = if DH[joint].prismatic {
                axis.dot(&wrench.force)
            } else {
                let arm = self.tip.translation.vector - frame.translation.vector;
                axis.dot(&(wrench.moment + arm.cross(&wrench.force)))
            };
        }
        efforts
    }
}

fn link(row: &DhRow, joint: f64) -> Pose {
    let (theta, d) = if row.prismatic {
        (row.theta, row.d + joint)
    } else {
        (row.theta + joint, row.d)
    };
    let twist = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), row.alpha);
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), theta);
    let offset = Vector3::new(row.a, 0.0, 0.0) + twist * Vector3::new(0.0, 0.0, d);
    Pose::from_parts(Translation3::from(offset), twist * turn)
}

fn tip_from_last() -> UnitQuaternion<f64> {
    let [a, b, c] = TIP_FROM_WRIST_YAW;
    let rows = Matrix3::new(a[0], a[1], a[2], b[0], b[1], b[2], c[0], c[1], c[2]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rows))
}

#[cfg(test)]
mod tests {
    use super::*;
    use core::f64::consts::FRAC_1_SQRT_2;
    use nalgebra::Quaternion;

    #[test]
    fn tip_matches_the_published_vectors() {
        let cases = [
            (
                [0.0, 0.0, 0.12, 0.0, 0.0, 0.0],
                [0.0, 0.0, -0.1135],
                [FRAC_1_SQRT_2, FRAC_1_SQRT_2, 0.0, 0.0],
            ),
            (
                [0.1, 0.2, 0.15, 0.3, -0.4, 0.5],
                [0.015_079_393, -0.025_048_387, -0.139_801_106],
                [0.768_178_375, 0.542_570_219, 0.283_771_532, 0.187_064_851],
            ),
            (
                [1.2, -0.8, 0.06, 4.0, -1.3, 1.3],
                [0.031_839_635, 0.029_603_725, -0.019_498_399],
                [0.412_320_058, -0.806_572_597, -0.374_851_843, 0.197_278_765],
            ),
        ];
        for (joints, [px, py, pz], [x, y, z, w]) in cases {
            let tip = Chain::new(&Pose::identity(), &JointVector::from(joints)).tip;
            assert!((tip.translation.vector - Vector3::new(px, py, pz)).norm() < 2e-9);
            let expected = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
            assert!(tip.rotation.angle_to(&expected) < 1e-8);
        }
    }

    #[test]
    fn joint_efforts_do_the_work_of_the_wrench() {
        let joints = JointVector::from([0.3, -0.4, 0.14, 0.7, 0.5, -0.6]);
        let base = Pose::translation(0.1, 0.2, 0.3);
        let chain = Chain::new(&base, &joints);
        let wrench = Wrench {
            force: Vector3::new(1.0, -2.0, 0.5),
            moment: Vector3::new(0.01, 0.03, -0.02),
        };
        let efforts = chain.joint_efforts(&wrench);
        for joint in 0..JOINT_COUNT {
            let mut moved = joints;
            moved[joint] += 1e-7;
            let there = Chain::new(&base, &moved).tip;
            let shift = there.translation.vector - chain.tip.translation.vector;
            let turn = (there.rotation * chain.tip.rotation.inverse()).scaled_axis();
            let work = (shift.dot(&wrench.force) + turn.dot(&wrench.moment)) / 1e-7;
            assert!(
                (work - efforts[joint]).abs() < 1e-6,
                "joint {joint}: {work} against {}",
                efforts[joint]
            );
        }
    }
}
