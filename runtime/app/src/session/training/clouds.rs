//! Training of the policies that see point clouds.

use hal::count::count_u32;
use trocar_data::dataset::Dataset;
use trocar_data::perception::CloudRecipe;
use trocar_data::relative_action::RELATIVE_ACTION_DIM;
use trocar_nets::act::ActPreset;
use trocar_nets::act_pc::{ActPcConfig, ActPcPreset};
use trocar_nets::checkpoint::Variants;
use trocar_nets::dimension::{dimension, length};
use trocar_nets::dp3::{Dp3Config, Dp3Preset};
use trocar_train::{AnyTrained, Augmentation, TrainOptions, TrainPrecision};

use super::save::Made;
use super::{
    OnProgress, Start, TrainingOptions, TrainingResult, as_wanted, cameras, conduct, query_every,
    sound,
};
use crate::session::SessionError;
use crate::session::cloud_file::cloud_recipe;

/// Points in a cloud, of the published real tasks.
const POINTS: usize = 1024;

/// Times that DP3's published recipe sees every frame.
const DP3_EPOCHS: usize = 3000;

/// What `--augment` does to clouds: a depth camera's noise, a tenth of the points hidden, and the
/// state as for images.
const CLOUD_AUGMENTATION: Augmentation = Augmentation {
    shift_px: 0,
    brightness: 0.0,
    contrast: 0.0,
    state_noise: 0.02,
    point_noise_m: 0.0003,
    point_dropout: 0.1,
};

/// Trains DP3 or SimpleDP3 and writes the checkpoint and its loss curve.
pub(super) fn train_dp3(
    options: &TrainingOptions,
    dataset: &Dataset,
    start: &Start,
    on_progress: &mut OnProgress<'_>,
) -> Result<TrainingResult, SessionError> {
    let preset = dp3_preset(&options.preset)?;
    let numbers = dimension(RELATIVE_ACTION_DIM * dataset.arms());
    let config = Dp3Config::preset(preset, numbers, numbers);
    let train_options = dp3_options(options, dataset.len())?;
    let cloud = cloud_recipe(options.clouds.as_deref(), POINTS)?;
    let steps = config.n_action_steps;
    let made = Made {
        preset: preset.into(),
        variants: Variants::default(),
        query_every_steps: query_every(options, count_u32(length(steps)), steps)?,
    };
    let saver = start.saver(options, train_options, dataset, made, Some(cloud.clone()));
    conduct(&saver, start, on_progress, &mut |watcher| {
        let trainer = &start.trainer;
        let trained = trainer.run_dp3(&config, &cloud, &train_options, dataset, watcher)?;
        Ok(AnyTrained::Dp3(trained.into()))
    })
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
    refuse_images(options, "dp3")?;
    let precision = match options.bf16 {
        true => TrainPrecision::Bf16,
        false => TrainPrecision::F32,
    };
    let batch = options.batch.unwrap_or(TrainOptions::dp3(1).batch);
    let published = DP3_EPOCHS.saturating_mul(frames.div_ceil(batch.max(1)));
    let published = TrainOptions::dp3(options.steps.unwrap_or(published as u64));
    let train_options = TrainOptions {
        batch,
        precision,
        validation_share: options.validation_share,
        save_every: options.save_every,
        eager: options.eager,
        threads: options.threads,
        seed: options.seed,
        ..as_wanted(options, published, augmentation(options))
    };
    sound(train_options)
}

fn augmentation(options: &TrainingOptions) -> Augmentation {
    if options.augment {
        CLOUD_AUGMENTATION
    } else {
        Augmentation::default()
    }
}

