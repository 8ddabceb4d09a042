//! ACT: action chunking with transformers (Zhao et al. 2023), with LeRobot's parameter names.
//!
//! Inputs and outputs are normalised; nothing in here knows units. Tokens of the encoder: the latent, the state, then
//! the image tokens, camera after camera, row by row.
//!
//! Source: reference note on policies, sections 2 and 3; checked against golden numbers in `tests/golden.rs`.

mod config;
mod layers;
mod loss;
mod position;
mod resnet;
mod transformer;
mod vae;

use tch::{Kind, TchError, Tensor};

pub use config::{ActConfig, ActPreset, BackboneNorm, DecoderOutput, LossDenominator, STATE_DIM};
pub use loss::{Losses, l1_loss, losses};
pub use vae::LatentDistribution;
pub(crate) use vae::VAE_PREFIX;

use crate::parameters::{Init, ParameterError, ParameterSource, Parameters};
use layers::Linear;
use resnet::{FEATURE_CHANNELS, ResNet18};
use transformer::{Decoder, Encoder, Memory};
use vae::VaeEncoder;

/// An ACT network.
#[derive(Debug)]
pub struct Act {
    config: ActConfig,
    backbone: ResNet18,
    encoder: Encoder,
    decoder: Decoder,
    state_input: Linear,
    latent_input: Linear,
    image_weight: Tensor,
    image_bias: Tensor,
    token_position: Tensor,
    image_position: Tensor,
    step_queries: Tensor,
    action_head: Linear,
    vae: Option<VaeEncoder>,
    parameters: Parameters,
}

/// A demonstrated chunk, normalised, as training shows it to the network.
#[derive(Clone, Copy, Debug)]
pub struct Demonstration<'a> {
    /// `(batch, steps, action)`.
    pub actions: &'a Tensor,
    /// `(batch, steps)`, true where the episode had ended.
    pub is_pad: &'a Tensor,
    /// Standard normal numbers `(batch, latent)` that pick the latent.
    pub noise: &'a Tensor,
}

impl Act {
    /// Builds the network of `config` from `source`.
    ///
    /// The variational encoder is left out if the source has nothing of it; the network can then infer but not train.
    ///
    /// # Errors
    /// [`ParameterError`] if a tensor is missing, left over or of another shape.
    pub fn new(config: ActConfig, mut source: ParameterSource) -> Result<Self, ParameterError> {
        let width = config.dim_model;
        let s = &mut source;
        let backbone = ResNet18::new(s, "model.backbone", config.backbone_norm)?;
        let encoder = Encoder::new(s, "model.encoder", config.n_encoder_layers, &config)?;
        let decoder = Decoder::new(s, "model.decoder", &config)?;
        let image_key = "model.encoder_img_feat_input_proj";
        let image_init = Init::fan_in(FEATURE_CHANNELS);
        let image_weight = s.trainable(
            &format!("{image_key}.weight"),
            &[width, FEATURE_CHANNELS, 1, 1],
            &image_init,
        )?;
        let image_bias = s.trainable(&format!("{image_key}.bias"), &[width], &image_init)?;
        let normal = Init::Normal(1.0);
        let token_position = s.trainable(
            "model.encoder_1d_feature_pos_embed.weight",
            &[2, width],
            &normal,
        )?;
        let step_queries = s.trainable(
            "model.decoder_pos_embed.weight",
            &[config.chunk_size, width],
            &normal,
        )?;
        let state_input = Linear::new(
            s,
            "model.encoder_robot_state_input_proj",
            config.state_dim,
            width,
        )?;
        let latent_input = Linear::new(
            s,
            "model.encoder_latent_input_proj",
            config.latent_dim,
            width,
        )?;
        let action_head = Linear::new(s, "model.action_head", width, config.action_dim)?;
        let vae = if config.use_vae && s.offers(VAE_PREFIX) {
            Some(VaeEncoder::new(s, &config)?)
        } else {
            None
        };
        let image_position = image_position(&config)?
            .f_to_device(image_weight.device())?
            .f_to_kind(image_weight.kind())?;
        Ok(Self {
            backbone,
            encoder,
            decoder,
            state_input,
            latent_input,
            image_weight,
            image_bias,
            token_position,
            image_position,
            step_queries,
            action_head,
            vae,
            parameters: source.finish()?,
            config,
        })
    }

