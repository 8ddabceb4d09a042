//! A simulated scene at a policy step: where everything is, and how the task stands.

use hal::Pose;
use serde::{Deserialize, Serialize};

/// `/task`: all poses in the scene frame, m.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct SceneRecord {
    /// How old the scene is, ms.
    pub moment_ms: u32,
    /// The things that move.
    pub things: Vec<Pose>,
    /// Where something is to be brought; the identity if there is no such place.
    pub goal: Pose,
    /// Each instrument's shaft, wrist, left finger, right finger and tip.
    pub arms: Vec<[Pose; 5]>,
    /// The soft flap, if there is one.
    pub flap: Option<FlapRecord>,
    /// How the task stands.
    pub task: TaskRecord,
}

/// A soft flap.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct FlapRecord {
    /// Its nodes, row by row, m.
    pub nodes_m: Vec<[f32; 3]>,
    /// The mark in the material, m.
    pub mark_m: [f64; 2],
}

/// How a task stands.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TaskRecord {
    /// What has not happened as long as there is no success, in words.
    pub missing: String,
    /// What has to be so for success.
    pub criteria: Vec<CriterionRecord>,
}

/// One thing that has to be so for success.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CriterionRecord {
    /// What, in words.
    pub name: String,
    /// `m`, `m/s`, `rad`, `N` or `s`; empty if it is so (1) or not (0).
    pub unit: String,
    /// How it is; none if that is not known yet.
    pub value: Option<f64>,
    /// How it is to be: at least, or at most.
    pub goal: f64,
    /// Whether the value is to be the goal or more; otherwise it is to be the goal or less.
    pub at_least: bool,
    /// Whether it is so.
    pub met: bool,
}

impl SceneRecord {
    /// Reads a message of `/task`; none if it is of another form, or a number in it was not finite.
    #[must_use]
    pub fn read(message: &[u8]) -> Option<Self> {
        serde_json::from_slice(message).ok()
    }
}
