//! What every ACT network has, whatever it sees: latent, state, transformer, action head.
//!
//! Shared by ACT and ACT-PC, which differ in how a view becomes tokens. Encoder tokens: latent,
//! state, then what is seen; the decoder's steps attend to the encoder's output, and each becomes
//! an action.

use tch::{Kind, TchError, Tensor};

use super::Demonstration;
use super::config::ActConfig;
use super::transformer::{Decoder, Encoder, Memory};
use super::vae::{LatentDistribution, VAE_PREFIX, VaeEncoder};
use crate::layers::Linear;
use crate::parameters::{Init, ParameterError, ParameterSource};

/// Everything of an ACT network but what turns a view into tokens.
#[derive(Debug)]
pub(crate) struct Trunk {
    pub(super) encoder: Encoder,
    pub(super) decoder: Decoder,
    /// `(batch, state)` to a token.
    pub(super) state_input: Linear,
    /// `(batch, latent)` to a token.
    pub(super) latent_input: Linear,
    /// `(2, width)`, learned: of the latent's token, then of the state's.
    pub(super) token_position: Tensor,
    /// `(steps, width)`, learned: what tells the chunk's steps apart.
    pub(super) step_queries: Tensor,
    /// A step of the decoder to an action.
    pub(super) action_head: Linear,
    /// None if the configuration has no latent, or the parameters have no variational encoder.
    vae: Option<VaeEncoder>,
    latent_dim: i64,
    dropout: f64,
}

/// The encoder's input tokens.
pub(crate) struct EncoderInput<'a> {
    /// `(batch, tokens, width)`.
    pub(crate) tokens: &'a Tensor,
    /// `(batch or 1, tokens, width)`.
    pub(crate) position: &'a Tensor,
}

impl Trunk {
    /// Without the variational encoder if `source` has nothing of it.
    pub(crate) fn new(
        source: &mut ParameterSource,
        config: &ActConfig,
    ) -> Result<Self, ParameterError> {
        let width = config.dim_model;
        let normal = Init::Normal(1.0);
        let input = |source: &mut ParameterSource, name: &str, inputs| {
            Linear::new(
                source,
                &format!("model.encoder_{name}_input_proj"),
                inputs,
                width,
            )
        };
        Ok(Self {
            encoder: Encoder::new(source, "model.encoder", config.n_encoder_layers, config)?,
            decoder: Decoder::new(source, "model.decoder", config)?,
            state_input: input(source, "robot_state", config.state_dim)?,
            latent_input: input(source, "latent", config.latent_dim)?,
            token_position: source.trainable(
                "model.encoder_1d_feature_pos_embed.weight",
                &[2, width],
                &normal,
            )?,
            step_queries: source.trainable(
                "model.decoder_pos_embed.weight",
                &[config.chunk_size, width],
                &normal,
            )?,
            action_head: Linear::new(source, "model.action_head", width, config.action_dim)?,
            vae: if config.use_vae && source.offers(VAE_PREFIX) {
                Some(VaeEncoder::new(source, config)?)
            } else {
                None
            },
            latent_dim: config.latent_dim,
            dropout: config.dropout,
        })
    }

    /// The chunk for latent zero, no dropout.
    pub(crate) fn infer(
        &self,
        seen: &EncoderInput<'_>,
        state: &Tensor,
    ) -> Result<Tensor, TchError> {
        let shape = [state.size()[0], self.latent_dim];
        let latent = Tensor::f_zeros(shape, (seen.tokens.kind(), state.device()))?;
        self.decode(seen, state, &latent, 0.0)
    }

    /// The chunk for the latent that the demonstration and its noise pick; zero without a
    /// variational encoder.
    pub(crate) fn train(
        &self,
        seen: &EncoderInput<'_>,
        state: &Tensor,
        demonstration: &Demonstration<'_>,
    ) -> Result<(Tensor, Option<LatentDistribution>), TchError> {
        let kind = seen.tokens.kind();
        let Some(vae) = &self.vae else {
            let latent = demonstration.noise.f_zeros_like()?.f_to_kind(kind)?;
            return Ok((self.decode(seen, state, &latent, self.dropout)?, None));
        };
        let (state_in_kind, actions) = (
            state.f_to_kind(kind)?,
            demonstration.actions.f_to_kind(kind)?,
        );
        let is_pad = demonstration.is_pad;
        let latent = vae.forward(&state_in_kind, &actions, is_pad, self.dropout)?;
        let sample = latent.sample(&demonstration.noise.f_to_kind(kind)?)?;
        let chunk = self.decode(seen, state, &sample, self.dropout)?;
        Ok((chunk, Some(latent)))
    }

    /// Position embeddings of latent, state and what is seen: `(views, tokens, width)`.
    fn positions(&self, seen: &EncoderInput<'_>) -> Result<Tensor, TchError> {
        let views = seen.position.size()[0];
        let leading = self
            .token_position
            .f_unsqueeze(0)?
            .f_expand([views, -1, -1], false)?;
        Tensor::f_cat(&[&leading, seen.position], 1)
    }

    /// From tokens, state and latent to the chunk, `(batch, steps, action)` in single precision.
    fn decode(
        &self,
        seen: &EncoderInput<'_>,
        state: &Tensor,
        latent: &Tensor,
        dropout: f64,
    ) -> Result<Tensor, TchError> {
        let kind = seen.tokens.kind();
        let latent = self.latent_input.forward(latent)?.f_unsqueeze(1)?;
        let state = self
            .state_input
            .forward(&state.f_to_kind(kind)?)?
            .f_unsqueeze(1)?;
        let tokens = Tensor::f_cat(&[&latent, &state, seen.tokens], 1)?;
        let position = self.positions(seen)?;
        let encoded = self.encoder.forward(&tokens, &position, None, dropout)?;
        let memory = Memory {
            tokens: &encoded,
            position: &position,
        };
        let decoded = self
            .decoder
            .forward(&self.step_queries.f_unsqueeze(0)?, &memory, dropout)?;
        self.action_head.forward(&decoded)?.f_to_kind(Kind::Float)
    }
}
