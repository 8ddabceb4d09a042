//! Where the numbers are within an episode of another layout.

use super::{ImportError, ImportOptions, Layout};

/// Where the numbers are within an episode.
pub(super) struct Names {
    pub(super) joints: String,
    pub(super) action: Action,
}

/// What was commanded.
pub(super) enum Action {
    /// Joints and jaw.
    Joints(String),
    /// Tip pose and jaw.
    Pose(String),
}

impl Action {
    pub(super) fn name(&self) -> &str {
        match self {
            Self::Joints(name) | Self::Pose(name) => name,
        }
    }
}

impl Names {
    /// The options' names, or those that ACT's layout has.
    pub(super) fn of(options: &ImportOptions) -> Result<Self, ImportError> {
        let refuse = |text: &str| Err(ImportError::Options(text.to_owned()));
        if options.task.trim().is_empty() {
            return refuse("--task: what the demonstrations show, in words, is needed");
        }
        let act = options.layout == Layout::Act;
        let joints = options.joints.clone();
        let joints = joints.or_else(|| act.then(|| "observations/qpos".to_owned()));
        let action = match (&options.action_joints, &options.action_pose) {
            (Some(_), Some(_)) => {
                let both = "--action-joints and --action-pose: one of them is needed, not both";
                return refuse(both);
            }
            (Some(name), None) => Some(Action::Joints(name.clone())),
            (None, Some(name)) => Some(Action::Pose(name.clone())),
            (None, None) => act.then(|| Action::Joints("action".to_owned())),
        };
        match (joints, action) {
            (Some(joints), Some(action)) if act || !options.images.is_empty() => {
                Ok(Self { joints, action })
            }
            _ => refuse(
                "robomimic's names differ from file to file: --joints, --images, and --action-joints or --action-pose are needed",
            ),
        }
    }
}
