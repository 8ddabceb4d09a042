//! Features of Open-H-Embodiment's dVRK datasets, and which of our cameras is which of theirs.

use std::path::Path;
use std::sync::Arc;

use arrow_schema::{DataType, Field, Schema};
use hal::ARM_NAMES;
use hal::joints::JOINT_NAMES;
use serde_json::{Value, json};

use super::Source;
use crate::dataset::schema::{
    ACTION, IMAGE_PREFIX, INDICES, STATE, TIMESTAMP, describe_video, vector_field,
};
use crate::dataset::{ACTION_WIDTH, Dataset, DatasetError};

/// The joint positions of all arms, which Open-H-Embodiment's template recommends.
pub(super) const JOINTS: &str = "observation.state.joint_positions";
/// Each frame's words. A text column; the same words are the episode's LeRobot task.
pub(super) const INSTRUCTION: &str = "instruction.text";
/// What the instrument of an arm is called, behind which comes the arm's name.
pub(super) const TOOL_PREFIX: &str = "observation.meta.tool.";

/// Our cameras and what they are called there; others keep their names. A single `wrist` camera is
/// `wrist.right`, and the mapping `open-h-dvrk` reads it back as `wrist`.
const CAMERAS: [(&str, &str); 6] = [
    ("endoscope", "endoscope.left"),
    ("endoscope_left", "endoscope.left"),
    ("endoscope_right", "endoscope.right"),
    ("wrist", "wrist.right"),
    ("wrist_right", "wrist.right"),
    ("wrist_left", "wrist.left"),
];

/// The feature of each camera.
///
/// # Errors
/// [`DatasetError::Missing`] without a camera; [`DatasetError::Input`] for two that would be called
/// the same, and for odd sides.
pub(super) fn cameras(dir: &Path, dataset: &Dataset) -> Result<Vec<String>, DatasetError> {
    let mut features: Vec<String> = Vec::new();
    for camera in &dataset.spec().cameras {
        let known = CAMERAS.iter().find(|(ours, _)| *ours == camera.name);
        let name = known.map_or(camera.name.as_str(), |(_, theirs)| theirs);
        let feature = format!("{IMAGE_PREFIX}{name}");
        let refuse = |found: String, expected: &str| DatasetError::Input {
            what: format!("camera \"{}\"", camera.name),
            found,
            expected: expected.to_owned(),
        };
        if features.contains(&feature) {
            return Err(refuse(format!("another {feature}"), "one of each"));
        }
        if !camera.width.is_multiple_of(2) || !camera.height.is_multiple_of(2) {
            let found = format!("{} x {}", camera.width, camera.height);
            return Err(refuse(found, "even sides, for video"));
        }
        features.push(feature);
    }
    match features.is_empty() {
        false => Ok(features),
        true => Err(DatasetError::Missing {
            path: dir.join("meta/info.json"),
            name: "a camera, which Open-H-Embodiment's datasets have,".to_owned(),
        }),
    }
}

/// Every feature, in the order of the columns; cameras first, which have none.
pub(super) fn features(source: &Source<'_>) -> Vec<(String, Value)> {
    let dataset = source.dataset;
    let arms = dataset.arms();
    let mut features = Vec::new();
    for (feature, camera) in source.cameras.iter().zip(&dataset.spec().cameras) {
        let shape = [camera.height as usize, camera.width as usize, 3];
        let info = describe_video(source.options.video, shape, dataset.fps());
        let names = ["height", "width", "channels"];
        let video = json!({"dtype": "video", "shape": shape, "names": names, "info": info});
        features.push((feature.clone(), video));
    }
    let vector =
        |names: Vec<String>| json!({"dtype": "float32", "shape": [names.len()], "names": names});
    features.push((STATE.to_owned(), vector(pose_names(arms, "pose", "jaw"))));
    features.push((JOINTS.to_owned(), vector(joint_names(arms))));
    features.push((ACTION.to_owned(), vector(pose_names(arms, "sp", "jaw_sp"))));
    let text = json!({"dtype": "string", "shape": [1], "names": null});
    for arm in ARM_NAMES.iter().take(arms) {
        features.push((format!("{TOOL_PREFIX}{arm}"), text.clone()));
    }
    features.push((INSTRUCTION.to_owned(), text));
    let number = |dtype: &str| json!({"dtype": dtype, "shape": [1], "names": null});
    features.push((TIMESTAMP.to_owned(), number("float32")));
    for name in INDICES {
        features.push((name.to_owned(), number("int64")));
    }
    features
}

/// `psm1_pose.position.x` to `psm1_jaw`, then those of psm2.
///
/// `pose` and `jaw` are the middle parts: `pose` and `jaw` of states, `sp` and `jaw_sp`
/// (set-points) of actions.
fn pose_names(arms: usize, pose: &str, jaw: &str) -> Vec<String> {
    let mut names = Vec::new();
    for arm in ARM_NAMES.iter().take(arms) {
        names.extend(["x", "y", "z"].map(|axis| format!("{arm}_{pose}.position.{axis}")));
        names.extend(["x", "y", "z", "w"].map(|axis| format!("{arm}_{pose}.orientation.{axis}")));
        names.push(format!("{arm}_{jaw}"));
    }
    names
}

/// `psm1_yaw` and so on, then those of psm2.
fn joint_names(arms: usize) -> Vec<String> {
    let arms = ARM_NAMES.iter().take(arms);
    arms.flat_map(|arm| JOINT_NAMES.map(|joint| format!("{arm}_{joint}")))
        .collect()
}

/// The columns of a data file.
///
/// Column for column what [`features`] lists behind the cameras, and what `Rows::columns` fills.
pub(super) fn schema(arms: usize) -> Arc<Schema> {
    let mut fields = vec![
        vector_field(STATE, DataType::Float32, arms * ACTION_WIDTH),
        vector_field(JOINTS, DataType::Float32, arms * JOINT_NAMES.len()),
        vector_field(ACTION, DataType::Float32, arms * ACTION_WIDTH),
    ];
    for arm in ARM_NAMES.iter().take(arms) {
        fields.push(Field::new(
            format!("{TOOL_PREFIX}{arm}"),
            DataType::Utf8,
            true,
        ));
    }
    fields.push(Field::new(INSTRUCTION, DataType::Utf8, true));
    fields.push(Field::new(TIMESTAMP, DataType::Float32, true));
    fields.extend(INDICES.map(|name| Field::new(name, DataType::Int64, true)));
    Arc::new(Schema::new(fields))
}
