//! The border to the physics engine's own maths types.

use hal::Pose;
use nalgebra::Vector3;
use rapier3d_f64::math::{Pose as EnginePose, Rotation as EngineRotation, Vector as EngineVector};

pub(super) fn engine_vector(v: &Vector3<f64>) -> EngineVector {
    EngineVector::new(v.x, v.y, v.z)
}

pub(super) fn engine_pose(pose: &Pose) -> EnginePose {
    let q = pose.rotation.quaternion();
    EnginePose::from_parts(
        engine_vector(&pose.translation.vector),
        EngineRotation::from_xyzw(q.i, q.j, q.k, q.w),
    )
}

pub(super) fn our_vector(v: EngineVector) -> Vector3<f64> {
    Vector3::new(v.x, v.y, v.z)
}
