//! What a checkpoint says of the training that it came from.

use trocar_data::relative_action::REPRESENTATION;
use trocar_nets::checkpoint::{
    AggregationName, PolicyPreset, RECIPE_FORMAT, Recipe, RecommendedAggregation, RecordedCamera,
    Variants,
};
use trocar_train::AnyTrained;

use super::source::STEP_NS;
use super::training_data;
use super::training_save::Saver;

/// What is particular about the network that is trained.
pub(super) struct Made {
    pub(super) preset: PolicyPreset,
    pub(super) variants: Variants,
    pub(super) query_every_steps: u32,
}

pub(super) fn recipe(saver: &Saver<'_>, trained: &AnyTrained) -> Recipe {
    let Saver {
        options,
        train_options,
        dataset,
        made,
        ..
    } = saver;
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
            mode: AggregationName::Newest,
            decay: 0.01,
        },
        cameras,
        preset: made.preset,
        variants: made.variants,
        recipe: format!("trocar {}", options.command),
        dataset: training_data::summary(dataset),
        seed: options.seed,
        training: serde_json::json!({
            "options": train_options,
            "frames": trained.frames(),
            "seconds": saver.stopwatch.seconds(),
            "final": trained.curve().last().map(|row| serde_json::json!({"loss": row.loss, "l1": row.l1, "kl": row.kl})),
        }),
    }
}
