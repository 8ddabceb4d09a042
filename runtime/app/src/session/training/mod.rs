//! Training a policy on a dataset.

mod backbone;
mod clouds;
mod data;
pub mod evaluations;
mod options;
pub mod pace;
mod progress;
mod save;
mod stopwatch;
mod watch;

use std::path::Path;

use serde::Serialize;
use trocar_data::dataset::Dataset;
use trocar_data::perception::CloudRecipe;
use trocar_nets::act::{ActConfig, ActPreset};
use trocar_nets::checkpoint::Variants;
use trocar_train::{AnyTrained, Augmentation, TrainError, TrainOptions, TrainPrecision, Trainer};

use self::evaluations::{Evaluation, Evaluations};
pub use self::options::{CameraChoice, NetworkChoice, TrainingEval, TrainingOptions};
pub use self::progress::{OnProgress, TrainingProgress};
use self::save::{Made, Saver};
use self::stopwatch::Stopwatch;
use self::watch::{STATE_FILE, Watcher, read_state, remove_state, write_curve};
use super::cloud_file::cloud_recipe;
use super::{SessionError, outputs};
use crate::rt;

/// Policy steps from one query to the next that a trained checkpoint asks for: half a chunk of the
/// small preset, so that a fresh one is there when the last ends.
const QUERY_EVERY_STEPS: u32 = 25;

/// What `--augment` does to images and states.
const IMAGE_AUGMENTATION: Augmentation = Augmentation {
    shift_px: 4,
    brightness: 0.15,
    contrast: 0.15,
    state_noise: 0.02,
    point_noise_m: 0.0,
    point_dropout: 0.0,
};

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
    /// Samples that went through a second, from the first row of the loss curve to the last,
    /// without evaluations; unknown of one row.
    pub samples_per_second: Option<f64>,
    /// Evaluations along the way.
    pub evaluations: usize,
    /// The best of them, whose weights are in the folder [`BEST`](evaluations::BEST) of the
    /// checkpoint's.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub best: Option<Evaluation>,
}

/// Trains, and writes the checkpoint, its loss curve (`loss.csv`), the same for TensorBoard, and if
/// asked evaluations along the way (`evaluations.csv`) and the weights that did best in them
/// (`best/`).
///
/// SIGINT, SIGTERM and SIGHUP make it keep its state and stop after the step at hand.
///
/// # Errors
/// [`SessionError::BadArgument`] if the checkpoint's folder is not empty or can't be written,
/// before any work; from the dataset, the training or the file system; [`TrainError::Stopped`].
pub fn train(
    options: &TrainingOptions,
    on_progress: &mut OnProgress<'_>,
) -> Result<TrainingResult, SessionError> {
    // Whatever is wrong with the options is said before anything is made.
    check(options)?;
    let trainer = backbone::trainer(options)?;
    outputs::new_folder("--out", &options.out)?;
    let start = Start {
        trainer,
        stopwatch: Stopwatch::start(0.0),
        evaluations: Vec::new(),
    };
    train_from(options, start, on_progress)
}

fn check_act(options: &TrainingOptions) -> Result<(), SessionError> {
    let preset = parse_preset(&options.preset)?;
    sound(train_options(options, preset))?;
    if options.clouds.is_some() {
        let defect = "--clouds: act sees images; of act-pc and dp3";
        return Err(SessionError::BadArgument(defect.to_owned()));
    }
    Ok(())
}

/// `options`, if a training can have them.
fn sound(options: TrainOptions) -> Result<TrainOptions, SessionError> {
    match options.defect() {
        Some(defect) => Err(TrainError::Options(defect).into()),
        None => Ok(options),
    }
}

/// Refuses options that can't be, of the command line and of a state that may be damaged alike.
pub(super) fn check(options: &TrainingOptions) -> Result<(), SessionError> {
    backbone::check(options)?;
    if options.device.is_cuda() && !tch::Cuda::is_available() {
        let defect = "--device cuda: this libtorch sees no CUDA device";
        return Err(SessionError::BadArgument(defect.to_owned()));
    }
    match options.network {
        NetworkChoice::Act => check_act(options)?,
        NetworkChoice::ActPc => {
            clouds::act_pc_options(options)?;
            cloud_recipe(options.clouds.as_deref(), 1)?;
        }
        NetworkChoice::Dp3 => {
            clouds::dp3_preset(&options.preset)?;
            clouds::dp3_options(options, 1)?;
            cloud_recipe(options.clouds.as_deref(), 1)?;
        }
    }
    Ok(())
}

