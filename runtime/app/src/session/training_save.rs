//! How a trained network becomes a checkpoint.

use std::path::Path;

use trocar_data::dataset::Dataset;
use trocar_data::perception::CloudRecipe;
use trocar_nets::checkpoint::{self, Precision};
use trocar_train::{AnyTrained, TrainOptions};

use super::training::TrainingOptions;
use super::training_recipe::{Made, recipe};
use super::training_watch::Stopwatch;
use super::{SessionError, training_backbone};

/// Everything about a training that its checkpoints say, but the weights.
pub(super) struct Saver<'a> {
    pub(super) options: &'a TrainingOptions,
    pub(super) train_options: TrainOptions,
    pub(super) dataset: &'a Dataset,
    pub(super) stopwatch: Stopwatch,
    pub(super) made: Made,
    /// What clouds are made of, of a network that sees them.
    pub(super) cloud: Option<CloudRecipe>,
}

impl Saver<'_> {
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
                training_backbone::kept(self.options.backbone),
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
