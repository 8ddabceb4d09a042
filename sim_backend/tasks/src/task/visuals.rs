//! What the cameras see: surfaces, and the arms that every task has.

use hal::Pose;
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use trocar_render::shapes::instrument::{Finger, finger, shaft, wrist};
use trocar_render::visual::{Material, Pattern, Visual, VisualPoses, instance};

use super::{TaskConfig, TaskScene};
use crate::scene::SceneSnapshot;

/// Length of the shaft that is drawn, m: from the wrist to beyond the remote centre.
const SHAFT_LENGTH_M: f64 = 0.30;

pub(super) const MUSCLE: Material = Material {
    base_colour: [0.36, 0.055, 0.040],
    metallic: 0.0,
    roughness: 0.55,
    wetness: 0.75,
    detail: 1.0,
    pattern: Pattern::Muscle,
};
pub(super) const LIVER: Material = Material {
    base_colour: [0.090, 0.0135, 0.0080],
    metallic: 0.0,
    roughness: 0.45,
    wetness: 1.0,
    detail: 1.0,
    pattern: Pattern::Liver,
};
pub(super) const NEEDLE_STEEL: Material = Material {
    base_colour: [0.90, 0.91, 0.93],
    metallic: 1.0,
    roughness: 0.22,
    wetness: 0.0,
    detail: 0.0,
    pattern: Pattern::Smooth,
};
/// Wrist: machined and a little worn.
const TOOL_STEEL: Material = Material {
    base_colour: [0.56, 0.57, 0.59],
    metallic: 1.0,
    roughness: 0.40,
    wetness: 0.0,
    detail: 0.8,
    pattern: Pattern::Brushed,
};
/// Jaws: polished.
const JAW_STEEL: Material = Material {
    base_colour: [0.78, 0.78, 0.79],
    metallic: 1.0,
    roughness: 0.27,
    wetness: 0.0,
    detail: 0.35,
    pattern: Pattern::Brushed,
};
const SHAFT_COAT: Material = Material {
    base_colour: [0.022, 0.022, 0.025],
    metallic: 0.0,
    roughness: 0.42,
    wetness: 0.0,
    detail: 1.0,
    pattern: Pattern::Smooth,
};

/// What a task's cameras see: the task's own visuals, then those of each arm.
pub(crate) fn scene_visuals(task: &TaskConfig) -> Vec<Visual> {
    let mut visuals = task.scene.visuals();
    visuals.extend(arms_visuals(task.arms.len()));
    visuals
}

/// What cameras see of the instruments of so many arms.
pub(crate) fn arms_visuals(count: usize) -> Vec<Visual> {
    let ids = [
        [instance::SHAFT, instance::WRIST, instance::JAW],
        [
            instance::SECOND_SHAFT,
            instance::SECOND_WRIST,
            instance::SECOND_JAW,
        ],
    ];
    ids.into_iter().take(count).flat_map(arm_visuals).collect()
}

/// Poses of the visuals in the scene frame.
pub(crate) fn scene_poses(scene: &dyn TaskScene, snapshot: &SceneSnapshot) -> VisualPoses {
    let mut poses = scene.visual_poses(&snapshot.things, &snapshot.goal);
    poses.extend(arms_poses(snapshot));
    poses
}

/// Poses of the visuals of the instruments in the scene frame.
pub(crate) fn arms_poses(snapshot: &SceneSnapshot) -> impl Iterator<Item = Pose> {
    let arms = snapshot.arms.iter().flatten();
    arms.flat_map(|arm| {
        [
            arm.shaft,
            arm.wrist * drawn_from_joint(),
            arm.finger_left,
            arm.finger_right,
        ]
    })
}

fn arm_visuals([shaft_id, wrist_id, jaw_id]: [u8; 3]) -> [Visual; 4] {
    [
        Visual::new("shaft", shaft(SHAFT_LENGTH_M), SHAFT_COAT, shaft_id),
        Visual::new("wrist", wrist(), TOOL_STEEL, wrist_id),
        Visual::new("left finger", finger(Finger::PlusY), JAW_STEEL, jaw_id),
        Visual::new("right finger", finger(Finger::MinusY), JAW_STEEL, jaw_id),
    ]
}

/// The wrist's joint frame points along x and turns about z; its mesh points along z and turns
/// about y.
fn drawn_from_joint() -> Pose {
    let columns = Matrix3::from_columns(&[Vector3::y(), Vector3::z(), Vector3::x()]);
    let rotation = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns));
    Pose::from_parts(Translation3::identity(), rotation)
}
