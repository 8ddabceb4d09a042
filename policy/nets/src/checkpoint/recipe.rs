//! `trocar.json`: what a policy needs besides LeRobot's files, and its provenance.

use hal::POLICY_STEP_NS;
use serde::{Deserialize, Serialize};
use serde_json::Value;

use crate::act::{ActPreset, BackboneNorm, LossDenominator};
use crate::act_pc::ActPcPreset;
use crate::dp3::Dp3Preset;

/// Version of this file's form.
pub const RECIPE_FORMAT: u32 = 1;

/// Choices of the network that LeRobot's file cannot say.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Variants {
    /// Normalisation layers of the backbone.
    pub backbone_norm: BackboneNorm,
    /// What the loss was divided by.
    pub loss_denominator: LossDenominator,
}

/// A camera as it was recorded.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecordedCamera {
    /// Feature name, `observation.images.NAME`.
    pub feature: String,
    /// Width of its frames, pixels.
    pub width: u32,
    /// Height of its frames, pixels.
    pub height: u32,
}

/// A named network of any kind.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum PolicyPreset {
    /// [`ActPreset::Small`].
    Small,
    /// [`ActPreset::Compact`].
    Compact,
    /// [`ActPreset::Paper`].
    Paper,
    /// [`ActPreset::Lerobot`].
    Lerobot,
    /// [`Dp3Preset::Dp3`].
    Dp3,
    /// [`Dp3Preset::Simple`].
    SimpleDp3,
    /// [`ActPcPreset::Paper`].
    ActPcPaper,
    /// [`ActPcPreset::PointCloudMatters`].
    ActPcPointCloudMatters,
    /// [`ActPcPreset::Small`].
    ActPcSmall,
}

impl From<ActPreset> for PolicyPreset {
    fn from(preset: ActPreset) -> Self {
        match preset {
            ActPreset::Small => Self::Small,
            ActPreset::Compact => Self::Compact,
            ActPreset::Paper => Self::Paper,
            ActPreset::Lerobot => Self::Lerobot,
        }
    }
}

impl From<ActPcPreset> for PolicyPreset {
    fn from(preset: ActPcPreset) -> Self {
        match preset {
            ActPcPreset::Paper => Self::ActPcPaper,
            ActPcPreset::PointCloudMatters => Self::ActPcPointCloudMatters,
            ActPcPreset::Small => Self::ActPcSmall,
        }
    }
}

impl From<Dp3Preset> for PolicyPreset {
    fn from(preset: Dp3Preset) -> Self {
        match preset {
            Dp3Preset::Dp3 => Self::Dp3,
            Dp3Preset::Simple => Self::SimpleDp3,
        }
    }
}

/// What a policy was trained on.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetSummary {
    /// The task in words.
    pub task: String,
    /// Episodes trained on.
    pub episodes: usize,
    /// Frames trained on.
    pub frames: usize,
    /// Frames a second.
    pub fps: u32,
    /// The datasets, if there were several.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub parts: Vec<DatasetPart>,
}

/// One of the datasets that a policy was trained on.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct DatasetPart {
    /// Its folder.
    pub folder: String,
    /// Its task in words.
    pub task: String,
    /// Its episodes that were trained on.
    pub episodes: usize,
    /// Frames in them.
    pub frames: usize,
}

/// How overlapping chunks become one target, by the names of the controller's configuration.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct RecommendedAggregation {
    /// The mode.
    pub mode: AggregationName,
    /// The decay of the ensemble; the other modes have no use for it.
    pub decay: f64,
}

/// A way of aggregating chunks.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum AggregationName {
    /// ACT's temporal ensembling.
    Ensemble,
    /// Each chunk is played to its end, then the newest one.
    WholeChunk,
    /// Receding horizon: the newest chunk takes over as soon as it arrives, and is left for the
    /// next one.
    Newest,
}

impl AggregationName {
    /// The name in configuration files.
    #[must_use]
    pub const fn as_str(self) -> &'static str {
        match self {
            Self::Ensemble => "ensemble",
            Self::WholeChunk => "whole_chunk",
            Self::Newest => "newest",
        }
    }
}

/// Files from before there could be two do not say it.
const fn one_arm() -> usize {
    1
}

/// The whole file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Recipe {
    /// [`RECIPE_FORMAT`].
    pub format: u32,
    /// How many arms the network sees and commands.
    #[serde(default = "one_arm")]
    pub arms: usize,
    /// What the network's actions mean: [`trocar_data::relative_action::REPRESENTATION`], or, of
    /// ACT, [`trocar_data::relative_action::ABSOLUTE_REPRESENTATION`].
    pub action_representation: String,
    /// Time between two steps of a chunk, ns.
    pub step_ns: u64,
    /// Steps after which the policy should be asked again. At least 1, and no more than a chunk
    /// has.
    pub query_every_steps: u32,
    /// How the policy's overlapping chunks should be turned into one target, unless the user says
    /// otherwise.
    pub aggregation: RecommendedAggregation,
    /// The cameras, in the order in which observations bring their frames.
    pub cameras: Vec<RecordedCamera>,
    /// The preset that the network is.
    pub preset: PolicyPreset,
    /// Choices that LeRobot's file cannot say.
    pub variants: Variants,
    /// How it was made, in words: the command, or what a person should do to make it again.
    pub recipe: String,
    /// What it was trained on.
    pub dataset: DatasetSummary,
    /// The seed of everything random.
    pub seed: u64,
    /// The options of the training and its outcome, for people.
    #[serde(default)]
    pub training: Value,
}

impl Recipe {
    /// How many policy steps ([`POLICY_STEP_NS`]) the oldest of so many `observations`, a step of
    /// the recipe apart, is before the newest.
    pub(crate) const fn policy_steps_before(&self, observations: usize) -> u64 {
        let span_ns = (observations as u64).saturating_sub(1) * self.step_ns;
        (span_ns + POLICY_STEP_NS / 2) / POLICY_STEP_NS
    }
}
