//! The study's file: tasks, networks, recordings, execution modes, and the grids over them.

use std::collections::BTreeMap;
use std::path::Path;

use hal::config::{ConfigError, Source};
use serde::{Deserialize, Serialize};

use super::axis::Axis;

/// A study as its file says it.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct StudyFile {
    /// What reports call it.
    pub title: String,
    /// How much runs at a time; changes no result.
    #[serde(default)]
    pub run: RunSection,
    /// What all trainings share.
    #[serde(default)]
    pub training: TrainingSection,
    /// What all evaluations share.
    #[serde(default)]
    pub evaluation: EvaluationSection,
    /// Tasks by the names that grids call them.
    pub task: BTreeMap<String, TaskSection>,
    /// Networks by name.
    pub network: BTreeMap<String, NetworkSection>,
    /// Ways of recording by name.
    #[serde(default)]
    pub recording: BTreeMap<String, RecordingSection>,
    /// Execution modes by name.
    #[serde(default)]
    pub execution: BTreeMap<String, ExecutionSection>,
    /// The grids, a table of the report each.
    #[serde(default)]
    pub grid: Vec<GridSection>,
}

/// How much runs at a time. Nothing here changes a result.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct RunSection {
    /// Trainings that share one GPU.
    pub trainings_per_gpu: usize,
    /// Evaluations that share one GPU.
    pub evaluations_per_gpu: usize,
    /// Episodes that one recording records at a time.
    pub record_jobs: usize,
    /// Trials that one evaluation runs at a time.
    pub eval_jobs: usize,
    /// Whose log and pictures evaluations keep: `none`, `failures` or `all`.
    pub keep: Keep,
    /// Whether a recording's data stays once nothing left to do needs it; what says that it is done
    /// always stays.
    pub keep_recordings: bool,
}

impl Default for RunSection {
    fn default() -> Self {
        Self {
            trainings_per_gpu: 1,
            evaluations_per_gpu: 1,
            record_jobs: 4,
            eval_jobs: 2,
            keep: Keep::Failures,
            keep_recordings: true,
        }
    }
}

/// Trials whose log and pictures are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Keep {
    /// None.
    None,
    /// Those that were lost.
    Failures,
    /// All.
    All,
}

/// Where something computes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ComputeDevice {
    /// The processor.
    #[default]
    Cpu,
    /// A CUDA device.
    Cuda,
}

impl ComputeDevice {
    /// Its name on the command line.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Cpu => "cpu",
            Self::Cuda => "cuda",
        }
    }
}

/// What all trainings share.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct TrainingSection {
    /// Where they compute.
    pub device: ComputeDevice,
    /// Threads of each.
    pub threads: usize,
    /// Steps between two times that one keeps its state, from which it can be resumed.
    pub save_every: u64,
}

impl Default for TrainingSection {
    fn default() -> Self {
        Self {
            device: ComputeDevice::Cpu,
            threads: 2,
            save_every: 1000,
        }
    }
}

/// What all evaluations share.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct EvaluationSection {
    /// Where their networks compute.
    pub device: ComputeDevice,
    /// In which numbers: `f32` or `bf16`.
    pub precision: Precision,
}

/// In which numbers an evaluated network computes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Precision {
    /// Single precision.
    #[default]
    F32,
    /// 8 significant bits; CUDA only.
    Bf16,
}

impl Precision {
    /// Its name on the command line.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::F32 => "f32",
            Self::Bf16 => "bf16",
        }
    }
}

/// A task.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskSection {
    /// What reports call it; its name if not given.
    pub title: Option<String>,
    /// A built-in task's name or a folder's path; the name in the study if not given.
    pub task: Option<String>,
    /// Another scene than the one in the task's folder.
    pub scene: Option<String>,
}

/// Which policy a network is.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum PolicyKind {
    /// ACT from images, trained.
    Act,
    /// ACT from point clouds, trained.
    ActPc,
    /// DP3, trained.
    Dp3,
    /// A checkpoint that is there.
    Checkpoint,
    /// The scripted expert.
    Expert,
    /// Holds still.
    Noop,
    /// Wanders.
    Random,
}

impl PolicyKind {
    /// Its name on the command line.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Act => "act",
            Self::ActPc => "act-pc",
            Self::Dp3 => "dp3",
            Self::Checkpoint => "checkpoint",
            Self::Expert => "expert",
            Self::Noop => "noop",
            Self::Random => "random",
        }
    }

    /// Whether a study trains it.
    #[must_use]
    pub const fn is_trained(self) -> bool {
        matches!(self, Self::Act | Self::ActPc | Self::Dp3)
    }

    /// Whether it learns from point clouds, which are made of depth.
    #[must_use]
    pub const fn needs_depth(self) -> bool {
        matches!(self, Self::ActPc | Self::Dp3)
    }
}

/// A network and how it is trained.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NetworkSection {
    /// What reports call it; its name if not given.
    pub title: Option<String>,
    /// Which policy it is.
    pub policy: PolicyKind,
    /// The checkpoint's folder, if the policy is one.
    pub checkpoint: Option<String>,
    /// Sizes and recipe; the policy's default if not given.
    pub preset: Option<String>,
    /// Cameras that demonstrations are recorded with for it: `single`, `multi`, or names with
    /// commas between them.
    pub cameras: Option<String>,
    /// Optimiser steps; the preset's if not given.
    pub steps: Option<u64>,
    /// What is otherwise in some tasks, by the tasks' names.
    #[serde(default)]
    pub on: BTreeMap<String, OnTask>,
    /// Samples a step; the preset's if not given.
    pub batch: Option<usize>,
    /// Whether data augmentation is on.
    #[serde(default)]
    pub augment: bool,
    /// Whether it is trained in 16 bits.
    #[serde(default)]
    pub bf16: bool,
    /// Further options of `trocar train`.
    #[serde(default)]
    pub options: Vec<String>,
}