/// Goes on with the training whose state is in the checkpoint's folder `folder`, with the options
/// that it was begun with.
///
/// # Errors
/// [`SessionError::BadArgument`] if there is no state; otherwise those of [`train`], and
/// [`TrainError::State`] if the dataset is another one now.
pub fn resume(
    folder: &Path,
    on_progress: &mut OnProgress<'_>,
) -> Result<TrainingResult, SessionError> {
    let (state, about) = read_state(folder)?;
    let options = about.options;
    check(&options).map_err(|error| {
        let file = folder.join(STATE_FILE);
        SessionError::BadArgument(format!("{}: its options: {error}", file.display()))
    })?;
    let start = Start {
        trainer: Trainer::new(options.device).resuming(state),
        stopwatch: Stopwatch::start(about.seconds),
        evaluations: about.evaluations,
    };
    train_from(&options, start, on_progress)
}

/// Where a training starts from.
struct Start {
    trainer: Trainer,
    stopwatch: Stopwatch,
    /// Those that were done before it was stopped.
    evaluations: Vec<Evaluation>,
}

impl Start {
    /// What writes the checkpoints of the training that begins here.
    fn saver<'a>(
        &self,
        options: &'a TrainingOptions,
        train_options: TrainOptions,
        dataset: &'a Dataset,
        made: Made,
        cloud: Option<CloudRecipe>,
    ) -> Saver<'a> {
        Saver {
            options,
            train_options,
            dataset,
            stopwatch: self.stopwatch,
            made,
            cloud,
        }
    }
}

fn train_from(
    options: &TrainingOptions,
    start: Start,
    on_progress: &mut OnProgress<'_>,
) -> Result<TrainingResult, SessionError> {
    rt::catch_interrupts().map_err(SessionError::signals)?;
    let dataset = data::open(options)?;
    let result = match options.network {
        NetworkChoice::Act => train_act(options, &dataset, &start, on_progress),
        NetworkChoice::ActPc => clouds::train_act_pc(options, &dataset, &start, on_progress),
        NetworkChoice::Dp3 => clouds::train_dp3(options, &dataset, &start, on_progress),
    }?;
    remove_state(&options.out)?;
    Ok(result)
}

/// The network of `preset` for the arms and the cameras of `dataset`.
fn act_config(options: &TrainingOptions, preset: ActPreset, dataset: &Dataset) -> ActConfig {
    ActConfig {
        backbone_norm: options.backbone,
        ..ActConfig::preset(preset, &cameras(dataset)).for_arms(dataset.arms())
    }
}

fn train_act(
    options: &TrainingOptions,
    dataset: &Dataset,
    start: &Start,
    on_progress: &mut OnProgress<'_>,
) -> Result<TrainingResult, SessionError> {
    let preset = parse_preset(&options.preset)?;
    let train_options = train_options(options, preset);
    let config = act_config(options, preset, dataset);
    let made = Made {
        preset: preset.into(),
        variants: Variants {
            backbone_norm: config.backbone_norm,
            loss_denominator: config.loss_denominator,
        },
        query_every_steps: query_every(options, QUERY_EVERY_STEPS, config.chunk_size)?,
    };
    let saver = start.saver(options, train_options, dataset, made, None);
    conduct(&saver, start, on_progress, &mut |watcher| {
        let trained = start
            .trainer
            .run(&config, &train_options, dataset, watcher)?;
        Ok(AnyTrained::Act(trained.into()))
    })
}

/// Says what is learned from, and in how many steps.
fn note_data(dataset: &Dataset, steps: u64, on_progress: &mut OnProgress<'_>) {
    let mut learned_from = data::described(dataset);
    if let Some(whole) = learned_from.last_mut() {
        *whole += &format!("; {steps} steps");
    }
    for line in &learned_from {
        on_progress(&TrainingProgress::Note(line));
    }
}

