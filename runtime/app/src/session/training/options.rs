//! What to train, as it is asked for and as a state remembers it.

use std::path::PathBuf;

use serde::{Deserialize, Deserializer, Serialize};
use tch::Device;
use trocar_nets::act::BackboneNorm;

/// Which of the cameras the network sees, of several datasets' the first one's.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum CameraChoice {
    /// The dataset's first; of recordings with `--cameras single` or `multi` the one that the paper
    /// gives policies of a single camera.
    Single,
    /// All of them.
    Multi,
    /// These, in this order.
    Named(Vec<String>),
}

impl CameraChoice {
    /// Reads `single`, `multi`, or names with commas between them.
    #[must_use]
    pub fn of(text: &str) -> Self {
        match text {
            "single" => Self::Single,
            "multi" => Self::Multi,
            names => Self::Named(names.split(',').map(str::to_owned).collect()),
        }
    }

    /// Those of the dataset's cameras `all` that the network sees.
    pub(super) fn among(&self, all: &[String]) -> Result<Vec<String>, String> {
        match self {
            Self::Single => Ok(all.iter().take(1).cloned().collect()),
            Self::Multi => Ok(all.to_vec()),
            Self::Named(names) => {
                for (index, name) in names.iter().enumerate() {
                    if !all.contains(name) {
                        let all = all.join(", ");
                        return Err(format!(
                            "{name}: there is no such camera; the dataset has {all}"
                        ));
                    }
                    if names[..index].contains(name) {
                        return Err(format!("{name} is named twice"));
                    }
                }
                Ok(names.clone())
            }
        }
    }
}

/// Which network is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum NetworkChoice {
    /// ACT, from colour images.
    Act,
    /// ACT-PC, from point clouds.
    ActPc,
    /// DP3, from point clouds.
    Dp3,
}

/// How often a training is evaluated, and how.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TrainingEval {
    /// Steps between two evaluations; there is one after the last step too.
    pub every: u64,
    /// The task, a name or a folder; the dataset's if not given.
    pub task: Option<String>,
    /// Trials of an evaluation.
    pub trials: usize,
    /// Seed of the first trial.
    pub seed: u64,
    /// Trials at a time.
    pub jobs: usize,
    /// Delay from observation to chunk, ms; the policy's own if not given.
    pub latency_ms: Option<u64>,
}

/// What to train.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TrainingOptions {
    /// The network.
    pub network: NetworkChoice,
    /// The datasets' directories, at least one: their episodes are learned from as those of one
    /// dataset.
    #[serde(deserialize_with = "one_or_more")]
    pub data: Vec<PathBuf>,
    /// The checkpoint's directory; a new or an empty one.
    pub out: PathBuf,
    /// Which cameras the network sees.
    pub cameras: CameraChoice,
    /// Sizes and recipe: of ACT, `small`, `compact`, `paper` or `lerobot`; of DP3, `paper` or
    /// `simple`; of ACT-PC, `small`, `paper` or `pcm`.
    pub preset: String,
    /// Whether the recipe is the authors' own, which begins from an ImageNet backbone, instead of
    /// one that learns from scratch.
    pub published: bool,
    /// Normalisation layers of ACT's backbone; in options from before there was a choice, group
    /// normalisation.
    #[serde(default = "group_norm")]
    pub backbone: BackboneNorm,
    /// What a backbone with frozen batch normalisation starts from: a safetensors file or a
    /// policy's folder.
    pub backbone_weights: Option<PathBuf>,
    /// Optimiser steps, if not the preset's.
    pub steps: Option<u64>,
    /// Samples a step, if not the preset's.
    pub batch: Option<usize>,
    /// Where to compute.
    #[serde(with = "device_name")]
    pub device: Device,
    /// Compute in 16 bits; for accelerators.
    pub bf16: bool,
    /// Use only the first episodes, of all datasets together.
    pub episodes: Option<usize>,
    /// Share of the episodes held out for validation, the last ones of all datasets together.
    pub validation_share: f64,
    /// Change what is trained on at random: shift and brighten images, move and hide points,
    /// disturb states.
    pub augment: bool,
    /// Policy steps from one query to the next that the checkpoint recommends, if not the network's
    /// usual number.
    #[serde(default)]
    pub query_every: Option<u32>,
    /// Learning rate of everything but a backbone that was trained before, if not the recipe's.
    #[serde(default)]
    pub lr: Option<f64>,
    /// Greatest shift of an image, pixels of the network's, if not what `augment` says.
    #[serde(default)]
    pub shift_px: Option<u32>,
    /// Standard deviation of noise on the normalised state, if not what `augment` says.
    #[serde(default)]
    pub state_noise: Option<f64>,
    /// What clouds are made of instead of the built-in config/clouds.toml.
    pub clouds: Option<PathBuf>,
    /// Keep images in the host's memory instead of the device's.
    pub images_on_host: bool,
    /// Tell an accelerator each operation of every step instead of repeating a recorded step.
    #[serde(default)]
    pub eager: bool,
    /// Threads that decode images, and compute on the CPU.
    pub threads: usize,
    /// Everything random depends on this.
    pub seed: u64,
    /// Steps between two times that the state is kept, from which the training can go on; 0 is
    /// never.
    pub save_every: u64,
    /// Evaluations along the way, if any.
    #[serde(default)]
    pub eval: Option<TrainingEval>,
    /// The command line, for the checkpoint's recipe.
    pub command: String,
}

const fn group_norm() -> BackboneNorm {
    BackboneNorm::GroupNorm
}

/// Options from before there could be several have one dataset.
fn one_or_more<'de, D: Deserializer<'de>>(from: D) -> Result<Vec<PathBuf>, D::Error> {
    #[derive(Deserialize)]
    #[serde(untagged)]
    enum Data {
        One(PathBuf),
        More(Vec<PathBuf>),
    }
    Ok(match Data::deserialize(from)? {
        Data::One(folder) => vec![folder],
        Data::More(folders) => folders,
    })
}

/// A device by its name.
mod device_name {
    use serde::{Deserialize, Deserializer, Serializer, de};
    use tch::Device;

    pub(super) fn serialize<S: Serializer>(device: &Device, to: S) -> Result<S::Ok, S::Error> {
        to.serialize_str(if device.is_cuda() { "cuda" } else { "cpu" })
    }

    pub(super) fn deserialize<'de, D: Deserializer<'de>>(from: D) -> Result<Device, D::Error> {
        match String::deserialize(from)?.as_str() {
            "cpu" => Ok(Device::Cpu),
            "cuda" => Ok(Device::Cuda(0)),
            other => Err(de::Error::custom(format!("device {other:?}"))),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::CameraChoice;

    #[test]
    fn a_network_sees_some_of_the_cameras_or_all() {
        let all = ["side", "wrist"].map(str::to_owned);
        let among = |text: &str| CameraChoice::of(text).among(&all);
        assert_eq!(among("single").unwrap(), ["side"]);
        assert_eq!(among("multi").unwrap(), ["side", "wrist"]);
        assert_eq!(among("wrist,side").unwrap(), ["wrist", "side"]);
        assert!(among("nose").unwrap_err().contains("side, wrist"));
        assert!(among("side,side").unwrap_err().contains("named twice"));
    }
}
