//! The backbone with its fixed normalisations inside the convolutions, channels last in memory.
//!
//! A frozen normalisation is a scale and a shift for each channel, `y = s * (w * x) + t`, so that
//! `s * w` is a filter and `t` its bias: one pass over memory less for every convolution. Group
//! normalisation depends on the picture and stays.

use tch::{Kind, TchError, Tensor};

use super::native_backbone::NativeBackbone;
use crate::act::resnet::{Block, Conv, NORM_EPS, Norm, ResNet18};
use crate::layers::affine::Backend;

/// The backbone for inference.
#[derive(Debug)]
pub(super) enum FoldedBackbone {
    /// In convolutions of ours.
    Native(Box<NativeBackbone>),
    /// In the network library's.
    Torch(TorchBackbone),
}

impl FoldedBackbone {
    /// For images of `sides`, height and width. Where not all normalisations are fixed the library
    /// computes.
    pub(super) fn new(
        backbone: &ResNet18,
        sides: [usize; 2],
        backend: Backend,
    ) -> Result<Self, TchError> {
        Ok(match backend {
            Backend::Native(processor) if NativeBackbone::fits(backbone) => {
                Self::Native(Box::new(NativeBackbone::new(backbone, sides, processor)?))
            }
            Backend::Native(_) | Backend::Torch(_) => {
                Self::Torch(TorchBackbone::new(backbone, backend.kind())?)
            }
        })
    }

    /// `(n, 3, h, w)` to `(n * h / 32 * w / 32, 512)`, row by row, sizes rounded up.
    pub(super) fn forward(&mut self, images: &Tensor) -> Result<Tensor, TchError> {
        match self {
            Self::Native(backbone) => backbone.forward(images),
            Self::Torch(backbone) => backbone.forward(images),
        }
    }
}

/// The backbone in the network library's convolutions: wherever it computes, in whatever precision,
/// with any normalisation.
#[derive(Debug)]
pub(super) struct TorchBackbone {
    stem: FoldedConv,
    blocks: Vec<FoldedBlock>,
}

/// A residual block; see `act::resnet::Block`.
#[derive(Debug)]
struct FoldedBlock {
    first: FoldedConv,
    second: FoldedConv,
    downsample: Option<FoldedConv>,
}

/// A convolution and what is left of its normalisation.
#[derive(Debug)]
struct FoldedConv {
    /// `(outputs, inputs, side, side)`, channels last in memory.
    weight: Tensor,
    /// `(outputs)`; none before a group normalisation.
    bias: Option<Tensor>,
    stride: i64,
    padding: i64,
    /// None where the normalisation is in the filter.
    group_norm: Option<GroupNorm>,
}

/// A group normalisation: scale and shift, `(channels)` each; its statistics are those of the
/// picture at hand.
#[derive(Debug)]
struct GroupNorm {
    groups: i64,
    weight: Tensor,
    bias: Tensor,
}

impl TorchBackbone {
    /// Filters are scaled in single precision and only then rounded to `kind`.
    pub(super) fn new(backbone: &ResNet18, kind: Kind) -> Result<Self, TchError> {
        let block = |block: &Block| {
            let downsample = block.downsample.as_ref();
            Ok(FoldedBlock {
                first: FoldedConv::new(&block.first, kind)?,
                second: FoldedConv::new(&block.second, kind)?,
                downsample: downsample
                    .map(|conv| FoldedConv::new(conv, kind))
                    .transpose()?,
            })
        };
        Ok(Self {
            stem: FoldedConv::new(&backbone.stem, kind)?,
            blocks: backbone
                .blocks
                .iter()
                .map(block)
                .collect::<Result<_, TchError>>()?,
        })
    }

    /// As [`FoldedBackbone::forward`]; ReLU works in place, on tensors that nobody else sees.
    pub(super) fn forward(&self, images: &Tensor) -> Result<Tensor, TchError> {
        let mut x = self.stem.forward(images)?;
        // Max pooling commutes with ReLU, and leaves fewer numbers for it.
        x = x.f_max_pool2d([3, 3], [2, 2], [1, 1], [1, 1], false)?;
        x = x.f_relu_()?;
        for block in &self.blocks {
            x = block.forward(x)?;
        }
        x.f_permute([0, 2, 3, 1])?.f_flatten(0, 2)
    }
}

impl FoldedBlock {
    fn forward(&self, x: Tensor) -> Result<Tensor, TchError> {
        let inner = self.first.forward(&x)?.f_relu_()?;
        let mut inner = self.second.forward(&inner)?;
        let identity = match &self.downsample {
            Some(downsample) => downsample.forward(&x)?,
            None => x,
        };
        inner.f_add_(&identity)?.f_relu_()
    }
}

impl FoldedConv {
    fn new(conv: &Conv, kind: Kind) -> Result<Self, TchError> {
        let weight = conv.weight.f_detach()?;
        let (weight, bias, group_norm) = match &conv.norm {
            Norm::Frozen { scale, shift } => {
                let weight = weight.f_mul(&scale.f_view([-1, 1, 1, 1])?)?;
                (weight, Some(shift.f_view([-1])?.f_to_kind(kind)?), None)
            }
            Norm::Group {
                groups,
                weight: scale,
                bias,
            } => {
                let group_norm = GroupNorm {
                    groups: *groups,
                    weight: scale.f_detach()?.f_to_kind(kind)?,
                    bias: bias.f_detach()?.f_to_kind(kind)?,
                };
                (weight, None, Some(group_norm))
            }
        };
        let last = weight.f_to_kind(kind)?.f_permute([0, 2, 3, 1])?;
        Ok(Self {
            weight: last.f_contiguous()?.f_permute([0, 3, 1, 2])?,
            bias,
            stride: conv.stride,
            padding: conv.padding,
            group_norm,
        })
    }

    fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        let (stride, padding) = ([self.stride; 2], [self.padding; 2]);
        let bias = self.bias.as_ref();
        let x = x.f_conv2d(&self.weight, bias, stride, padding, [1, 1], 1)?;
        match &self.group_norm {
            Some(norm) => {
                let GroupNorm { weight, bias, .. } = norm;
                x.f_group_norm(norm.groups, Some(weight), Some(bias), NORM_EPS, true)
            }
            None => Ok(x),
        }
    }
}
