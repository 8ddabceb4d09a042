//! Training a policy on a dataset.

use std::path::{Path, PathBuf};

use policy::act::{ActConfig, ActPreset, BackboneNorm};
use policy::checkpoint::{self, AggregationName, Variants};
use policy::dataset::Dataset;
use policy::train::{
    Augmentation, LossCurve, RunState, TrainError, TrainOptions, TrainPrecision, Trainer,
};
use serde::{Deserialize, Serialize};
use tch::Device;

use super::cloud_file::cloud_recipe;
use super::training_recipe::{Made, recipe};
use super::training_watch::{
    Pace, STATE_FILE, Stopwatch, Watcher, read_state, remove_state, write_curve,
};
use super::{SessionError, outputs, training_backbone, training_clouds};
use crate::rt;

/// Policy steps from one query to the next that a trained checkpoint asks for: half a chunk of the small preset, so that a fresh
/// one is there when the last ends.
const QUERY_EVERY_STEPS: u32 = 25;

/// Which of the dataset's cameras the network sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub enum CameraChoice {
    /// The only one; a dataset with several is refused.
    Single,
    /// All of them.
    Multi,
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

/// What to train.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct TrainingOptions {
    /// The network.
    pub network: NetworkChoice,
    /// The dataset's directory.
    pub data: PathBuf,
    /// The checkpoint's directory; a new or an empty one.
    pub out: PathBuf,
    /// Which cameras the network sees.
    pub cameras: CameraChoice,
    /// Sizes and recipe: `small`, `paper` or `lerobot`; of DP3, `paper` or `simple`; of ACT-PC, `small`,
    /// `paper` or `pcm`.
    pub preset: String,
    /// Whether the recipe is the authors' own, which begins from an ImageNet backbone, instead of one that learns from scratch.
    pub published: bool,
    /// Normalisation layers of ACT's backbone; in options from before there was a choice, group normalisation.
    #[serde(default = "group_norm")]
    pub backbone: BackboneNorm,
    /// What a backbone with frozen batch normalisation starts from: a safetensors file or a policy's folder.
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
    /// Use only the first episodes.
    pub episodes: Option<usize>,
    /// Share of the episodes held out for validation.
    pub validation_share: f64,
    /// Change what is trained on at random: shift and brighten images, move and hide points, disturb states.
    pub augment: bool,
    /// What clouds are made of instead of the built-in config/clouds.toml.
    pub clouds: Option<PathBuf>,
    /// Keep images in the host's memory instead of the device's.
    pub images_on_host: bool,
    /// Tell an accelerator each operation of every step instead of repeating a recorded step.
    #[serde(default)]
    pub eager: bool,
    /// Threads that decode images, and compute on the CPU.
    pub threads: usize,
    /// Everything random hangs on this.
    pub seed: u64,
    /// Steps between two times that the state is kept, from which the training can go on; 0 is never.
    pub save_every: u64,
    /// The command line, for the checkpoint's recipe.
    pub command: String,
}

const fn group_norm() -> BackboneNorm {
    BackboneNorm::GroupNorm
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

/// What training came to.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct TrainingResult {
    /// Optimiser steps taken.
    pub steps: u64,
    /// Total loss over the last row of the loss curve.
    pub loss: f64,
    /// Mean absolute error on held-out episodes, normalised, if there were any.
    pub validation_l1: Option<f64>,
    /// Time it took, s.
    pub seconds: f64,
    /// Samples that went through a second, from the first row of the loss curve to the last; unknown of one row.
    pub samples_per_second: Option<f64>,
}