/// What there is for images only, with the reason.
fn refuse_images(options: &TrainingOptions, network: &str) -> Result<(), SessionError> {
    let refused = [
        (
            "--images-on-host",
            options.images_on_host,
            "it sees no images",
        ),
        (
            "--shift-px",
            options.shift_px.is_some(),
            "it sees no images",
        ),
    ];
    match refused.iter().find(|(_, asked, _)| *asked) {
        None => Ok(()),
        Some((name, _, reason)) => Err(SessionError::BadArgument(format!(
            "{name}: not of {network}: {reason}"
        ))),
    }
}

/// The named ACT-PC network, and ACT's recipe of its size or the published one.
fn act_pc_base(options: &TrainingOptions) -> Result<(ActPcPreset, TrainOptions), SessionError> {
    let (preset, base) = match options.preset.as_str() {
        "small" => (ActPcPreset::Small, ActPreset::Small),
        "paper" => (ActPcPreset::Paper, ActPreset::Paper),
        "pcm" => (ActPcPreset::PointCloudMatters, ActPreset::Paper),
        unknown => {
            return Err(SessionError::BadArgument(format!(
                "--preset {unknown}: of act-pc, small, paper or pcm"
            )));
        }
    };
    let base = match (options.published, preset) {
        (false, _) => TrainOptions::preset(base),
        (true, ActPcPreset::PointCloudMatters) => TrainOptions::point_cloud_matters(),
        (true, ActPcPreset::Paper | ActPcPreset::Small) => TrainOptions::published(base),
    };
    Ok((preset, base))
}

/// The named ACT-PC network, and ACT's recipe of its size with what the user wants otherwise.
pub(super) fn act_pc_options(
    options: &TrainingOptions,
) -> Result<(ActPcPreset, TrainOptions), SessionError> {
    refuse_images(options, "act-pc")?;
    if options.bf16 {
        return Err(SessionError::BadArgument(
            "--bf16: not of act-pc: places of neighbours would be rounded by more than they are apart".to_owned(),
        ));
    }
    let (preset, base) = act_pc_base(options)?;
    let train_options = TrainOptions {
        steps: options.steps.unwrap_or(base.steps),
        batch: options.batch.unwrap_or(base.batch),
        validation_share: options.validation_share,
        save_every: options.save_every,
        eager: options.eager,
        threads: options.threads,
        seed: options.seed,
        ..as_wanted(options, base, augmentation(options))
    };
    Ok((preset, sound(train_options)?))
}

/// The network of `preset` for the arms and the cameras of `dataset`, and the clouds that it sees.
fn act_pc_config(
    options: &TrainingOptions,
    preset: ActPcPreset,
    dataset: &Dataset,
) -> Result<(ActPcConfig, CloudRecipe), SessionError> {
    let config = ActPcConfig::preset(preset, &cameras(dataset));
    let cloud = cloud_recipe(options.clouds.as_deref(), length(config.points))?;
    let config = ActPcConfig {
        act: config.act.for_arms(dataset.arms()),
        points: dimension(cloud.points),
        ..config
    };
    Ok((config, cloud))
}

/// Trains ACT-PC and writes the checkpoint and its loss curve.
pub(super) fn train_act_pc(
    options: &TrainingOptions,
    dataset: &Dataset,
    start: &Start,
    on_progress: &mut OnProgress<'_>,
) -> Result<TrainingResult, SessionError> {
    let (preset, train_options) = act_pc_options(options)?;
    let (config, cloud) = act_pc_config(options, preset, dataset)?;
    let steps = config.act.chunk_size;
    let made = Made {
        preset: preset.into(),
        variants: Variants {
            loss_denominator: config.act.loss_denominator,
            ..Variants::default()
        },
        query_every_steps: query_every(options, count_u32(length(steps / 2)), steps)?,
    };
    let saver = start.saver(options, train_options, dataset, made, Some(cloud.clone()));
    conduct(&saver, start, on_progress, &mut |watcher| {
        let trainer = &start.trainer;
        let trained = trainer.run_act_pc(&config, &cloud, &train_options, dataset, watcher)?;
        Ok(AnyTrained::ActPc(trained.into()))
    })
}
