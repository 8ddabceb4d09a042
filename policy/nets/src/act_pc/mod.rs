//! ACT-PC: ACT that sees a point cloud instead of images, with PointCloudMatters' tokens (Zhu et
//! al. 2024).
//!
//! The transformer, its latent and its loss are ACT's, with LeRobot's parameter names; the tokens'
//! parameters have PointCloudMatters' names below `model`. States and actions are normalised,
//! points are in metres. Tokens of the encoder: the latent, the state, then the points' in the
//! order of their sampling.
//!
//! Source: reference note on policies, section 4.

mod clouds;
mod config;
mod folded;
mod point_net;
#[cfg(test)]
mod tests;
mod tokens;

use tch::{TchError, Tensor};

pub use clouds::{Clouds, CloudsError};
pub use config::{ActPcConfig, ActPcPreset};
pub use folded::FoldedActPc;

use crate::act::{
    Demonstration, EncoderInput, LatentDistribution, Trunk, action_loss, kl_divergence,
};
use crate::parameters::{ParameterError, ParameterSource, Parameters};
use tokens::PointTokens;

/// An ACT-PC network.
///
/// Its batch normalisations hold running statistics, which [`Self::train`] moves in place.
#[derive(Debug)]
pub struct ActPc {
    config: ActPcConfig,
    tokens: PointTokens,
    trunk: Trunk,
    parameters: Parameters,
}

/// The parts of the loss, each a tensor of no dimension.
#[derive(Debug)]
pub struct PointLosses {
    /// Mean error of the normalised actions, as the configuration counts it.
    pub action: Tensor,
    /// Kullback-Leibler divergence of the latent from the standard normal; zero without a
    /// variational encoder.
    pub kl: Tensor,
    /// `action + kl_weight * kl`: what is minimised.
    pub total: Tensor,
}

impl ActPc {
    /// Builds the network of `config`, which has no [`ActPcConfig::defect`], from `source`.
    ///
    /// The variational encoder is left out if the source has nothing of it; the network can then
    /// infer but not train.
    ///
    /// # Errors
    /// [`ParameterError`] if a tensor is missing, left over or of another shape.
    pub fn new(config: ActPcConfig, mut source: ParameterSource) -> Result<Self, ParameterError> {
        Ok(Self {
            tokens: PointTokens::new(&mut source, &config)?,
            trunk: Trunk::new(&mut source, &config.act)?,
            parameters: source.finish()?,
            config,
        })
    }

    /// What the network was built from.
    #[must_use]
    pub const fn config(&self) -> &ActPcConfig {
        &self.config
    }

    /// Its tensors by key.
    #[must_use]
    pub const fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// Tokens of the points and where they are, `(batch, tokens, width)` each.
    ///
    /// In training, the statistics of the normalisations move.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn point_tokens(
        &self,
        clouds: &Clouds,
        training: bool,
    ) -> Result<(Tensor, Tensor), TchError> {
        self.tokens.forward(clouds, training)
    }

    /// The chunk for an observation, latent zero, no dropout: `(batch, steps, action)`, normalised.
    ///
    /// `state` is `(batch, state)`.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn infer(&self, clouds: &Clouds, state: &Tensor) -> Result<Tensor, TchError> {
        let (tokens, position) = self.point_tokens(clouds, false)?;
        let (tokens, position) = (&tokens, &position);
        self.trunk.infer(&EncoderInput { tokens, position }, state)
    }

    /// The chunk that training compares with the demonstration, and the latent's distribution.
    ///
    /// Without a variational encoder the latent is zero.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn train(
        &self,
        clouds: &Clouds,
        state: &Tensor,
        demonstration: &Demonstration<'_>,
    ) -> Result<(Tensor, Option<LatentDistribution>), TchError> {
        let (tokens, position) = self.point_tokens(clouds, true)?;
        let (tokens, position) = (&tokens, &position);
        self.trunk
            .train(&EncoderInput { tokens, position }, state, demonstration)
    }

    /// The loss of `predicted` against `actions`, both `(batch, steps, action)`; `is_pad` is
    /// `(batch, steps)`.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn losses(
        &self,
        predicted: &Tensor,
        latent: Option<&LatentDistribution>,
        actions: &Tensor,
        is_pad: &Tensor,
    ) -> Result<PointLosses, TchError> {
        let (error, denominator) = (self.config.action_error, self.config.act.loss_denominator);
        let action = action_loss(error, denominator, predicted, actions, is_pad)?;
        let kl = match latent {
            Some(latent) => kl_divergence(latent)?,
            None => action.f_zeros_like()?,
        };
        let total = action.f_add(&kl.f_mul_scalar(self.config.act.kl_weight)?)?;
        Ok(PointLosses { action, kl, total })
    }
}
