//! The backbone's training with kernels of our own between the convolutions: forward, saving what
//! the backward pass needs, and backward.
//!
//! Autograd keeps every intermediate tensor and runs each elementwise operation as a kernel of its
//! own. Here a residual block keeps its convolutions' outputs and its two activations; the scale
//! and shift of a normalisation, the sum and ReLU are one kernel, and so is their backward pass.
//! Group normalisation has further kernels for its statistics.

use tch::{TchError, Tensor};

use super::{Block, Conv, Norm, ResNet18};
use crate::by_name::convolution_backward;
use crate::kernels::{Affine, Kernels, OfAffine, SavedForBackward};

/// What the backward pass needs of the backbone's forward pass.
pub struct SavedActivations {
    /// `(n, 3, h, w)`, channels last, for the gradient of the stem's filters.
    images: Tensor,
    /// The stem's answer, which of nine pixels it is of, and what it was made of.
    stem: (Tensor, Tensor, SavedForBackward),
    /// In the network's order.
    blocks: Vec<KeptBlock>,
}

/// What a residual block keeps: what each normalisation needs, and the activations that the
/// filters' gradients need.
struct KeptBlock {
    first: SavedForBackward,
    /// After the first ReLU.
    between: Tensor,
    second: SavedForBackward,
    downsample: Option<SavedForBackward>,
    /// After the second ReLU; its sign is the ReLU's mask.
    answer: Tensor,
}

/// Parameters with their gradients.
type Gradients = Vec<(Tensor, Tensor)>;

impl ResNet18 {
    /// What [`Self::forward`] answers, outside of the library's own bookkeeping. `images` and
    /// filters have 16 bits and their channels last.
    pub(crate) fn forward_by_hand(
        &self,
        kernels: &Kernels,
        images: &Tensor,
    ) -> Result<(Tensor, SavedActivations), TchError> {
        let stem = kernels.pooled(self.stem.convolve(images)?, &self.stem.affine())?;
        let mut x = stem.0.shallow_clone();
        let mut blocks = Vec::with_capacity(self.blocks.len());
        for block in &self.blocks {
            let kept = block.forward_by_hand(kernels, &x)?;
            x = kept.answer.shallow_clone();
            blocks.push(kept);
        }
        let kept = SavedActivations {
            images: images.shallow_clone(),
            stem,
            blocks,
        };
        Ok((x, kept))
    }

    /// The gradients of all parameters, given that of the answer.
    pub(crate) fn backward_by_hand(
        &self,
        kernels: &Kernels,
        gradient: &Tensor,
        kept: &SavedActivations,
    ) -> Result<Gradients, TchError> {
        let mut found = Vec::new();
        let mut gradient = channels_last(gradient)?;
        for (index, block) in self.blocks.iter().enumerate().rev() {
            let before = index
                .checked_sub(1)
                .map_or(&kept.stem.0, |before| &kept.blocks[before].answer);
            let kept = &kept.blocks[index];
            gradient = block.backward_by_hand(kernels, &gradient, (before, kept), &mut found)?;
        }
        let affine = self.stem.affine();
        let (gradient, of_affine) = kernels.pooled_backward(&gradient, &kept.stem, &affine)?;
        self.stem.note(of_affine, &mut found);
        let _none = self.stem.back(&gradient, &kept.images, false, &mut found)?;
        Ok(found)
    }
}

impl Block {
    fn forward_by_hand(&self, kernels: &Kernels, x: &Tensor) -> Result<KeptBlock, TchError> {
        let (first, second) = (&self.first, &self.second);
        let (between, kept_first) =
            kernels.forward(first.convolve(x)?, &first.affine(), None, true)?;
        let (identity, downsample) = match &self.downsample {
            Some(down) => {
                let convolved = down.convolve(x)?;
                let (identity, kept) = kernels.forward(convolved, &down.affine(), None, false)?;
                (identity, Some(kept))
            }
            None => (x.shallow_clone(), None),
        };
        let convolved = second.convolve(&between)?;
        let (answer, kept_second) =
            kernels.forward(convolved, &second.affine(), Some(&identity), true)?;
        Ok(KeptBlock {
            first: kept_first,
            between,
            second: kept_second,
            downsample,
            answer,
        })
    }

    /// The gradient of what went in, `x`.
    fn backward_by_hand(
        &self,
        kernels: &Kernels,
        gradient: &Tensor,
        (x, kept): (&Tensor, &KeptBlock),
        found: &mut Gradients,
    ) -> Result<Tensor, TchError> {
        let (first, second) = (&self.first, &self.second);
        let (of_second, of_affine, of_identity) = kernels.backward(
            gradient,
            &kept.second,
            &second.affine(),
            Some(&kept.answer),
            true,
        )?;
        second.note(of_affine, found);
        let of_between = second.back(&of_second, &kept.between, true, found)?;
        let (of_first, of_affine, _) =
            kernels.backward(&of_between, &kept.first, &first.affine(), None, true)?;
        first.note(of_affine, found);
        let mut of_x = first.back(&of_first, x, true, found)?;
        let Some(of_identity) = of_identity else {
            return Ok(of_x);
        };
        let beside = match (&self.downsample, &kept.downsample) {
            (Some(down), Some(kept)) => {
                let (of_down, of_affine, _) =
                    kernels.backward(&of_identity, kept, &down.affine(), None, false)?;
                down.note(of_affine, found);
                down.back(&of_down, x, true, found)?
            }
            _ => of_identity,
        };
        of_x.f_add_(&beside)
    }
}

impl Conv {
    fn convolve(&self, x: &Tensor) -> Result<Tensor, TchError> {
        let (stride, padding) = ([self.stride; 2], [self.padding; 2]);
        x.f_conv2d::<&Tensor>(&self.weight, None, stride, padding, [1, 1], 1)
    }

    /// The normalisation as the kernels take it.
    const fn affine(&self) -> Affine<'_> {
        match &self.norm {
            Norm::Frozen { scale, shift } => Affine::Fixed(scale, shift),
            Norm::Group { weight, bias, .. } => Affine::Group(weight, bias),
        }
    }

    /// Notes the gradients of the normalisation, if it is trained.
    fn note(&self, of_affine: OfAffine, found: &mut Gradients) {
        if let (Norm::Group { weight, bias, .. }, Some((of_weight, of_bias))) =
            (&self.norm, of_affine)
        {
            found.push((weight.shallow_clone(), of_weight));
            found.push((bias.shallow_clone(), of_bias));
        }
    }

    /// Notes the gradient of the filters; the gradient of `x` if it is wanted, which is undefined
    /// if not.
    fn back(
        &self,
        gradient: &Tensor,
        x: &Tensor,
        of_x: bool,
        found: &mut Gradients,
    ) -> Result<Tensor, TchError> {
        let form = [self.stride, self.padding];
        let (of_x, of_weight) = convolution_backward(gradient, x, &self.weight, form, of_x)?;
        found.push((self.weight.shallow_clone(), of_weight));
        Ok(of_x)
    }
}

/// `images` with their channels last in memory.
pub(super) fn channels_last(images: &Tensor) -> Result<Tensor, TchError> {
    images
        .f_permute([0, 2, 3, 1])?
        .f_contiguous()?
        .f_permute([0, 3, 1, 2])
}
