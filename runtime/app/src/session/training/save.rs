//! How a trained network becomes a checkpoint, and what that says of the training.
//!
//! A checkpoint is the weights, the statistics by which inputs and outputs are normalised, and the
//! recipe, which tells a run how often to ask and what to show. What weights look like in a file is
//! `trocar_nets::checkpoint`.

use std::path::Path;

use trocar_data::dataset::Dataset;
use trocar_data::perception::CloudRecipe;
use trocar_data::relative_action::REPRESENTATION;
use trocar_nets::checkpoint::{
    self, AggregationName, PolicyPreset, Precision, RECIPE_FORMAT, Recipe, RecommendedAggregation,
    RecordedCamera, Variants,
};
use trocar_train::{AnyTrained, TrainOptions};

use super::options::TrainingOptions;
use super::stopwatch::Stopwatch;
use super::{backbone, data};
use crate::session::SessionError;
use crate::session::source::STEP_NS;

/// What is particular about the network that is trained.
pub(super) struct Made {
    /// The named size that the network was built from.
    pub(super) preset: PolicyPreset,
    pub(super) variants: Variants,
    /// Steps of the dataset, not of the run.
    pub(super) query_every_steps: u32,
}

/// Everything about a training that its checkpoints say, but the weights.
pub(super) struct Saver<'a> {
    pub(super) options: &'a TrainingOptions,
    pub(super) train_options: TrainOptions,
    pub(super) dataset: &'a Dataset,
    /// Also counts what a training took before it was stopped and resumed.
    pub(super) stopwatch: Stopwatch,
    pub(super) made: Made,
    /// What clouds are made of, of a network that sees them.
    pub(super) cloud: Option<CloudRecipe>,
}

impl Saver<'_> {
    /// An error here is one of this program: options of such a network always have a recipe.
    fn cloud(&self) -> Result<&CloudRecipe, SessionError> {
        let defect = "a network that sees clouds was trained without a recipe of them";
        let cloud = self.cloud.as_ref();
        cloud.ok_or_else(|| SessionError::BadArgument(defect.to_owned()))
    }

    /// Writes `trained` into `folder`, which is made if it is not there.
    pub(super) fn save(&self, folder: &Path, trained: &AnyTrained) -> Result<(), SessionError> {
        let recipe = recipe(self, trained);
        match trained {
            AnyTrained::Act(trained) => checkpoint::save(
                folder,
                &trained.network,
                &trained.statistics,
                &recipe,
                backbone::kept(self.options.backbone),
            )?,
            AnyTrained::ActPc(trained) => checkpoint::save_act_pc(
                folder,
                &trained.network,
                self.cloud()?,
                &trained.statistics,
                &recipe,
                Precision::F16,
            )?,
            AnyTrained::Dp3(trained) => checkpoint::save_dp3(
                folder,
                &trained.network,
                self.cloud()?,
                &trained.statistics,
                &recipe,
                Precision::F16,
            )?,
        }
        Ok(())
    }
}

/// Aggregation is always `newest`: others are the user's choice at run time.
fn recipe(saver: &Saver<'_>, trained: &AnyTrained) -> Recipe {
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
        dataset: data::summary(dataset),
        seed: options.seed,
        training: serde_json::json!({
            "options": train_options,
            "frames": trained.frames(),
            "seconds": saver.stopwatch.seconds(),
            "final": trained.curve().last().map(|row| serde_json::json!({"loss": row.loss, "l1": row.l1, "kl": row.kl})),
        }),
    }
}

/// So many of the dataset's steps, of `step_ns` each, in the policy steps that a run asks its
/// policy by: no more than they last, and no more of them.
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