/// Runs a training, watched, and writes its checkpoint and its loss curve.
fn conduct(
    saver: &Saver<'_>,
    start: &Start,
    on_progress: &mut OnProgress<'_>,
    run: &mut dyn FnMut(&mut Watcher<'_>) -> Result<AnyTrained, TrainError>,
) -> Result<TrainingResult, SessionError> {
    let (dataset, steps) = (saver.dataset, saver.train_options.steps);
    let evaluations = Evaluations::new(saver.options, dataset, start.evaluations.clone())?;
    note_data(dataset, steps, on_progress);
    let mut watcher = Watcher::new(saver, evaluations, on_progress);
    let trained = run(&mut watcher)?;
    let out = &saver.options.out;
    saver.save(out, &trained)?;
    write_curve(out, trained.curve())?;
    Ok(result(steps, start.stopwatch.seconds(), &watcher, &trained))
}

fn result(steps: u64, seconds: f64, watcher: &Watcher<'_>, trained: &AnyTrained) -> TrainingResult {
    let last = trained.curve().last();
    let evaluations = watcher.evaluations.as_ref();
    TrainingResult {
        steps,
        loss: last.map_or(f64::NAN, |row| row.loss),
        validation_l1: last.and_then(|row| row.validation_l1),
        seconds,
        samples_per_second: watcher.pace.samples_per_second(),
        evaluations: evaluations.map_or(0, |all| all.rows().len()),
        best: evaluations.and_then(Evaluations::best),
    }
}

/// The features of the dataset's cameras, which are those that the network sees.
fn cameras(dataset: &Dataset) -> Vec<String> {
    let names = dataset.camera_names().iter();
    names
        .map(|name| format!("observation.images.{name}"))
        .collect()
}

fn parse_preset(name: &str) -> Result<ActPreset, SessionError> {
    match name {
        "small" => Ok(ActPreset::Small),
        "compact" => Ok(ActPreset::Compact),
        "paper" => Ok(ActPreset::Paper),
        "lerobot" => Ok(ActPreset::Lerobot),
        unknown => Err(SessionError::BadArgument(format!(
            "--preset {unknown}: of act, small, compact, paper or lerobot"
        ))),
    }
}

/// Policy steps between queries: the user's number, which a chunk of `steps` must last for, or
/// `usual`.
pub(super) fn query_every(
    options: &TrainingOptions,
    usual: u32,
    steps: i64,
) -> Result<u32, SessionError> {
    let every = options.query_every.unwrap_or(usual);
    if i64::from(every) <= steps {
        return Ok(every);
    }
    Err(SessionError::BadArgument(format!(
        "--query-every {every}: a chunk of this network has {steps} steps"
    )))
}

/// `base` with the learning rate that the user wants, and `augmentation` as they want it.
fn as_wanted(
    options: &TrainingOptions,
    base: TrainOptions,
    augmentation: Augmentation,
) -> TrainOptions {
    TrainOptions {
        lr: options.lr.unwrap_or(base.lr),
        lr_backbone: options.lr.unwrap_or(base.lr_backbone),
        augmentation: Augmentation {
            shift_px: options.shift_px.unwrap_or(augmentation.shift_px),
            state_noise: options.state_noise.unwrap_or(augmentation.state_noise),
            ..augmentation
        },
        ..base
    }
}

/// The recipe for `preset` with the backbone and the augmentation that the user wants.
fn base_options(options: &TrainingOptions, preset: ActPreset) -> TrainOptions {
    let base = if options.published {
        TrainOptions::published(preset)
    } else {
        TrainOptions::preset(preset)
    };
    let augmentation = if options.augment {
        IMAGE_AUGMENTATION
    } else {
        base.augmentation
    };
    let base = as_wanted(options, base, augmentation);
    if options.backbone_weights.is_some() {
        base.for_trained_backbone()
    } else {
        base
    }
}

pub(super) fn train_options(options: &TrainingOptions, preset: ActPreset) -> TrainOptions {
    let base = base_options(options, preset);
    TrainOptions {
        steps: options.steps.unwrap_or(base.steps),
        batch: options.batch.unwrap_or(base.batch),
        precision: if options.bf16 {
            TrainPrecision::Bf16
        } else {
            base.precision
        },
        validation_share: options.validation_share,
        images_on_host: options.images_on_host,
        eager: options.eager,
        save_every: options.save_every,
        threads: options.threads,
        seed: options.seed,
        ..base
    }
}
