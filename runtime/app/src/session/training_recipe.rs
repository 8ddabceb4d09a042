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
    let step_ns = 1_000_000_000 / u64::from(spec.fps.max(1));
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
        step_ns,
        query_every_steps: policy_steps(made.query_every_steps, step_ns),
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

/// So many of the dataset's steps, of `step_ns` each, in the policy steps that a run asks its policy by: no more than they last, and no more of them.
fn policy_steps(steps: u32, step_ns: u64) -> u32 {
    let whole = u64::from(steps) * step_ns / STEP_NS;
    u32::try_from(whole.max(1)).map_or(steps, |whole| whole.min(steps))
}

#[cfg(test)]
mod tests {
    use super::policy_steps;

    #[test]
    fn a_policy_is_asked_within_what_it_answers() {
        let steps = |fps: u64| policy_steps(25, 1_000_000_000 / fps);
        assert_eq!([25, 50, 5, 30].map(steps), [25, 12, 25, 20]);
        assert_eq!(policy_steps(1, 20_000_000), 1);
    }
}
