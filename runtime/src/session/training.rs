//! Training a policy on a dataset.

use std::fs;
use std::path::{Path, PathBuf};

use hal::TimeNs;
use policy::act::{ActConfig, ActPreset};
use policy::checkpoint::{
    self, AggregationName, DatasetSummary, PolicyPreset, Precision, RECIPE_FORMAT, Recipe,
    RecommendedAggregation, RecordedCamera, SaveOptions, Variants,
};
use policy::dataset::Dataset;
use policy::relative_action::REPRESENTATION;
use policy::train::{
    Augmentation, LossCurve, Progress, TrainError, TrainOptions, TrainPrecision, Trainer,
};
use serde::Serialize;
use tch::Device;

use super::source::STEP_NS;
use super::{SessionError, outputs, training_clouds};
use crate::rt::MonotonicClock;

/// Policy steps from one query to the next that a trained checkpoint asks for: half a chunk of the small preset, so that a fresh
/// one is there when the last ends.
const QUERY_EVERY_STEPS: u32 = 25;

/// Which of the dataset's cameras the network sees.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum CameraChoice {
    /// The only one; a dataset with several is refused.
    Single,
    /// All of them.
    Multi,
}

/// Which network is trained.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NetworkChoice {
    /// ACT, from colour images.
    Act,
    /// ACT-PC, from point clouds.
    ActPc,
    /// DP3, from point clouds.
    Dp3,
}

/// What to train.
#[derive(Clone, Debug)]
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
    /// Optimiser steps, if not the preset's.
    pub steps: Option<u64>,
    /// Samples a step, if not the preset's.
    pub batch: Option<usize>,
    /// Where to compute.
    pub device: Device,
    /// Compute in 16 bits; for accelerators.
    pub bf16: bool,
    /// Use only the first episodes.
    pub episodes: Option<usize>,
    /// Share of the episodes held out for validation.
    pub validation_share: f64,
    /// Shift and brighten images at random.
    pub augment: bool,
    /// Keep images in the host's memory instead of the device's.
    pub images_on_host: bool,
    /// Threads that decode images, and compute on the CPU.
    pub threads: usize,
    /// Everything random hangs on this.
    pub seed: u64,
    /// The command line, for the checkpoint's recipe.
    pub command: String,
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
}

/// How long a training has taken.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stopwatch {
    clock: MonotonicClock,
    begun: TimeNs,
}

impl Stopwatch {
    fn start() -> Self {
        let clock = MonotonicClock::new();
        let begun = clock.now();
        Self { clock, begun }
    }

    /// Time since the start, s.
    pub(super) fn seconds(&self) -> f64 {
        TimeNs(self.clock.now().since(self.begun)).seconds()
    }
}

/// Trains, and writes the checkpoint and its loss curve (`loss.csv`).
///
/// # Errors
/// [`SessionError::BadArgument`] if the checkpoint's folder is not empty or can't be written, before any work; from the
/// dataset, the training or the file system.
pub fn train(
    options: &TrainingOptions,
    on_progress: &mut dyn FnMut(&str),
) -> Result<TrainingResult, SessionError> {
    // Whatever is wrong with the options is said before anything is made.
    match options.network {
        NetworkChoice::Act => {
            let preset = parse_preset(&options.preset)?;
            if let Some(defect) = train_options(options, preset).defect() {
                return Err(TrainError::Options(defect).into());
            }
        }
        NetworkChoice::ActPc => {
            training_clouds::act_pc_options(options)?;
        }
        NetworkChoice::Dp3 => {
            training_clouds::dp3_preset(&options.preset)?;
            training_clouds::dp3_options(options, 1)?;
        }
    }
    outputs::new_folder(&options.out)?;
    let dataset = Dataset::open_first(&options.data, options.episodes)?;
    let stopwatch = Stopwatch::start();
    match options.network {
        NetworkChoice::Act => train_act(options, &dataset, &stopwatch, on_progress),
        NetworkChoice::ActPc => {
            training_clouds::train_act_pc(options, &dataset, &stopwatch, on_progress)
        }
        NetworkChoice::Dp3 => {
            training_clouds::train_dp3(options, &dataset, &stopwatch, on_progress)
        }
    }
}

fn train_act(
    options: &TrainingOptions,
    dataset: &Dataset,
    stopwatch: &Stopwatch,
    on_progress: &mut dyn FnMut(&str),
) -> Result<TrainingResult, SessionError> {
    let preset = parse_preset(&options.preset)?;
    let train_options = train_options(options, preset);
    let config = ActConfig::preset(preset, &cameras(options, dataset)?).for_arms(dataset.arms());
    say_size(dataset, train_options.steps, on_progress);
    let mut pace = Pace::default();
    let trained =
        Trainer::new(options.device).run(&config, &train_options, dataset, &mut |progress| {
            on_progress(&pace.line(progress, stopwatch.seconds()));
        })?;
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
    let save = SaveOptions {
        precision: Precision::F16,
        inference_only: true,
    };
    checkpoint::save(
        &options.out,
        &trained.act,
        &trained.statistics,
        &recipe,
        save,
    )?;
    write_curve(&options.out, &trained.curve)?;
    Ok(result(train_options.steps, &trained.curve, stopwatch))
}

