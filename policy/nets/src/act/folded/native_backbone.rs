//! The backbone in convolutions of our own: on the CPU, with one thread, where all normalisations
//! are fixed.

use tch::{TchError, Tensor};

use crate::act::resnet::{Block, Conv, Norm, ResNet18};
use crate::dimension::length;
use crate::layers::planes::{Direct, Plane, Stem, Steps, Winograd, Workspace};
use crate::layers::vectors::Processor;

/// The backbone and the memory that it works in.
#[derive(Debug)]
pub(super) struct NativeBackbone {
    /// 7x7 convolution, ReLU and max pooling as one.
    stem: Stem,
    blocks: Vec<NativeBlock>,
    /// Planes and scratch memory; kept from inference to inference.
    workspace: Workspace,
}

/// A residual block; its sum and second ReLU are the epilogue of `second`.
#[derive(Debug)]
struct NativeBlock {
    first: Convolution,
    second: Convolution,
    downsample: Option<Convolution>,
}

/// A convolution, the way that is the fastest for the pictures that it gets. The choice is made
/// once, while building.
#[derive(Debug)]
enum Convolution {
    /// Of 3x3 with stride 1 and ReLU after it, where [`Winograd::pays`] for the outputs' size.
    Tiles(Winograd),
    /// All others.
    Taps(Direct),
}

impl NativeBackbone {
    /// Whether all normalisations are fixed.
    pub(super) fn fits(backbone: &ResNet18) -> bool {
        let fixed = |conv: &Conv| matches!(conv.norm, Norm::Frozen { .. });
        let blocks = backbone.blocks.iter();
        let mut all = blocks.flat_map(|block| {
            let downsample = block.downsample.iter();
            [&block.first, &block.second].into_iter().chain(downsample)
        });
        fixed(&backbone.stem) && all.all(fixed)
    }

    /// For images of `sides`, height and width.
    pub(super) fn new(
        backbone: &ResNet18,
        sides: [usize; 2],
        processor: Processor,
    ) -> Result<Self, TchError> {
        let (weight, bias) = folded(&backbone.stem)?;
        // After the stem, and after its pooling.
        let mut sides = sides.map(|side| side.div_ceil(4));
        let mut blocks = Vec::new();
        for block in &backbone.blocks {
            sides = sides.map(|side| side.div_ceil(length(block.first.stride).max(1)));
            blocks.push(NativeBlock::new(block, sides)?);
        }
        Ok(Self {
            stem: Stem::new(&weight, &bias)?,
            blocks,
            workspace: Workspace::of(processor),
        })
    }

    /// As [`super::backbone::FoldedBackbone::forward`].
    pub(super) fn forward(&mut self, images: &Tensor) -> Result<Tensor, TchError> {
        let mut x = self.stem.apply(images, &mut self.workspace)?;
        for block in &self.blocks {
            x = block.forward(x, &mut self.workspace)?;
        }
        let rows = x.rows()?;
        self.workspace.give_back(x);
        Ok(rows)
    }
}

impl NativeBlock {
    /// `sides` are those of its outputs.
    fn new(block: &Block, sides: [usize; 2]) -> Result<Self, TchError> {
        let downsample = block.downsample.as_ref();
        Ok(Self {
            first: Convolution::new(&block.first, sides, true)?,
            second: Convolution::new(&block.second, sides, true)?,
            downsample: downsample
                .map(|conv| Convolution::new(conv, sides, false))
                .transpose()?,
        })
    }

    fn forward(&self, x: Plane, workspace: &mut Workspace) -> Result<Plane, TchError> {
        let inner = self.first.apply(&x, None, workspace)?;
        let identity = match &self.downsample {
            Some(downsample) => {
                let identity = downsample.apply(&x, None, workspace)?;
                workspace.give_back(x);
                identity
            }
            None => x,
        };
        let out = self.second.apply(&inner, Some(&identity), workspace)?;
        workspace.give_back(inner);
        workspace.give_back(identity);
        Ok(out)
    }
}

impl Convolution {
    /// `sides` are those of its outputs; `rectified` if ReLU follows.
    fn new(conv: &Conv, [height, width]: [usize; 2], rectified: bool) -> Result<Self, TchError> {
        let (weight, bias) = folded(conv)?;
        let steps = Steps {
            stride: length(conv.stride),
            padding: length(conv.padding),
        };
        let tiles = rectified && steps.stride == 1 && Winograd::pays(height, width);
        Ok(if tiles {
            Self::Tiles(Winograd::new(&weight, &bias)?)
        } else {
            Self::Taps(Direct::new(&weight, &bias, steps, rectified)?)
        })
    }

    /// `x` through the convolution, plus `beside`, with ReLU if it was built so.
    fn apply(
        &self,
        x: &Plane,
        beside: Option<&Plane>,
        workspace: &mut Workspace,
    ) -> Result<Plane, TchError> {
        match self {
            Self::Tiles(convolution) => convolution.apply(x, beside, workspace),
            Self::Taps(convolution) => convolution.apply(x, beside, workspace),
        }
    }
}

/// The weight and the bias of a convolution with its normalisation inside.
fn folded(conv: &Conv) -> Result<(Tensor, Tensor), TchError> {
    match &conv.norm {
        Norm::Frozen { scale, shift } => {
            let weight = conv.weight.f_detach()?;
            let weight = weight.f_mul(&scale.f_view([-1, 1, 1, 1])?)?;
            Ok((weight, shift.f_view([-1])?))
        }
        Norm::Group { .. } => Err(TchError::Shape(
            "a normalisation that is not fixed".to_owned(),
        )),
    }
}