/// Trains, and writes the checkpoint and its loss curve (`loss.csv`).
///
/// SIGINT, SIGTERM and SIGHUP make it keep its state and stop after the step at hand.
///
/// # Errors
/// [`SessionError::BadArgument`] if the checkpoint's folder is not empty or can't be written, before any work; from the
/// dataset, the training or the file system; [`TrainError::Stopped`].
pub fn train(
    options: &TrainingOptions,
    on_progress: &mut dyn FnMut(&str),
) -> Result<TrainingResult, SessionError> {
    // Whatever is wrong with the options is said before anything is made.
    check(options)?;
    let trainer = training_backbone::trainer(options)?;
    outputs::new_folder(&options.out)?;
    let start = Start {
        trainer,
        stopwatch: Stopwatch::start(0.0),
    };
    train_from(options, start, on_progress)
}

/// Refuses options that can't be, of the command line and of a state that may be damaged alike.
pub(super) fn check(options: &TrainingOptions) -> Result<(), SessionError> {
    training_backbone::check(options)?;
    if options.device.is_cuda() && !tch::Cuda::is_available() {
        let defect = "--device cuda: this libtorch sees no CUDA device";
        return Err(SessionError::BadArgument(defect.to_owned()));
    }
    match options.network {
        NetworkChoice::Act => {
            let preset = parse_preset(&options.preset)?;
            if let Some(defect) = train_options(options, preset).defect() {
                return Err(TrainError::Options(defect).into());
            }
            if options.clouds.is_some() {
                let defect = "--clouds: act sees images; of act-pc and dp3";
                return Err(SessionError::BadArgument(defect.to_owned()));
            }
        }
        NetworkChoice::ActPc => {
            training_clouds::act_pc_options(options)?;
            cloud_recipe(options.clouds.as_deref(), 1)?;
        }
        NetworkChoice::Dp3 => {
            training_clouds::dp3_preset(&options.preset)?;
            training_clouds::dp3_options(options, 1)?;
            cloud_recipe(options.clouds.as_deref(), 1)?;
        }
    }
    Ok(())
}

/// Goes on with the training whose state is in the checkpoint's folder `folder`, with the options that it was begun with.
///
/// # Errors
/// [`SessionError::BadArgument`] if there is no state; otherwise those of [`train`], and [`TrainError::State`] if the
/// dataset is another one now.
pub fn resume(
    folder: &Path,
    on_progress: &mut dyn FnMut(&str),
) -> Result<TrainingResult, SessionError> {
    let (state, options, seconds): (RunState, _, _) = read_state(folder)?;
    check(&options).map_err(|error| {
        let file = folder.join(STATE_FILE);
        SessionError::BadArgument(format!("{}: its options: {error}", file.display()))
    })?;
    let start = Start {
        trainer: Trainer::new(options.device).resuming(state),
        stopwatch: Stopwatch::start(seconds),
    };
    train_from(&options, start, on_progress)
}

/// Where a training starts from.
pub(super) struct Start {
    pub(super) trainer: Trainer,
    pub(super) stopwatch: Stopwatch,
}

fn train_from(
    options: &TrainingOptions,
    start: Start,
    on_progress: &mut dyn FnMut(&str),
) -> Result<TrainingResult, SessionError> {
    rt::catch_interrupts()
        .map_err(|error| SessionError::RealTime(format!("signals can't be caught: {error}")))?;
    let dataset = Dataset::open_first(&options.data, options.episodes)?;
    let result = match options.network {
        NetworkChoice::Act => train_act(options, &dataset, &start, on_progress),
        NetworkChoice::ActPc => {
            training_clouds::train_act_pc(options, &dataset, &start, on_progress)
        }
        NetworkChoice::Dp3 => training_clouds::train_dp3(options, &dataset, &start, on_progress),
    }?;
    remove_state(&options.out)?;
    Ok(result)
}

