//! The loss of ACT: absolute errors of the actions, and the price of telling the style.
//!
//! A conditional variational autoencoder's bound with an L1 reconstruction:
//! `L = |a - a'| + beta * KL(q(z | a, s) || N(0, I))` (Zhao et al. 2023, whose algorithm 1 writes a
//! squared error where text and code take L1). `beta` is `kl_weight`, 10 as published.

use serde::{Deserialize, Serialize};
use tch::{Kind, TchError, Tensor};

use super::config::{ActConfig, LossDenominator};
use super::vae::LatentDistribution;
use crate::dimension::width;

/// The parts of the loss, each a tensor of no dimension. They are on the network's device: reading
/// one waits for it.
#[derive(Debug)]
pub struct Losses {
    /// Mean absolute error of the normalised actions.
    pub l1: Tensor,
    /// Kullback-Leibler divergence of the latent from the standard normal, summed over it, mean
    /// over the batch; zero without a variational encoder.
    pub kl: Tensor,
    /// `l1 + kl_weight * kl`: what is minimised.
    pub total: Tensor,
}

/// The loss of `predicted` against `actions`, both `(batch, steps, action)`, normalised; `is_pad`
/// is `(batch, steps)`.
///
/// Errors of padded steps count as zero; see [`LossDenominator`] for what divides the sum.
///
/// # Errors
/// The network library's, if shapes do not fit.
pub fn losses(
    config: &ActConfig,
    predicted: &Tensor,
    latent: Option<&LatentDistribution>,
    actions: &Tensor,
    is_pad: &Tensor,
) -> Result<Losses, TchError> {
    let l1 = l1_loss(config.loss_denominator, predicted, actions, is_pad)?;
    let kl = match latent {
        Some(latent) => kl_divergence(latent)?,
        None => l1.f_zeros_like()?,
    };
    let total = l1.f_add(&kl.f_mul_scalar(config.kl_weight)?)?;
    Ok(Losses { l1, kl, total })
}

/// What is counted of an action's error.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActionError {
    /// Its size: ACT.
    #[default]
    Absolute,
    /// Its square: PointCloudMatters.
    Squared,
}

/// Mean absolute error over steps that are not padded, by the named denominator.
///
/// # Errors
/// The network library's, if shapes do not fit.
pub fn l1_loss(
    denominator: LossDenominator,
    predicted: &Tensor,
    actions: &Tensor,
    is_pad: &Tensor,
) -> Result<Tensor, TchError> {
    action_loss(
        ActionError::Absolute,
        denominator,
        predicted,
        actions,
        is_pad,
    )
}

/// Mean of `error` over steps that are not padded, by the named denominator. Single precision
/// whatever the inputs have. A batch of nothing but padding gives 0.
///
/// # Errors
/// The network library's, if shapes do not fit.
pub fn action_loss(
    error: ActionError,
    denominator: LossDenominator,
    predicted: &Tensor,
    actions: &Tensor,
    is_pad: &Tensor,
) -> Result<Tensor, TchError> {
    let kept = is_pad.f_logical_not()?.f_unsqueeze(-1)?;
    let apart = predicted.f_sub(actions)?;
    let errors = match error {
        ActionError::Absolute => apart.f_abs()?,
        ActionError::Squared => apart.f_square()?,
    };
    let errors = errors.f_mul(&kept)?;
    match denominator {
        LossDenominator::All => errors.f_mean(Kind::Float),
        LossDenominator::Valid => {
            let width = width(actions);
            let elements = kept
                .f_sum(Kind::Float)?
                .f_mul_scalar(width)?
                .f_clamp_min(1.0)?;
            errors.f_sum(Kind::Float)?.f_div(&elements)
        }
    }
}

/// `-1/2 sum(1 + log s^2 - m^2 - s^2)` over the latent, mean over the batch, in single precision
/// (Kingma and Welling 2014, appendix B).
pub(crate) fn kl_divergence(latent: &LatentDistribution) -> Result<Tensor, TchError> {
    let log_variance = latent.log_variance.f_to_kind(Kind::Float)?;
    let mean = latent.mean.f_to_kind(Kind::Float)?;
    let inner = log_variance
        .f_add_scalar(1.0)?
        .f_sub(&mean.f_square()?)?
        .f_sub(&log_variance.f_exp()?)?;
    inner
        .f_mul_scalar(-0.5)?
        .f_sum_dim_intlist([-1].as_slice(), false, Kind::Float)?
        .f_mean(Kind::Float)
}

#[cfg(test)]
mod tests {
    use super::{LossDenominator, l1_loss};
    use tch::Tensor;

    #[test]
    fn padded_steps_count_only_in_the_denominator_of_all() {
        let predicted = Tensor::from_slice(&[1.0_f32, 1.0, 9.0, 9.0]).view([1, 4, 1]);
        let actions = Tensor::from_slice(&[0.0_f32, 3.0, 0.0, 0.0]).view([1, 4, 1]);
        let is_pad = Tensor::from_slice(&[false, false, true, true]).view([1, 4]);
        let loss = |kind| {
            l1_loss(kind, &predicted, &actions, &is_pad)
                .unwrap()
                .double_value(&[])
        };
        assert!((loss(LossDenominator::All) - 0.75).abs() < 1e-7);
        assert!((loss(LossDenominator::Valid) - 1.5).abs() < 1e-7);
    }
}
