//! What an ACT network is made of: LeRobot's field names, the presets, and the variants as named
//! options.

use serde::{Deserialize, Serialize};

use crate::dimension::dimension;

/// Stages of a ResNet-18.
pub(crate) const STAGES: usize = 4;

/// Normalisation layers of the backbone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum BackboneNorm {
    /// Batch normalisation with fixed statistics, as in imported checkpoints: nothing of it is
    /// trained.
    #[default]
    FrozenBatchNorm,
    /// Group normalisation, 16 channels a group, trained. Independent of the batch and of its size,
    /// and the same in training and inference, so it is what trains from scratch.
    GroupNorm,
}

/// By what the sum of absolute action errors is divided.
///
/// It is part of a checkpoint's recipe, since it changes what a loss curve's numbers mean.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum LossDenominator {
    /// All elements, padded ones too: the original, and LeRobot up to 0.5.
    All,
    /// The elements that are not padded: LeRobot from 0.6.
    #[default]
    Valid,
}

/// Which decoder layer's output becomes the chunk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum DecoderOutput {
    /// The last layer's.
    #[default]
    Last,
    /// The first layer's, as in the original code, whose further layers never mattered. They are
    /// not built.
    First,
}

/// One ACT network. Field names and defaults are LeRobot's where it has the field.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ActConfig {
    /// Steps in a chunk, 1 to 1024; a policy that runs has at most `hal::chunk::CHUNK_STEPS_MAX`.
    pub chunk_size: i64,
    /// Width of the transformer; a multiple of `n_heads` and of 4.
    pub dim_model: i64,
    /// Attention heads.
    pub n_heads: i64,
    /// Width of the feed-forward layers.
    pub dim_feedforward: i64,
    /// Layers of the encoder.
    pub n_encoder_layers: i64,
    /// Layers of the decoder, of which `decoder_output` says which one counts.
    pub n_decoder_layers: i64,
    /// Layers of the variational encoder.
    pub n_vae_encoder_layers: i64,
    /// Width of the latent, the paper's `z`, which is the zero vector at inference.
    pub latent_dim: i64,
    /// Whether layers normalise before instead of after their work.
    pub pre_norm: bool,
    /// Whether training goes through the variational encoder.
    pub use_vae: bool,
    /// Dropout in training.
    pub dropout: f64,
    /// Weight of the KL term.
    pub kl_weight: f64,
    /// Which decoder layer counts.
    pub decoder_output: DecoderOutput,
    /// What the loss is divided by.
    pub loss_denominator: LossDenominator,
    /// Normalisation layers of the backbone.
    pub backbone_norm: BackboneNorm,
    /// Stages of the ResNet-18 that are built: 4, as LeRobot's; 3 leave out the last, three
    /// quarters of its weights, and see twice as finely.
    ///
    /// An image side of `p` pixels gives `p / 2^(stages + 1)` tokens, rounded up at each halving.
    #[serde(default = "all_stages")]
    pub backbone_stages: usize,
    /// Numbers in `observation.state`.
    pub state_dim: i64,
    /// Numbers in one action.
    pub action_dim: i64,
    /// Feature names of the cameras, in order (`observation.images.NAME`).
    pub cameras: Vec<String>,
    /// Height of the images that enter the network, 32 to 4096 pixels. Both sides of a recorded
    /// frame must be the same whole multiple of the network's.
    pub image_height: i64,
    /// Width of the images that enter the network, pixels.
    pub image_width: i64,
}

/// For files without the field: all stages.
const fn all_stages() -> usize {
    STAGES
}

/// A named network.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum ActPreset {
    /// The original: 7 decoder layers of which the first counts, all elements in the denominator,
    /// 512x512 images.
    Paper,
    /// LeRobot's defaults, 512x512 images.
    Lerobot,
    /// For quick work: half the width, 256x256 images, chunks of 50 steps; 31 MB in half precision
    /// without the variational encoder.
    Small,
    /// [`Self::Small`] without the backbone's last stage: a token for every 16 pixels in place of
    /// 32, 14 MB in half precision.
    Compact,
}

/// Numbers of one arm in `observation.state` and in one action: six joints or pose numbers, and the
/// jaw. State and relative action happen to be equally wide.
pub const STATE_DIM: i64 = 7;

impl ActConfig {
    /// The network of `preset` for one arm and `cameras`, feature names, with group normalisation
    /// since nothing is imported.
    #[must_use]
    pub fn preset(preset: ActPreset, cameras: &[String]) -> Self {
        let base = Self::lerobot_defaults(STATE_DIM, STATE_DIM, cameras, 512, 512);
        let scratch = Self {
            backbone_norm: BackboneNorm::GroupNorm,
            ..base
        };
        match preset {
            ActPreset::Lerobot => scratch,
            ActPreset::Paper => Self {
                n_decoder_layers: 7,
                decoder_output: DecoderOutput::First,
                loss_denominator: LossDenominator::All,
                ..scratch
            },
            ActPreset::Compact => Self {
                backbone_stages: 3,
                ..Self::preset(ActPreset::Small, cameras)
            },
            ActPreset::Small => Self {
                chunk_size: 50,
                dim_model: 256,
                dim_feedforward: 1024,
                image_height: 256,
                image_width: 256,
                ..scratch
            },
        }
    }

