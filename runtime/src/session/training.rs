//! Training a policy on a dataset.

use std::fs;
use std::path::{Path, PathBuf};

use hal::TimeNs;
use policy::act::{ActConfig, ActPreset};
use policy::checkpoint::{
    self, AggregationName, DatasetSummary, Precision, RECIPE_FORMAT, Recipe,
    RecommendedAggregation, RecordedCamera, SaveOptions, Variants,
};
use policy::dataset::Dataset;
use policy::relative_action::REPRESENTATION;
use policy::train::{
    Augmentation, Progress, TrainError, TrainOptions, TrainPrecision, Trained, Trainer,
};
use serde::Serialize;
use tch::Device;

use super::source::STEP_NS;
use super::{SessionError, outputs};
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

/// What to train.
#[derive(Clone, Debug)]
pub struct TrainingOptions {
    /// The dataset's directory.
    pub data: PathBuf,
    /// The checkpoint's directory; a new or an empty one.
    pub out: PathBuf,
    /// Which cameras the network sees.
    pub cameras: CameraChoice,
    /// Sizes and recipe: `small`, `paper` or `lerobot`.
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

/// Trains, and writes the checkpoint and its loss curve (`loss.csv`).
///
/// # Errors
/// [`SessionError::BadArgument`] if the checkpoint's folder is not empty or can't be written, before any work; from the
/// dataset, the training or the file system.
pub fn train(
    options: &TrainingOptions,
    on_progress: &mut dyn FnMut(&str),
) -> Result<TrainingResult, SessionError> {
    let preset = parse_preset(&options.preset)?;
    let recipe_options = train_options(options, preset);
    if let Some(defect) = recipe_options.defect() {
        return Err(TrainError::Options(defect).into());
    }
    outputs::new_folder(&options.out)?;
    let dataset = Dataset::open_first(&options.data, options.episodes)?;
    let config = ActConfig::preset(preset, &cameras(options, &dataset)?).for_arms(dataset.arms());
    let clock = MonotonicClock::new();
    let begun = clock.now();
    let seconds = || TimeNs(clock.now().since(begun)).seconds();
    on_progress(&format!(
        "{} episodes, {} frames; {} steps",
        dataset.episodes().len(),
        dataset.len(),
        recipe_options.steps
    ));
    let trained =
        Trainer::new(options.device).run(&config, &recipe_options, &dataset, &mut |progress| {
            on_progress(&progress_line(progress, seconds()));
        })?;
    let recipe = recipe(
        options,
        preset,
        &config,
        &recipe_options,
        &dataset,
        &trained,
        seconds(),
    );
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
    write_curve(&options.out, &trained)?;
    let last = trained.curve.last();
    Ok(TrainingResult {
        steps: recipe_options.steps,
        loss: last.map_or(f64::NAN, |row| row.loss),
        validation_l1: last.and_then(|row| row.validation_l1),
        seconds: seconds(),
    })
}

/// The features of the cameras that the network sees.
fn cameras(options: &TrainingOptions, dataset: &Dataset) -> Result<Vec<String>, SessionError> {
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
            "--preset {unknown}: small, paper or lerobot"
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
        threads: options.threads,
        seed: options.seed,
        ..base
    }
}

fn progress_line(progress: &Progress, seconds: f64) -> String {
    let row = &progress.row;
    let validation = row
        .validation_l1
        .map_or_else(String::new, |l1| format!(", validation l1 {l1:.5}"));
    format!(
        "step {}/{}: loss {:.5}, l1 {:.5}, kl {:.5}, gradient {:.3}{validation}; {seconds:.0} s, {:.0} s left",
        row.step,
        progress.steps,
        row.loss,
        row.l1,
        row.kl,
        row.gradient_norm,
        progress.seconds_left(seconds)
    )
}

fn recipe(
    options: &TrainingOptions,
    preset: ActPreset,
    config: &ActConfig,
    train_options: &TrainOptions,
    dataset: &Dataset,
    trained: &Trained,
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
        query_every_steps: QUERY_EVERY_STEPS,
        aggregation: RecommendedAggregation {
            mode: AggregationName::WholeChunk,
            decay: 0.01,
        },
        cameras,
        preset,
        variants: Variants {
            backbone_norm: config.backbone_norm,
            loss_denominator: config.loss_denominator,
        },
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
            "frames": trained.frames,
            "seconds": seconds,
            "final": trained.curve.last().map(|row| serde_json::json!({"loss": row.loss, "l1": row.l1, "kl": row.kl})),
        }),
    }
}

fn write_curve(folder: &Path, trained: &Trained) -> Result<(), SessionError> {
    let path = folder.join("loss.csv");
    fs::write(&path, trained.curve.to_csv()).map_err(|error| SessionError::output(&path, error))
}
