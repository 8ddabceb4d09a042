//! What the cells of a study are made of. Everything that is serialised here is part of a cell's
//! address.

use std::collections::BTreeMap;
use std::path::PathBuf;

use serde::Serialize;

use super::address::Address;
use super::file::{ComputeDevice, ExecutionSection, Precision};

/// What a cell is the result of.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, serde::Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Kind {
    /// `trocar record`.
    Recording,
    /// `trocar train`.
    Training,
    /// `trocar eval`.
    Evaluation,
}

impl Kind {
    /// All kinds, each before those that depend on it.
    pub const ALL: [Self; 3] = [Self::Recording, Self::Training, Self::Evaluation];

    /// Its name, which is its folder's.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Recording => "recording",
            Self::Training => "training",
            Self::Evaluation => "evaluation",
        }
    }
}

/// A task with hashes of the files that describe it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TaskInput {
    /// The task's own name.
    pub task: String,
    /// Hash of its scene.
    pub scene_sha256: String,
    /// Hash of its safety limits.
    pub safety_sha256: String,
    /// Hash of the controller's settings.
    pub control_sha256: String,
    /// What `--task` is given.
    #[serde(skip)]
    pub argument: String,
    /// What `--scene` is given.
    #[serde(skip)]
    pub scene: Option<PathBuf>,
}

/// Demonstrations. How many is no part of the address: fewer are the first ones of more.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RecordingJob {
    /// The program.
    pub code: String,
    /// The task.
    pub task: TaskInput,
    /// Cameras whose frames are recorded.
    pub cameras: String,
    /// Whether depth is recorded too.
    pub depth: bool,
    /// Seed of the first attempt.
    pub seed: u64,
    /// Further options.
    pub options: Vec<String>,
    /// Hashes of the files that these name.
    pub files: BTreeMap<String, String>,
    /// How many demonstrations the whole study needs of it.
    #[serde(skip)]
    pub episodes: usize,
}

/// A training.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrainingJob {
    /// The program.
    pub code: String,
    /// The recording.
    pub recording: Address,
    /// How many of its demonstrations, from the first.
    pub demonstrations: usize,
    /// The network.
    pub policy: &'static str,
    /// Those of the recording's cameras that it sees, if not all.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub cameras: Option<String>,
    /// Sizes and recipe.
    pub preset: Option<String>,
    /// Optimiser steps.
    pub steps: Option<u64>,
    /// Samples a step.
    pub batch: Option<usize>,
    /// Data augmentation.
    pub augment: bool,
    /// 16 bits.
    pub bf16: bool,
    /// Further options.
    pub options: Vec<String>,
    /// Hashes of the files that these name.
    pub files: BTreeMap<String, String>,
    /// Where it computes.
    pub device: ComputeDevice,
    /// Its threads.
    pub threads: usize,
    /// Its seed.
    pub seed: u64,
    /// Steps between two states.
    #[serde(skip)]
    pub save_every: u64,
}

/// The policy of an evaluation.
#[derive(Clone, Debug, PartialEq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum PolicyInput {
    /// That of a training.
    Training(Address),
    /// A checkpoint that is there.
    Checkpoint {
        /// Hash over its files.
        sha256: String,
        /// Its folder.
        #[serde(skip)]
        folder: PathBuf,
    },
    /// `expert`, `noop` or `random`.
    Named(&'static str),
}

/// An evaluation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct EvaluationJob {
    /// The program.
    pub code: String,
    /// The task.
    pub task: TaskInput,
    /// The policy.
    pub policy: PolicyInput,
    /// The needle, if it is not the task's own.
    pub needle: Option<String>,
    /// From where the cameras look.
    pub view: String,
    /// How chunks are executed.
    pub execution: ExecutionSection,
    /// How many trials.
    pub trials: usize,
    /// Seed of the first.
    pub first_seed: u64,
    /// Where the network computes.
    pub device: ComputeDevice,
    /// In which numbers.
    pub precision: Precision,
}

/// What a cell is made of.
#[derive(Clone, Debug, PartialEq)]
pub enum Job {
    /// Demonstrations.
    Recording(RecordingJob),
    /// A training.
    Training(TrainingJob),
    /// An evaluation.
    Evaluation(EvaluationJob),
}

impl Job {
    /// Of which kind its cell is.
    #[must_use]
    pub const fn kind(&self) -> Kind {
        match self {
            Self::Recording(_) => Kind::Recording,
            Self::Training(_) => Kind::Training,
            Self::Evaluation(_) => Kind::Evaluation,
        }
    }

    /// Everything that makes it, as JSON.
    ///
    /// # Errors
    /// If it can't be written as JSON, such as a non-finite decay.
    pub fn recipe(&self) -> Result<serde_json::Value, serde_json::Error> {
        let body = match self {
            Self::Recording(job) => serde_json::to_value(job),
            Self::Training(job) => serde_json::to_value(job),
            Self::Evaluation(job) => serde_json::to_value(job),
        }?;
        Ok(serde_json::json!({ "kind": self.kind(), "of": body }))
    }

    /// The cells that it needs.
    #[must_use]
    pub fn inputs(&self) -> Vec<Address> {
        match self {
            Self::Recording(_) => Vec::new(),
            Self::Training(job) => vec![job.recording.clone()],
            Self::Evaluation(job) => match &job.policy {
                PolicyInput::Training(address) => vec![address.clone()],
                PolicyInput::Checkpoint { .. } | PolicyInput::Named(_) => Vec::new(),
            },
        }
    }

    /// Whether it computes on a CUDA device.
    #[must_use]
    pub const fn on_gpu(&self) -> bool {
        match self {
            Self::Recording(_) => false,
            Self::Training(job) => matches!(job.device, ComputeDevice::Cuda),
            Self::Evaluation(job) => {
                matches!(job.device, ComputeDevice::Cuda)
                    && !matches!(job.policy, PolicyInput::Named(_))
            }
        }
    }
}
