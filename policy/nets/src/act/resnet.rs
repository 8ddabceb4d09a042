//! ResNet-18 without its head: images to feature maps, at a 32nd of their size and with 512
//! channels where all four stages are built, at a 16th and with 256 where three are.
//!
//! He et al. 2016, table 1. As torchvision builds it, but that the normalisation is frozen or by
//! groups, both independent of the batch.

pub(crate) mod by_hand;
#[cfg(test)]
mod by_hand_tests;
mod statistics;
#[cfg(test)]
mod tests;

use tch::{Kind, TchError, Tensor};

use super::config::{BackboneNorm, STAGES};
use crate::parameters::{Init, ParameterError, ParameterSource};

/// Output channels of the four stages.
const STAGE_CHANNELS: [i64; STAGES] = [64, 128, 256, 512];

/// The first convolution.
const STEM: ConvShape = ConvShape {
    inputs: 3,
    outputs: 64,
    size: 7,
    stride: 2,
};

/// Channels that one group of a group normalisation holds.
const CHANNELS_PER_GROUP: i64 = 16;

/// Added to a variance before its root, as PyTorch does.
pub(super) const NORM_EPS: f64 = 1e-5;

/// The backbone. Key names are torchvision's.
#[derive(Debug)]
pub(super) struct ResNet18 {
    pub(super) stem: Conv,
    /// Two a stage.
    pub(super) blocks: Vec<Block>,
}

impl ResNet18 {
    /// The first `stages` stages at `prefix`, fresh ones drawn as torchvision draws them.
    pub(super) fn new(
        source: &mut ParameterSource,
        prefix: &str,
        norm: BackboneNorm,
        stages: usize,
    ) -> Result<Self, ParameterError> {
        let stem_keys = [format!("{prefix}.conv1"), format!("{prefix}.bn1")];
        let stem = Conv::new(source, &stem_keys, STEM, norm)?;
        let mut blocks = Vec::new();
        let mut inputs = 64;
        for (stage, outputs) in STAGE_CHANNELS.into_iter().enumerate().take(stages) {
            for index in 0..2 {
                let key = format!("{prefix}.layer{}.{index}", stage + 1);
                let stride = if stage > 0 && index == 0 { 2 } else { 1 };
                blocks.push(Block::new(source, &key, inputs, outputs, stride, norm)?);
                inputs = outputs;
            }
        }
        Ok(Self { stem, blocks })
    }

    /// `(n, 3, h, w)` to `(n, channels, h / 2^(stages + 1), w / 2^(stages + 1))`, sizes rounded up.
    pub(super) fn forward(&self, images: &Tensor) -> Result<Tensor, TchError> {
        // ReLU after max pooling does the same, to a quarter as many numbers.
        let x = self.stem.forward(images)?;
        let x = x.f_max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false)?;
        let mut x = x.f_relu()?;
        for block in &self.blocks {
            x = block.forward(&x)?;
        }
        Ok(x)
    }

    /// Channels of the feature map.
    pub(super) fn feature_channels(stages: usize) -> i64 {
        STAGE_CHANNELS[stages.clamp(1, STAGES) - 1]
    }

    /// Side of the feature map for an image side of `pixels`: a halving a stage and one before,
    /// each rounded up.
    pub(super) const fn feature_side(pixels: i64, stages: usize) -> i64 {
        let mut side = pixels;
        let mut halvings = 0;
        while halvings < stages + 1 {
            side = (side + 1) / 2;
            halvings += 1;
        }
        side
    }
}

/// Two 3x3 convolutions with a residual connection.
#[derive(Debug)]
pub(super) struct Block {
    pub(super) first: Conv,
    pub(super) second: Conv,
    /// 1x1 with the block's stride, where number of channels and size change; else the input itself
    /// is added.
    pub(super) downsample: Option<Conv>,
}

