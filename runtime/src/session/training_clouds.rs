//! Training of the policies that see point clouds.

use policy::act::BackboneNorm;
use policy::checkpoint::{self, AggregationName, Precision, Variants};
use policy::dataset::Dataset;
use policy::dp3::{Dp3Config, Dp3Preset};
use policy::perception::{CloudFrame, CloudRecipe, Padding};
use policy::relative_action::RELATIVE_ACTION_DIM;
use policy::train::{TrainError, TrainOptions, TrainPrecision, Trainer};
use sim_backend::visual::instance;

use super::SessionError;
use super::training::{
    Made, Stopwatch, TrainingOptions, TrainingResult, cameras, progress_line, recipe, result,
    say_size, write_curve,
};

/// Points in a cloud, of the published real tasks.
const POINTS: usize = 1024;

/// Times that DP3's published recipe sees every frame.
const DP3_EPOCHS: usize = 3000;

/// What is in a cloud: neither background nor ground, and of the instruments only what works. A shaft has more surface
/// than all else together and tells nothing that the joints do not.
fn cloud_recipe() -> CloudRecipe {
    CloudRecipe {
        frame: CloudFrame::Scene,
        crop_m: None,
        dropped_instances: vec![0, instance::ORGAN, instance::SHAFT, instance::SECOND_SHAFT],
        voxel_m: None,
        points: POINTS,
        padding: Padding::FirstPoint,
    }
}

/// Trains DP3 or SimpleDP3 and writes the checkpoint and its loss curve.
pub(super) fn train_dp3(
    options: &TrainingOptions,
    dataset: &Dataset,
    stopwatch: &Stopwatch,
    on_progress: &mut dyn FnMut(&str),
) -> Result<TrainingResult, SessionError> {
    let preset = dp3_preset(&options.preset)?;
    // Both choices of cameras are checked as for images.
    cameras(options, dataset)?;
    let numbers = i64::try_from(RELATIVE_ACTION_DIM * dataset.arms()).unwrap_or(i64::MAX);
    let config = Dp3Config::preset(preset, numbers, numbers);
    let train_options = dp3_options(options, dataset.len())?;
    let cloud = cloud_recipe();
    say_size(dataset, train_options.steps, on_progress);
    let trained = Trainer::new(options.device).run_dp3(
        &config,
        &cloud,
        &train_options,
        dataset,
        &mut |progress| on_progress(&progress_line(progress, stopwatch.seconds())),
    )?;
    let made = Made {
        preset: preset.into(),
        variants: Variants {
            backbone_norm: BackboneNorm::default(),
            ..Variants::default()
        },
        query_every_steps: u32::try_from(config.n_action_steps).unwrap_or(1),
        aggregation: AggregationName::Newest,
        frames: trained.frames,
        curve: &trained.curve,
    };
    let recipe = recipe(options, &train_options, dataset, &made, stopwatch.seconds());
    let (out, precision) = (&options.out, Precision::F16);
    checkpoint::save_dp3(
        out,
        &trained.dp3,
        &cloud,
        &trained.statistics,
        &recipe,
        precision,
    )?;
    write_curve(out, &trained.curve)?;
    Ok(result(train_options.steps, &trained.curve, stopwatch))
}

/// Reads the name of a DP3 network.
pub(super) fn dp3_preset(name: &str) -> Result<Dp3Preset, SessionError> {
    match name {
        "paper" => Ok(Dp3Preset::Dp3),
        "simple" => Ok(Dp3Preset::Simple),
        unknown => Err(SessionError::BadArgument(format!(
            "--preset {unknown}: of dp3, paper or simple"
        ))),
    }
}

/// The published recipe with what the user wants otherwise, for a dataset of `frames`.
pub(super) fn dp3_options(
    options: &TrainingOptions,
    frames: usize,
) -> Result<TrainOptions, SessionError> {
    let refused = [("--augment", options.augment), ("--bf16", options.bf16)];
    if let Some((name, _)) = refused.iter().find(|(_, asked)| *asked) {
        let defect = format!("{name}: dp3 has no such thing");
        return Err(SessionError::BadArgument(defect));
    }
    let batch = options.batch.unwrap_or(TrainOptions::dp3(1).batch);
    let published = DP3_EPOCHS.saturating_mul(frames.div_ceil(batch.max(1)));
    let train_options = TrainOptions {
        batch,
        precision: TrainPrecision::F32,
        validation_share: options.validation_share,
        threads: options.threads,
        seed: options.seed,
        ..TrainOptions::dp3(options.steps.unwrap_or(published as u64))
    };
    match train_options.defect() {
        Some(defect) => Err(TrainError::Options(defect).into()),
        None => Ok(train_options),
    }
}
