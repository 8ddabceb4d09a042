//! What a checkpoint says of the training that it came from.

use policy::checkpoint::{
    AggregationName, DatasetSummary, PolicyPreset, RECIPE_FORMAT, Recipe, RecommendedAggregation,
    RecordedCamera, Variants,
};
use policy::dataset::Dataset;
use policy::relative_action::REPRESENTATION;
use policy::train::{LossCurve, TrainOptions};

use super::source::STEP_NS;
use super::training::TrainingOptions;

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