/// How a network is trained otherwise in one task; what is not given is as in the others.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct OnTask {
    /// Sizes and recipe.
    pub preset: Option<String>,
    /// Optimiser steps.
    pub steps: Option<u64>,
    /// Further options of `trocar train`, in place of those for all tasks.
    pub options: Option<Vec<String>>,
}

impl NetworkSection {
    /// This network as it is trained in `task`.
    #[must_use]
    pub fn in_task(&self, task: &str) -> Self {
        let mut own = self.clone();
        if let Some(on) = self.on.get(task).cloned() {
            own.preset = on.preset.or(own.preset);
            own.steps = on.steps.or(own.steps);
            own.options = on.options.unwrap_or(own.options);
        }
        own
    }
}

/// A way of recording demonstrations.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordingSection {
    /// What reports call it; its name if not given.
    pub title: Option<String>,
    /// Seed of the first attempt.
    pub seed: u64,
    /// Cameras that are recorded, of which each network sees its own: one recording for all of
    /// them. If not given, there is one for each network's cameras.
    pub cameras: Option<String>,
    /// Whether depth is recorded, whoever needs it: likewise.
    #[serde(default)]
    pub depth: bool,
    /// Share of the demonstrations that are disturbed, with the expert's recovery (`record
    /// --disturb`).
    pub disturb: Option<f64>,
    /// What is randomised: `needles`, `views`, `light`, `lens`, or effects of `lens` (`record
    /// --vary`).
    #[serde(default)]
    pub vary: Vec<String>,
    /// Further options of `trocar record`.
    #[serde(default)]
    pub options: Vec<String>,
}

/// How a policy's chunks are executed.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ExecutionSection {
    /// What reports call it; its name if not given.
    #[serde(skip_serializing)]
    pub title: Option<String>,
    /// `whole_chunk`, `ensemble` or `newest`, in place of what the checkpoint recommends.
    pub mode: Option<trocar_nets::checkpoint::AggregationName>,
    /// The decay of the ensemble.
    pub decay: Option<f64>,
    /// Policy steps from one query to the next.
    pub query_every_steps: Option<u32>,
    /// Delay from observation to chunk, ms; the policy's own if not given.
    pub latency_ms: Option<u64>,
    /// What may come on top of it, ms.
    pub latency_jitter_ms: Option<u64>,
}

impl ExecutionSection {
    /// Whether it changes what the checkpoint says of itself.
    #[must_use]
    pub const fn changes_checkpoint(&self) -> bool {
        self.mode.is_some() || self.decay.is_some() || self.query_every_steps.is_some()
    }
}

/// A grid of evaluations: everything with everything.
#[derive(Clone, Debug, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GridSection {
    /// Its name.
    pub name: String,
    /// The heading of its table.
    pub title: String,
    /// A sentence under the heading.
    #[serde(default)]
    pub note: String,
    /// Tasks.
    pub tasks: Vec<String>,
    /// Networks.
    pub networks: Vec<String>,
    /// Ways of recording what they are trained on.
    #[serde(default)]
    pub recordings: Vec<String>,
    /// Numbers of demonstrations.
    #[serde(default)]
    pub demonstrations: Vec<usize>,
    /// Seeds of trainings, whose trials are pooled.
    #[serde(default)]
    pub training_seeds: Vec<u64>,
    /// Needles; empty for the task's own.
    #[serde(default)]
    pub needles: Vec<String>,
    /// Views: `train`, `view1`, `view2`; empty for `train`.
    #[serde(default)]
    pub views: Vec<String>,
    /// Execution modes; empty for the checkpoint's own.
    #[serde(default)]
    pub executions: Vec<String>,
    /// Trials of each evaluation.
    pub trials: usize,
    /// Seed of the first trial.
    pub first_seed: u64,
    /// What the columns of its table are.
    pub columns: Axis,
    /// What a curve runs over, if there is to be one.
    pub curve: Option<Axis>,
    /// Published figures beside it.
    pub published: Option<Published>,
}

/// Figures of others that stand beside a grid's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Published {
    /// Where they are from.
    pub source: String,
    /// Trials behind each.
    pub trials: Option<usize>,
    /// The figures.
    #[serde(default)]
    pub rates: Vec<PublishedRate>,
}

/// A published success rate, of all cells that have these coordinates.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PublishedRate {
    /// The task.
    pub task: Option<String>,
    /// The network.
    pub network: Option<String>,
    /// The needle.
    pub needle: Option<String>,
    /// The view.
    pub view: Option<String>,
    /// The number of demonstrations.
    pub demonstrations: Option<usize>,
    /// The success rate.
    pub rate: f64,
}

impl StudyFile {
    /// Reads and checks the file at `path`.
    ///
    /// # Errors
    /// [`ConfigError`] naming file, line and key.
    pub fn read(path: &Path) -> Result<(Self, Source), ConfigError> {
        let source = Source::read(&path.display().to_string())?;
        let file: Self = source.parse()?;
        file.check(&source)?;
        Ok((file, source))
    }
}
