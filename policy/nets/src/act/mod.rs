//! ACT: action chunking with transformers (Zhao et al. 2023), with LeRobot's parameter names.
//!
//! Inputs and outputs are normalised; nothing in here knows units. Tokens of the encoder: the
//! latent, the state, then the image tokens, camera after camera, row by row.
//!
//! Source: reference note on policies, sections 2 and 3; checked against golden numbers in
//! `tests/golden/`.
//!
//! At inference the chunk is a function of images and state: the latent is the mean of its prior,
//! zero, and nothing is random. [`FoldedAct`] is the same function made for speed;
//! [`crate::act_policy`] puts units, cameras and chunks around it.

mod config;
mod folded;
mod loss;
mod position;
mod resnet;
mod transformer;
mod trunk;
mod vae;

use std::collections::BTreeMap;

use tch::{TchError, Tensor};

pub(crate) use config::STAGES;
pub use config::{ActConfig, ActPreset, BackboneNorm, DecoderOutput, LossDenominator, STATE_DIM};
pub use folded::FoldedAct;
pub(crate) use folded::{FoldedEncoderInput, FoldedTrunk};
pub use loss::{ActionError, Losses, action_loss, l1_loss, losses};
pub use resnet::by_hand::SavedActivations;
pub(crate) use trunk::{EncoderInput, Trunk};
pub use vae::LatentDistribution;
pub(crate) use {loss::kl_divergence, vae::VAE_PREFIX};

use crate::dimension::dimension;
use crate::kernels::Kernels;
use crate::parameters::{Init, ParameterError, ParameterSource, Parameters};
use resnet::ResNet18;

/// The key of the backbone, without the dot.
const BACKBONE: &str = "model.backbone";

/// What the keys of a backbone's tensors begin with.
pub const BACKBONE_PREFIX: &str = "model.backbone.";

/// Refuses tensors that are not exactly those of a backbone with frozen batch normalisation.
pub(crate) fn check_frozen_backbone(
    tensors: &BTreeMap<String, Tensor>,
) -> Result<(), ParameterError> {
    let shared = tensors.iter();
    let shared = shared.map(|(key, tensor)| (key.clone(), tensor.shallow_clone()));
    let mut source = ParameterSource::given(shared.collect());
    ResNet18::new(&mut source, BACKBONE, BackboneNorm::FrozenBatchNorm, STAGES)?;
    source.finish().map(|_| ())
}

/// An ACT network.
#[derive(Debug)]
pub struct Act {
    config: ActConfig,
    /// Shared by all cameras.
    backbone: ResNet18,
    /// `(width, channels, 1, 1)`: features to tokens.
    image_weight: Tensor,
    /// `(width)`.
    image_bias: Tensor,
    /// `(1, tokens, width)`, fixed sines.
    image_position: Tensor,
    /// Everything behind the tokens.
    trunk: Trunk,
    /// The same tensors by key; they share their memory.
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
    /// The variational encoder is left out if the source has nothing of it; the network can then
    /// infer but not train.
    ///
    /// # Errors
    /// [`ParameterError`] if a tensor is missing, left over or of another shape.
    pub fn new(config: ActConfig, mut source: ParameterSource) -> Result<Self, ParameterError> {
        let width = config.dim_model;
        let s = &mut source;
        let backbone = ResNet18::new(s, BACKBONE, config.backbone_norm, config.backbone_stages)?;
        let channels = ResNet18::feature_channels(config.backbone_stages);
        let image_key = "model.encoder_img_feat_input_proj";
        let image_init = Init::fan_in(channels);
        let image_weight = s.trainable(
            &format!("{image_key}.weight"),
            &[width, channels, 1, 1],
            &image_init,
        )?;
        let image_bias = s.trainable(&format!("{image_key}.bias"), &[width], &image_init)?;
        let trunk = Trunk::new(s, &config)?;
        let image_position = image_position(&config)?
            .f_to_device(image_weight.device())?
            .f_to_kind(image_weight.kind())?
            .f_unsqueeze(0)?;
        Ok(Self {
            backbone,
            image_weight,
            image_bias,
            image_position,
            trunk,
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
        let tokens = self.image_tokens(images)?;
        self.trunk.infer(&self.seen(&tokens), state)
    }

    /// What frozen batch normalisation takes as its statistics in a training from scratch: mean and
    /// variance of each normalisation of the backbone for `images` `(n, cameras, 3, height,
    /// width)`, normalised, on the network's device; by the network's keys.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn backbone_statistics(
        &self,
        images: &Tensor,
    ) -> Result<BTreeMap<String, Tensor>, TchError> {
        let images = images.f_flatten(0, 1)?;
        tch::no_grad(|| self.backbone.statistics(BACKBONE, &images))
    }

    /// The chunk that training compares with the demonstration, and the latent's distribution.
    ///
    /// Without a variational encoder the latent is zero. Dropout draws from the network library's
    /// generator, which the caller seeds.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn train(
        &self,
        images: &Tensor,
        state: &Tensor,
        demonstration: &Demonstration<'_>,
    ) -> Result<(Tensor, Option<LatentDistribution>), TchError> {
        let tokens = self.image_tokens(images)?;
        self.trunk.train(&self.seen(&tokens), state, demonstration)
    }