    /// What the network was built from.
    #[must_use]
    pub const fn config(&self) -> &ActConfig {
        &self.config
    }

    /// Its tensors by key.
    #[must_use]
    pub const fn parameters(&self) -> &Parameters {
        &self.parameters
    }

    /// The chunk for an observation, latent zero, no dropout: `(batch, steps, action)`, normalised.
    ///
    /// `images` is `(batch, cameras, 3, height, width)`, `state` `(batch, state)`.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn infer(&self, images: &Tensor, state: &Tensor) -> Result<Tensor, TchError> {
        let kind = self.image_weight.kind();
        let latent = Tensor::f_zeros(
            [state.size()[0], self.config.latent_dim],
            (kind, state.device()),
        )?;
        self.decode(images, state, &latent, 0.0)
    }

    /// The chunk that training compares with the demonstration, and the latent's distribution.
    ///
    /// Without a variational encoder the latent is zero.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn train(
        &self,
        images: &Tensor,
        state: &Tensor,
        demonstration: &Demonstration<'_>,
    ) -> Result<(Tensor, Option<LatentDistribution>), TchError> {
        let dropout = self.config.dropout;
        let kind = self.image_weight.kind();
        let Some(vae) = &self.vae else {
            let latent = demonstration.noise.f_zeros_like()?.f_to_kind(kind)?;
            return Ok((self.decode(images, state, &latent, dropout)?, None));
        };
        let Demonstration {
            actions,
            is_pad,
            noise,
        } = demonstration;
        let latent = vae.forward(
            &state.f_to_kind(kind)?,
            &actions.f_to_kind(kind)?,
            is_pad,
            dropout,
        )?;
        let sample = latent.sample(&noise.f_to_kind(kind)?)?;
        Ok((self.decode(images, state, &sample, dropout)?, Some(latent)))
    }

    fn decode(
        &self,
        images: &Tensor,
        state: &Tensor,
        latent: &Tensor,
        dropout: f64,
    ) -> Result<Tensor, TchError> {
        let kind = self.image_weight.kind();
        let latent = self.latent_input.forward(latent)?.f_unsqueeze(1)?;
        let state = self
            .state_input
            .forward(&state.f_to_kind(kind)?)?
            .f_unsqueeze(1)?;
        let tokens = Tensor::f_cat(
            &[latent, state, self.image_tokens(&images.f_to_kind(kind)?)?],
            1,
        )?;
        let position =
            Tensor::f_cat(&[&self.token_position, &self.image_position], 0)?.f_unsqueeze(0)?;
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

    /// `(batch, cameras, 3, height, width)` to `(batch, cameras * rows * columns, width)`.
    fn image_tokens(&self, images: &Tensor) -> Result<Tensor, TchError> {
        let batch = images.size()[0];
        let features = self.backbone.forward(&images.f_flatten(0, 1)?)?;
        let tokens = features.f_conv2d(
            &self.image_weight,
            Some(&self.image_bias),
            [1, 1],
            [0, 0],
            [1, 1],
            1,
        )?;
        let rows = tokens.f_flatten(2, 3)?.f_transpose(1, 2)?;
        rows.f_reshape([batch, -1, self.config.dim_model])
    }
}

/// Positions of all image tokens, every camera the same: `(cameras * rows * columns, width)`.
fn image_position(config: &ActConfig) -> Result<Tensor, TchError> {
    let high = ResNet18::feature_side(config.image_height);
    let wide = ResNet18::feature_side(config.image_width);
    let table = position::plane_table(high, wide, config.dim_model);
    let cameras = i64::try_from(config.cameras.len()).unwrap_or(i64::MAX);
    Tensor::f_from_slice(&table)?
        .f_view([high * wide, config.dim_model])?
        .f_repeat([cameras, 1])
}