fn train_act(
    options: &TrainingOptions,
    dataset: &Dataset,
    Start { trainer, stopwatch }: &Start,
    on_progress: &mut dyn FnMut(&str),
) -> Result<TrainingResult, SessionError> {
    let preset = parse_preset(&options.preset)?;
    let train_options = train_options(options, preset);
    let config = ActConfig {
        backbone_norm: options.backbone,
        ..ActConfig::preset(preset, &cameras(options, dataset)?).for_arms(dataset.arms())
    };
    say_size(dataset, train_options.steps, on_progress);
    let mut watcher = Watcher::new(options, stopwatch, on_progress);
    let trained = trainer.run(&config, &train_options, dataset, &mut watcher)?;
    let pace = watcher.pace;
    let made = Made {
        preset: preset.into(),
        variants: Variants {
            backbone_norm: config.backbone_norm,
            loss_denominator: config.loss_denominator,
        },
        query_every_steps: QUERY_EVERY_STEPS,
        aggregation: AggregationName::WholeChunk,
        frames: trained.frames,
        curve: &trained.curve,
    };
    let recipe = recipe(options, &train_options, dataset, &made, stopwatch.seconds());
    let save = training_backbone::kept(options.backbone);
    checkpoint::save(
        &options.out,
        &trained.act,
        &trained.statistics,
        &recipe,
        save,
    )?;
    write_curve(&options.out, &trained.curve)?;
    Ok(result(&train_options, &trained.curve, (pace, stopwatch)))
}

pub(super) fn say_size(dataset: &Dataset, steps: u64, on_progress: &mut dyn FnMut(&str)) {
    on_progress(&format!(
        "{} episodes, {} frames; {steps} steps",
        dataset.episodes().len(),
        dataset.len(),
    ));
}

/// What a training came to, at its `pace`.
pub(super) fn result(
    train_options: &TrainOptions,
    curve: &LossCurve,
    (pace, stopwatch): (Pace, &Stopwatch),
) -> TrainingResult {
    let last = curve.last();
    TrainingResult {
        steps: train_options.steps,
        loss: last.map_or(f64::NAN, |row| row.loss),
        validation_l1: last.and_then(|row| row.validation_l1),
        seconds: stopwatch.seconds(),
        samples_per_second: pace.samples_per_second(train_options.batch),
    }
}

/// The features of the cameras that the network sees.
pub(super) fn cameras(
    options: &TrainingOptions,
    dataset: &Dataset,
) -> Result<Vec<String>, SessionError> {
    let names = dataset.camera_names();
    if options.cameras == CameraChoice::Single && names.len() > 1 {
        return Err(SessionError::BadArgument(format!(
            "--cameras single: {} has {} cameras ({}), and a network is trained on all of its dataset's cameras",
            options.data.display(),
            names.len(),
            names.join(", ")
        )));
    }
    Ok(names
        .iter()
        .map(|name| format!("observation.images.{name}"))
        .collect())
}

fn parse_preset(name: &str) -> Result<ActPreset, SessionError> {
    match name {
        "small" => Ok(ActPreset::Small),
        "paper" => Ok(ActPreset::Paper),
        "lerobot" => Ok(ActPreset::Lerobot),
        unknown => Err(SessionError::BadArgument(format!(
            "--preset {unknown}: of act, small, paper or lerobot"
        ))),
    }
}

fn train_options(options: &TrainingOptions, preset: ActPreset) -> TrainOptions {
    let base = if options.published {
        TrainOptions::published(preset)
    } else {
        TrainOptions::preset(preset)
    };
    let base = match options.backbone {
        BackboneNorm::FrozenBatchNorm => base.for_trained_backbone(),
        BackboneNorm::GroupNorm => base,
    };
    let augmentation = if options.augment {
        Augmentation {
            shift_px: 4,
            brightness: 0.15,
            contrast: 0.15,
            state_noise: 0.02,
            ..base.augmentation
        }
    } else {
        base.augmentation
    };
    TrainOptions {
        steps: options.steps.unwrap_or(base.steps),
        batch: options.batch.unwrap_or(base.batch),
        precision: if options.bf16 {
            TrainPrecision::Bf16
        } else {
            base.precision
        },
        validation_share: options.validation_share,
        augmentation,
        images_on_host: options.images_on_host,
        eager: options.eager,
        save_every: options.save_every,
        threads: options.threads,
        seed: options.seed,
        ..base
    }
}
