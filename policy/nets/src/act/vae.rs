//! The variational encoder: in training it reads the demonstrated chunk and says which style it
//! has.
//!
//! `q(z | a, s)` of the paper: a BERT-like encoder over a class token, the state and the
//! demonstrated actions, of which the class token's output gives mean and log-variance. Images are
//! left out, as published, for faster training.

use tch::{Kind, TchError, Tensor};

use super::config::ActConfig;
use super::position::sequence_table;
use super::transformer::Encoder;
use crate::layers::Linear;
use crate::parameters::{Init, ParameterError, ParameterSource};

/// Keys of the variational encoder start with this; inference does without them.
pub(crate) const VAE_PREFIX: &str = "model.vae_encoder";

/// Mean and logarithm of the variance of the latent, `(batch, latent)` each.
#[derive(Debug)]
pub struct LatentDistribution {
    /// Mean.
    pub mean: Tensor,
    /// Logarithm of the variance, since a linear layer's output has any sign.
    pub log_variance: Tensor,
}

/// The encoder with its inputs and its output; `(batch, 2 + steps, width)` inside.
#[derive(Debug)]
pub(super) struct VaeEncoder {
    encoder: Encoder,
    /// `(1, 2 + steps, width)`, a fixed sine table stored in the checkpoint.
    position: Tensor,
    /// `(1, width)`, learned.
    class_token: Tensor,
    state: Linear,
    action: Linear,
    /// To twice the latent: means, then log-variances.
    output: Linear,
}

impl VaeEncoder {
    pub(super) fn new(
        source: &mut ParameterSource,
        config: &ActConfig,
    ) -> Result<Self, ParameterError> {
        let width = config.dim_model;
        let tokens = config.chunk_size + 2;
        let table = Init::Table(sequence_table(tokens, width));
        let key = |name: &str| format!("{VAE_PREFIX}_{name}");
        let position = source.fixed(&key("pos_enc"), &[1, tokens, width], &table)?;
        let class_token =
            source.trainable(&key("cls_embed.weight"), &[1, width], &Init::Normal(1.0))?;
        let encoder = Encoder::new(source, VAE_PREFIX, config.n_vae_encoder_layers, config)?;
        let mut linear =
            |name: &str, inputs, outputs| Linear::new(source, &key(name), inputs, outputs);
        Ok(Self {
            encoder,
            position: position.f_to_kind(class_token.kind())?,
            class_token,
            state: linear("robot_state_input_proj", config.state_dim, width)?,
            action: linear("action_input_proj", config.action_dim, width)?,
            output: linear("latent_output_proj", width, 2 * config.latent_dim)?,
        })
    }

    /// `state` is `(batch, state)`, `actions` `(batch, steps, action)`, `is_pad` `(batch, steps)`,
    /// true where padded. Padded steps are masked as keys; class token and state never are.
    pub(super) fn forward(
        &self,
        state: &Tensor,
        actions: &Tensor,
        is_pad: &Tensor,
        dropout: f64,
    ) -> Result<LatentDistribution, TchError> {
        let batch = state.size()[0];
        let class_token = self.class_token.f_expand([batch, 1, -1], false)?;
        let state = self.state.forward(&state.f_unsqueeze(1)?)?;
        let tokens = Tensor::f_cat(&[class_token, state, self.action.forward(actions)?], 1)?;
        let always = Tensor::f_ones([batch, 2], (Kind::Bool, is_pad.device()))?;
        let allowed =
            Tensor::f_cat(&[always, is_pad.f_logical_not()?], 1)?.f_view([batch, 1, 1, -1])?;
        let (encoder, position) = (&self.encoder, &self.position);
        let encoded = encoder.forward(&tokens, position, Some(&allowed), dropout)?;
        let parts = self
            .output
            .forward(&encoded.f_select(1, 0)?)?
            .f_chunk(2, -1)?;
        Ok(LatentDistribution {
            mean: parts[0].shallow_clone(),
            log_variance: parts[1].shallow_clone(),
        })
    }
}

impl LatentDistribution {
    /// The latent that standard normal `noise` `(batch, latent)` picks.
    ///
    /// `z = m + exp(log s^2 / 2) * noise`, through which gradients pass (the reparameterisation of
    /// Kingma and Welling 2014).
    pub(super) fn sample(&self, noise: &Tensor) -> Result<Tensor, TchError> {
        let deviation = self.log_variance.f_div_scalar(2.0)?.f_exp()?;
        self.mean.f_add(&deviation.f_mul(noise)?)
    }
}
