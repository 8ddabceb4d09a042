//! The kinematics against the dVRK's numbers, against themselves and against finite differences.

use core::f64::consts::FRAC_1_SQRT_2;

use hal::psm::{DH, POSITION_MAX, POSITION_MIN, TIP_FROM_WRIST_YAW};
use hal::{JOINT_COUNT, JointVector, Pose};
use nalgebra::{Isometry3, Matrix3, Quaternion, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::{Frames, IkError, forward, inverse, inverse_clamped, jacobian};
use hal::random::SplitMix64;

fn random_joints(random: &mut SplitMix64, insertion_min_m: f64) -> JointVector {
    let mut joints = JointVector::zeros();
    for joint in 0..JOINT_COUNT {
        joints[joint] = random.between(POSITION_MIN[joint], POSITION_MAX[joint]);
    }
    joints[2] = random.between(insertion_min_m, POSITION_MAX[2]);
    joints
}

/// The chain as the DH table says, row by row.
fn chain(joints: &JointVector) -> Pose {
    let mut pose = Isometry3::identity();
    for (row, &value) in DH.iter().zip(joints.iter()) {
        let (theta, d) = if row.prismatic {
            (row.theta, row.d + value)
        } else {
            (row.theta + value, row.d)
        };
        pose = pose
            * Isometry3::rotation(Vector3::x() * row.alpha)
            * Isometry3::translation(row.a, 0.0, 0.0)
            * Isometry3::rotation(Vector3::z() * theta)
            * Isometry3::translation(0.0, 0.0, d);
    }
    let tip = Rotation3::from_matrix(&Matrix3::from_fn(|r, c| TIP_FROM_WRIST_YAW[r][c]));
    pose * UnitQuaternion::from_rotation_matrix(&tip)
}

#[test]
fn forward_gives_the_reference_poses() {
    let vectors = [
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
            [-0.7, 0.5, 0.2, -2.0, 1.2, -1.0],
            [-0.101_307_011, -0.086_889_462, -0.132_247_429],
            [-0.190_071_852, 0.829_461_883, -0.422_109_809, 0.312_552_370],
        ),
        (
            [1.2, -0.8, 0.06, 4.0, -1.3, 1.3],
            [0.031_839_635, 0.029_603_725, -0.019_498_399],
            [0.412_320_058, -0.806_572_597, -0.374_851_843, 0.197_278_765],
        ),
    ];
    for (joints, position, [x, y, z, w]) in vectors {
        let tip = forward(&JointVector::from(joints));
        assert!(
            (tip.translation.vector - Vector3::from(position)).norm() < 2e-9,
            "{joints:?}: {tip}"
        );
        let expected = UnitQuaternion::from_quaternion(Quaternion::new(w, x, y, z));
        assert!(tip.rotation.angle_to(&expected) < 3e-9, "{joints:?}: {tip}");
    }
}

#[test]
fn forward_is_the_product_of_the_dh_rows() {
    let mut random = SplitMix64::new(1);
    for _ in 0..2_000 {
        let joints = random_joints(&mut random, 0.0);
        let (closed, product) = (forward(&joints), chain(&joints));
        assert!(
            (closed.translation.vector - product.translation.vector).norm() < 1e-14,
            "{joints}"
        );
        assert!(
            closed.rotation.angle_to(&product.rotation) < 1e-7,
            "{joints}"
        );
    }
}

#[test]
fn jacobian_at_home_is_the_reference() {
    let columns = [
        [0.1135, 0.0, 0.0, 0.0, -1.0, 0.0],
        [0.0, -0.1135, 0.0, -1.0, 0.0, 0.0],
        [0.0, 0.0, -1.0, 0.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, 0.0, -1.0],
        [0.0, -0.0091, 0.0, -1.0, 0.0, 0.0],
        [0.0, 0.0, 0.0, 0.0, -1.0, 0.0],
    ];
    let home = jacobian(&JointVector::new(0.0, 0.0, 0.12, 0.0, 0.0, 0.0));
    for (index, column) in columns.iter().enumerate() {
        let difference = home.column(index) - JointVector::from(*column);
        assert!(
            difference.norm() < 1e-15,
            "column {index}: {}",
            home.column(index)
        );
    }
}

