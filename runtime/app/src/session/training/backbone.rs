//! The backbone of an ACT network that is to be trained.

use trocar_nets::act::BackboneNorm;
use trocar_nets::checkpoint::{BackboneWeights, Precision, SaveOptions};
use trocar_train::Trainer;

use super::options::{NetworkChoice, TrainingOptions};
use crate::session::SessionError;

/// Refuses choices that do not go together, before anything is read.
pub(super) fn check(options: &TrainingOptions) -> Result<(), SessionError> {
    let weights = options.backbone_weights.is_some();
    let defect = match (options.network, options.backbone, weights) {
        (NetworkChoice::ActPc | NetworkChoice::Dp3, BackboneNorm::FrozenBatchNorm, _)
        | (NetworkChoice::ActPc | NetworkChoice::Dp3, _, true) => {
            "--backbone: act-pc and dp3 have none; of act"
        }
        (NetworkChoice::Act, BackboneNorm::GroupNorm, true) => {
            "--backbone-weights: of --backbone frozen_batch_norm; group normalisation learns from scratch"
        }
        (NetworkChoice::Act, BackboneNorm::FrozenBatchNorm, _)
        | (_, BackboneNorm::GroupNorm, false) => return Ok(()),
    };
    Err(SessionError::BadArgument(defect.to_owned()))
}

/// A trainer with the weights that are wanted.
pub(super) fn trainer(options: &TrainingOptions) -> Result<Trainer, SessionError> {
    let trainer = Trainer::new(options.device);
    match &options.backbone_weights {
        Some(path) => Ok(trainer.starting_from(BackboneWeights::load(path)?)),
        None => Ok(trainer),
    }
}

/// How a policy is kept. One that LeRobot loads is whole, with what only training needs, and in
/// single precision: half precision has no room for every variance.
pub(super) const fn kept(backbone: BackboneNorm) -> SaveOptions {
    match backbone {
        BackboneNorm::FrozenBatchNorm => SaveOptions {
            precision: Precision::F32,
            inference_only: false,
        },
        BackboneNorm::GroupNorm => SaveOptions {
            precision: Precision::F16,
            inference_only: true,
        },
    }
}