pub(super) fn say_size(dataset: &Dataset, steps: u64, on_progress: &mut dyn FnMut(&str)) {
    on_progress(&format!(
        "{} episodes, {} frames; {steps} steps",
        dataset.episodes().len(),
        dataset.len(),
    ));
}

/// What a training came to.
pub(super) fn result(steps: u64, curve: &LossCurve, stopwatch: &Stopwatch) -> TrainingResult {
    let last = curve.last();
    TrainingResult {
        steps,
        loss: last.map_or(f64::NAN, |row| row.loss),
        validation_l1: last.and_then(|row| row.validation_l1),
        seconds: stopwatch.seconds(),
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
    let base = TrainOptions::preset(preset);
    let augmentation = if options.augment {
        Augmentation {
            shift_px: 4,
            brightness: 0.15,
            contrast: 0.15,
            state_noise: 0.02,
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
        threads: options.threads,
        seed: options.seed,
        ..base
    }
}

/// Says where a training stands, with the time that is left.
///
/// The pace is that of the steps since the first row of the curve: what came before it (decoding, the first steps, for
/// which an accelerator looks for its best kernels) says nothing about the rest.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Pace {
    /// Step and time of the first row.
    first: Option<(u64, f64)>,
}

impl Pace {
    /// The line about `progress` after `seconds`.
    pub(super) fn line(&mut self, progress: &Progress, seconds: f64) -> String {
        match *progress {
            Progress::Read { frames, of } => {
                format!("{frames} of {of} frames decoded; {seconds:.0} s")
            }
            Progress::Unseen { frames, of } => format!(
                "in {frames} of {of} frames nothing wanted is in view: their clouds lie at the origin"
            ),
            Progress::Row { steps, row } => {
                let (step, since) = *self.first.get_or_insert((row.step, seconds));
                let left = time_left(row.step - step, seconds - since, steps - row.step);
                let left = left.map_or_else(String::new, |left| format!(", {left:.0} s left"));
                let validation = row
                    .validation_l1
                    .map_or_else(String::new, |l1| format!(", validation l1 {l1:.5}"));
                format!(
                    "step {}/{steps}: loss {:.5}, l1 {:.5}, kl {:.5}, gradient {:.3}{validation}; {seconds:.0} s{left}",
                    row.step, row.loss, row.l1, row.kl, row.gradient_norm,
                )
            }
        }
    }
}

/// Time that `left` more steps take when `done` took `seconds`, s; unknown before there was one.
#[expect(clippy::cast_precision_loss, reason = "steps stay far below 2^52")]
fn time_left(done: u64, seconds: f64, left: u64) -> Option<f64> {
    (done > 0).then(|| seconds * left as f64 / done as f64)
}

/// What is particular about the network that was trained.
pub(super) struct Made<'a> {
    pub(super) preset: PolicyPreset,
    pub(super) variants: Variants,
    pub(super) query_every_steps: u32,
    pub(super) aggregation: AggregationName,
    pub(super) frames: usize,
    pub(super) curve: &'a LossCurve,
}

pub(super) fn recipe(
    options: &TrainingOptions,
    train_options: &TrainOptions,
    dataset: &Dataset,
    made: &Made<'_>,
    seconds: f64,
) -> Recipe {
    let spec = dataset.spec();
    let cameras = spec
        .cameras
        .iter()
        .map(|camera| RecordedCamera {
            feature: format!("observation.images.{}", camera.name),
            width: camera.width,
            height: camera.height,
        })
        .collect();
    Recipe {
        format: RECIPE_FORMAT,
        arms: spec.arms,
        action_representation: REPRESENTATION.to_owned(),
        step_ns: STEP_NS,
        query_every_steps: made.query_every_steps,
        aggregation: RecommendedAggregation {
            mode: made.aggregation,
            decay: 0.01,
        },
        cameras,
        preset: made.preset,
        variants: made.variants,
        recipe: format!("trocar {}", options.command),
        dataset: DatasetSummary {
            task: spec.task.clone(),
            episodes: dataset.episodes().len(),
            frames: dataset.len(),
            fps: spec.fps,
        },
        seed: options.seed,
        training: serde_json::json!({
            "options": train_options,
            "frames": made.frames,
            "seconds": seconds,
            "final": made.curve.last().map(|row| serde_json::json!({"loss": row.loss, "l1": row.l1, "kl": row.kl})),
        }),
    }
}

pub(super) fn write_curve(folder: &Path, curve: &LossCurve) -> Result<(), SessionError> {
    let path = folder.join("loss.csv");
    fs::write(&path, curve.to_csv()).map_err(|error| SessionError::output(&path, error))
}