    /// What the backbone makes of `images` for [`Self::train_on`], outside of the library's own
    /// bookkeeping, and what [`Self::features_back_by_hand`] needs of it.
    ///
    /// For CUDA in bfloat16, where the library's backward pass spends half its time on layouts; see
    /// [`crate::kernels`].
    ///
    /// # Errors
    /// The network library's, if shapes do not fit or the parameters have not 16 bits.
    pub fn features_by_hand(
        &self,
        kernels: &Kernels,
        images: &Tensor,
    ) -> Result<(Tensor, SavedActivations), TchError> {
        tch::no_grad(|| {
            let images = images
                .f_to_kind(self.image_weight.kind())?
                .f_flatten(0, 1)?;
            self.backbone.forward_by_hand(kernels, &images)
        })
    }

    /// The backbone's parameters with their gradients, given that of its features.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn features_back_by_hand(
        &self,
        kernels: &Kernels,
        gradient: &Tensor,
        kept: &SavedActivations,
    ) -> Result<Vec<(Tensor, Tensor)>, TchError> {
        tch::no_grad(|| self.backbone.backward_by_hand(kernels, gradient, kept))
    }

    /// As [`Self::train`], from what the backbone made of the images.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn train_on(
        &self,
        features: &Tensor,
        state: &Tensor,
        demonstration: &Demonstration<'_>,
    ) -> Result<(Tensor, Option<LatentDistribution>), TchError> {
        let tokens = self.feature_tokens(features, state.size()[0])?;
        self.trunk.train(&self.seen(&tokens), state, demonstration)
    }

    /// The trunk's input; positions are the same for every observation.
    const fn seen<'a>(&'a self, tokens: &'a Tensor) -> EncoderInput<'a> {
        EncoderInput {
            tokens,
            position: &self.image_position,
        }
    }

    /// `(batch, cameras, 3, height, width)` to `(batch, cameras * rows * columns, width)`.
    fn image_tokens(&self, images: &Tensor) -> Result<Tensor, TchError> {
        let batch = images.size()[0];
        let images = images.f_to_kind(self.image_weight.kind())?;
        let features = self.backbone.forward(&images.f_flatten(0, 1)?)?;
        self.feature_tokens(&features, batch)
    }

    /// `(batch * cameras, channels, rows, columns)` to `(batch, cameras * rows * columns, width)`.
    fn feature_tokens(&self, features: &Tensor, batch: i64) -> Result<Tensor, TchError> {
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
    let stages = config.backbone_stages;
    let high = ResNet18::feature_side(config.image_height, stages);
    let wide = ResNet18::feature_side(config.image_width, stages);
    let table = position::plane_table(high, wide, config.dim_model);
    let cameras = dimension(config.cameras.len());
    Tensor::f_from_slice(&table)?
        .f_view([high * wide, config.dim_model])?
        .f_repeat([cameras, 1])
}