impl Block {
    /// A block at `key`; only the first block of a later stage has a stride of 2.
    fn new(
        source: &mut ParameterSource,
        key: &str,
        inputs: i64,
        outputs: i64,
        stride: i64,
        norm: BackboneNorm,
    ) -> Result<Self, ParameterError> {
        let first_shape = ConvShape {
            inputs,
            outputs,
            size: 3,
            stride,
        };
        let second_shape = ConvShape {
            inputs: outputs,
            outputs,
            size: 3,
            stride: 1,
        };
        let first = Conv::new(
            source,
            &[format!("{key}.conv1"), format!("{key}.bn1")],
            first_shape,
            norm,
        )?;
        let second = Conv::new(
            source,
            &[format!("{key}.conv2"), format!("{key}.bn2")],
            second_shape,
            norm,
        )?;
        let downsample = if stride == 1 {
            None
        } else {
            let keys = [format!("{key}.downsample.0"), format!("{key}.downsample.1")];
            Some(Conv::new(
                source,
                &keys,
                ConvShape {
                    inputs,
                    outputs,
                    size: 1,
                    stride,
                },
                norm,
            )?)
        };
        Ok(Self {
            first,
            second,
            downsample,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        let inner = self.second.forward(&self.first.forward(x)?.f_relu()?)?;
        let identity = match &self.downsample {
            Some(downsample) => downsample.forward(x)?,
            None => x.shallow_clone(),
        };
        inner.f_add(&identity)?.f_relu()
    }
}

/// Channels in and out, side of the square filter, and stride; padding is half a side.
#[derive(Clone, Copy)]
struct ConvShape {
    inputs: i64,
    outputs: i64,
    size: i64,
    stride: i64,
}

/// A convolution without bias, and the normalisation after it.
#[derive(Debug)]
pub(super) struct Conv {
    /// `(outputs, inputs, side, side)`.
    pub(super) weight: Tensor,
    pub(super) stride: i64,
    pub(super) padding: i64,
    pub(super) norm: Norm,
}

impl Conv {
    /// `keys` are those of the convolution and of the normalisation.
    fn new(
        source: &mut ParameterSource,
        keys: &[String; 2],
        shape: ConvShape,
        norm: BackboneNorm,
    ) -> Result<Self, ParameterError> {
        let ConvShape {
            inputs,
            outputs,
            size,
            stride,
        } = shape;
        let init = Init::he(outputs * size * size);
        let weight = source.trainable(
            &format!("{}.weight", keys[0]),
            &[outputs, inputs, size, size],
            &init,
        )?;
        Ok(Self {
            norm: Norm::new(source, &keys[1], outputs, norm)?.of_kind(weight.kind())?,
            weight,
            stride,
            padding: size / 2,
        })
    }

    /// `x` before it is normalised.
    fn convolved(&self, x: &Tensor) -> Result<Tensor, TchError> {
        self.convolved_with(x, &self.weight, None)
    }

    /// `x` by another `weight` of the same shape, and `shift` for a bias.
    fn convolved_with(
        &self,
        x: &Tensor,
        weight: &Tensor,
        shift: Option<&Tensor>,
    ) -> Result<Tensor, TchError> {
        let (stride, padding) = ([self.stride; 2], [self.padding; 2]);
        x.f_conv2d(weight, shift, stride, padding, [1, 1], 1)
    }

    /// Convolution and normalisation; on CUDA a frozen one goes into the filter, at every step anew
    /// since the filter is trained.
    fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        match &self.norm {
            // An accelerator waits for memory, which the filters take less of than the images.
            Norm::Frozen { scale, shift } if x.device().is_cuda() => {
                let weight = self.weight.f_mul(&scale.f_view([-1, 1, 1, 1])?)?;
                self.convolved_with(x, &weight, Some(&shift.f_view([-1])?))
            }
            norm @ (Norm::Frozen { .. } | Norm::Group { .. }) => norm.forward(&self.convolved(x)?),
        }
    }
}

/// The normalisation after a convolution.
#[derive(Debug)]
pub(super) enum Norm {
    /// `x * scale + shift`, both `(1, channels, 1, 1)`.
    Frozen { scale: Tensor, shift: Tensor },
    /// Over the pixels and channels of a group.
    Group {
        groups: i64,
        weight: Tensor,
        bias: Tensor,
    },
}

impl Norm {
    fn new(
        source: &mut ParameterSource,
        key: &str,
        channels: i64,
        kind: BackboneNorm,
    ) -> Result<Self, ParameterError> {
        let (weight_key, bias_key) = (format!("{key}.weight"), format!("{key}.bias"));
        let (one, zero) = (Init::Constant(1.0), Init::Constant(0.0));
        match kind {
            BackboneNorm::GroupNorm => Ok(Self::Group {
                groups: channels / CHANNELS_PER_GROUP,
                weight: source.trainable(&weight_key, &[channels], &one)?,
                bias: source.trainable(&bias_key, &[channels], &zero)?,
            }),
            BackboneNorm::FrozenBatchNorm => Self::frozen(source, key, channels),
        }
    }

    /// Batch normalisation with fixed statistics, as the scale and the shift that it amounts to.
    /// `scale = weight / sqrt(variance + eps)`, `shift = bias - mean * scale`.
    fn frozen(
        source: &mut ParameterSource,
        key: &str,
        channels: i64,
    ) -> Result<Self, ParameterError> {
        let (one, zero) = (Init::Constant(1.0), Init::Constant(0.0));
        let mut fixed =
            |name: &str, init| source.fixed(&format!("{key}.{name}"), &[channels], init);
        let (weight, bias) = (fixed("weight", &one)?, fixed("bias", &zero)?);
        let mean = fixed("running_mean", &zero)?;
        let variance = fixed("running_var", &one)?;
        let scale = weight.f_mul(&variance.f_add_scalar(NORM_EPS)?.f_rsqrt()?)?;
        let shift = bias.f_sub(&mean.f_mul(&scale)?)?;
        Ok(Self::Frozen {
            scale: scale.f_view([1, -1, 1, 1])?,
            shift: shift.f_view([1, -1, 1, 1])?,
        })
    }

    /// The same for numbers of `kind`. Statistics are rounded only here, as one scale and one
    /// shift: a variance or a mean that was rounded before would be far off where the two of them
    /// nearly cancel out.
    fn of_kind(self, kind: Kind) -> Result<Self, TchError> {
        Ok(match self {
            Self::Frozen { scale, shift } => Self::Frozen {
                scale: scale.f_to_kind(kind)?,
                shift: shift.f_to_kind(kind)?,
            },
            // Trained, and so of the weights' kind.
            Self::Group { .. } => self,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        match self {
            Self::Frozen { scale, shift } => x.f_mul(scale)?.f_add(shift),
            Self::Group {
                groups,
                weight,
                bias,
            } => x.f_group_norm(*groups, Some(weight), Some(bias), NORM_EPS, true),
        }
    }
}