#[test]
fn jacobian_is_the_derivative_of_forward() {
    let mut random = SplitMix64::new(2);
    let step = 1e-6;
    for _ in 0..500 {
        let joints = random_joints(&mut random, 0.0);
        let analytic = jacobian(&joints);
        for joint in 0..JOINT_COUNT {
            let mut delta = JointVector::zeros();
            delta[joint] = step;
            let (before, after) = (forward(&(joints - delta)), forward(&(joints + delta)));
            let linear = (after.translation.vector - before.translation.vector) / (2.0 * step);
            let angular = (after.rotation * before.rotation.inverse()).scaled_axis() / (2.0 * step);
            let column = analytic.column(joint);
            assert!(
                (column.fixed_rows::<3>(0) - linear).norm() < 1e-9,
                "{joints} joint {joint}"
            );
            assert!(
                (column.fixed_rows::<3>(3) - angular).norm() < 1e-8,
                "{joints} joint {joint}"
            );
        }
    }
}

#[test]
fn inverse_returns_the_joints_that_forward_was_given() {
    let mut random = SplitMix64::new(3);
    let mut worst: f64 = 0.0;
    for _ in 0..100_000 {
        let joints = random_joints(&mut random, 0.02);
        let back = inverse(&forward(&joints), joints[3] + random.between(-3.0, 3.0)).unwrap();
        worst = worst.max((back - joints).amax());
    }
    assert!(worst < 1e-9, "worst joint error {worst:e}");
}

#[test]
fn inverse_chooses_the_roll_turn_nearest_to_the_hint() {
    let joints = JointVector::new(0.1, 0.1, 0.12, 3.0, 0.2, 0.2);
    let tip = forward(&joints);
    let other = inverse(&tip, -3.0).unwrap();
    assert!((other[3] - (3.0 - core::f64::consts::TAU)).abs() < 1e-12);
    assert_eq!(
        inverse(&tip, 9.0).unwrap_err(),
        IkError::OutOfRange {
            joint: 3,
            value: 3.0 + core::f64::consts::TAU
        }
    );
}

/// Unreachable poses are refused and clamped poses are within limits.
#[test]
fn unreachable_poses_are_refused_or_clamped() {
    let (low, high) = (
        JointVector::from(POSITION_MIN),
        JointVector::from(POSITION_MAX),
    );
    let deep = Pose::from_parts(
        Translation3::new(0.0, 0.0, -0.4),
        forward(&JointVector::zeros()).rotation,
    );
    assert!(matches!(
        inverse(&deep, 0.0),
        Err(IkError::OutOfRange { joint: 2, .. })
    ));
    let (joints, clamped) = inverse_clamped(&deep, 0.0, &low, &high).unwrap();
    assert!(clamped && joints[2] == POSITION_MAX[2]);
    assert!(matches!(
        inverse(&Pose::identity(), 0.0),
        Err(IkError::AtRemoteCentre { .. })
    ));
    let nan = Pose::from_parts(
        Translation3::new(f64::NAN, 0.0, -0.1),
        UnitQuaternion::identity(),
    );
    assert_eq!(inverse(&nan, 0.0), Err(IkError::NotFinite));
}

#[test]
fn finger_tips_are_ahead_of_the_tip_along_its_z() {
    let mut random = SplitMix64::new(4);
    let joints = random_joints(&mut random, 0.05);
    let tip = forward(&joints);
    let ahead = tip * nalgebra::Point3::new(0.0, 0.0, hal::psm::FINGER_M);
    assert!((Frames::at(&joints).finger_m - ahead.coords).norm() < 1e-15);
}