    /// The same network with the inputs and outputs of `arms` arms.
    #[must_use]
    pub fn for_arms(self, arms: usize) -> Self {
        let dim = dimension(arms) * STATE_DIM;
        Self {
            state_dim: dim,
            action_dim: dim,
            ..self
        }
    }

    /// LeRobot 0.6's defaults, frozen batch normalisation included, for the given inputs.
    #[must_use]
    pub fn lerobot_defaults(
        state_dim: i64,
        action_dim: i64,
        cameras: &[String],
        image_height: i64,
        image_width: i64,
    ) -> Self {
        Self {
            chunk_size: 100,
            dim_model: 512,
            n_heads: 8,
            dim_feedforward: 3200,
            n_encoder_layers: 4,
            n_decoder_layers: 1,
            n_vae_encoder_layers: 4,
            latent_dim: 32,
            pre_norm: false,
            use_vae: true,
            dropout: 0.1,
            kl_weight: 10.0,
            decoder_output: DecoderOutput::Last,
            loss_denominator: LossDenominator::Valid,
            backbone_norm: BackboneNorm::FrozenBatchNorm,
            backbone_stages: STAGES,
            state_dim,
            action_dim,
            cameras: cameras.to_vec(),
            image_height,
            image_width,
        }
    }

    /// Decoder layers that are built: those whose output matters.
    #[must_use]
    pub const fn built_decoder_layers(&self) -> i64 {
        match self.decoder_output {
            DecoderOutput::Last => self.n_decoder_layers,
            DecoderOutput::First => 1,
        }
    }

    /// What makes this configuration impossible to build, if anything does.
    ///
    /// Names the field, its value and the allowed range. Constructors assume that there is none;
    /// loaders ask first.
    #[must_use]
    pub fn defect(&self) -> Option<String> {
        let sizes = [
            ("chunk_size", self.chunk_size, 1, 1024),
            ("dim_model", self.dim_model, 4, 8192),
            ("n_heads", self.n_heads, 1, 256),
            ("dim_feedforward", self.dim_feedforward, 1, 65_536),
            ("n_encoder_layers", self.n_encoder_layers, 1, 64),
            ("n_decoder_layers", self.n_decoder_layers, 1, 64),
            ("n_vae_encoder_layers", self.n_vae_encoder_layers, 1, 64),
            ("latent_dim", self.latent_dim, 1, 4096),
            ("state_dim", self.state_dim, 1, 1024),
            ("action_dim", self.action_dim, 1, 1024),
            ("image height", self.image_height, 32, 4096),
            ("image width", self.image_width, 32, 4096),
        ];
        for (name, value, low, high) in sizes {
            if !(low..=high).contains(&value) {
                return Some(format!("{name} = {value} is outside [{low}, {high}]"));
            }
        }
        if self.dim_model % self.n_heads != 0 || self.dim_model % 4 != 0 {
            return Some(format!(
                "dim_model = {} is no multiple of 4 and of n_heads = {}",
                self.dim_model, self.n_heads
            ));
        }
        if !(1..=STAGES).contains(&self.backbone_stages) {
            let stages = self.backbone_stages;
            return Some(format!(
                "backbone_stages = {stages} is outside [1, {STAGES}]"
            ));
        }
        if self.cameras.is_empty() {
            return Some("there is no camera".to_owned());
        }
        if !(0.0..1.0).contains(&self.dropout) {
            return Some(format!("dropout = {} is outside [0, 1)", self.dropout));
        }
        (!(self.kl_weight.is_finite() && self.kl_weight >= 0.0))
            .then(|| format!("kl_weight = {} is negative or not finite", self.kl_weight))
    }
}

#[cfg(test)]
mod tests {
    use super::{ActConfig, ActPreset};

    #[test]
    fn every_preset_can_be_built() {
        let cameras = ["observation.images.endoscope".to_owned()];
        for preset in [
            ActPreset::Paper,
            ActPreset::Lerobot,
            ActPreset::Small,
            ActPreset::Compact,
        ] {
            assert_eq!(
                ActConfig::preset(preset, &cameras).defect(),
                None,
                "{preset:?}"
            );
        }
    }

    #[test]
    fn heads_that_do_not_divide_the_width_are_refused() {
        let cameras = ["observation.images.endoscope".to_owned()];
        let config = ActConfig {
            n_heads: 7,
            ..ActConfig::preset(ActPreset::Small, &cameras)
        };
        assert!(config.defect().unwrap().contains("n_heads = 7"));
    }
}
