//! What the cameras see of the needle lift.

use hal::Pose;
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::TaskConfig;
use crate::shapes::instrument::{Finger, finger, shaft, wrist};
use crate::visual::{Material, Visual, VisualPoses, instance};
use crate::world::ArmBodies;

/// Length of the shaft that is drawn, m: from the wrist to beyond the remote centre.
const SHAFT_LENGTH_M: f64 = 0.30;

const MUSCLE: Material = Material {
    base_colour: [0.46, 0.085, 0.065],
    metallic: 0.0,
    roughness: 0.5,
    wetness: 0.8,
    detail: 1.0,
};
const NEEDLE_STEEL: Material = Material {
    base_colour: [0.80, 0.82, 0.85],
    metallic: 1.0,
    roughness: 0.25,
    wetness: 0.0,
    detail: 0.0,
};
const TOOL_STEEL: Material = Material {
    base_colour: [0.55, 0.56, 0.58],
    metallic: 1.0,
    roughness: 0.38,
    wetness: 0.0,
    detail: 0.1,
};
const SHAFT_COAT: Material = Material {
    base_colour: [0.045, 0.045, 0.05],
    metallic: 0.0,
    roughness: 0.5,
    wetness: 0.0,
    detail: 0.1,
};

/// The visuals of the scene, in the order of [`visual_poses`].
pub(crate) fn visuals(task: &TaskConfig) -> Vec<Visual> {
    vec![
        Visual {
            name: "organ",
            mesh: task.organ.mesh(),
            material: MUSCLE,
            instance: instance::ORGAN,
        },
        Visual {
            name: "needle",
            mesh: task.needle.mesh(),
            material: NEEDLE_STEEL,
            instance: instance::NEEDLE,
        },
        Visual {
            name: "shaft",
            mesh: shaft(SHAFT_LENGTH_M),
            material: SHAFT_COAT,
            instance: instance::SHAFT,
        },
        Visual {
            name: "wrist",
            mesh: wrist(),
            material: TOOL_STEEL,
            instance: instance::WRIST,
        },
        Visual {
            name: "left finger",
            mesh: finger(Finger::PlusY),
            material: TOOL_STEEL,
            instance: instance::JAW,
        },
        Visual {
            name: "right finger",
            mesh: finger(Finger::MinusY),
            material: TOOL_STEEL,
            instance: instance::JAW,
        },
    ]
}

/// Poses of the visuals in the scene frame.
pub(crate) fn visual_poses(needle_in_scene: Pose, arm: &ArmBodies) -> VisualPoses {
    let wrist = arm.wrist * drawn_from_joint();
    vec![
        Pose::identity(),
        needle_in_scene,
        arm.shaft,
        wrist,
        arm.finger_left,
        arm.finger_right,
    ]
}

/// The wrist's joint frame points along x and turns about z; its mesh points along z and turns about y.
fn drawn_from_joint() -> Pose {
    let columns = Matrix3::from_columns(&[Vector3::y(), Vector3::z(), Vector3::x()]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns));
    Pose::from_parts(Translation3::identity(), rotation)
}
