//! Linear layers as inference runs them.

use tch::{Device, Kind, TchError, Tensor};

use super::Linear;
use super::matrix::{After, Matrix};
use super::vectors::Processor;

/// Who computes products.
#[derive(Clone, Copy, Debug)]
pub(crate) enum By {
    /// Code of ours, for the processor that is named: in single precision on the CPU, with one thread.
    Own(Processor),
    /// The network library, in the precision that is named.
    Library(Kind),
}

impl By {
    /// The fastest on `device`, with so many threads as there are now.
    pub(crate) fn fastest(device: Device, kind: Kind) -> Self {
        let ours = kind == Kind::Float && device == Device::Cpu && tch::get_num_threads() == 1;
        match Processor::found() {
            Some(processor) if ours => Self::Own(processor),
            _ => Self::Library(kind),
        }
    }

    /// The precision that it computes in.
    pub(crate) const fn kind(self) -> Kind {
        match self {
            Self::Own(_) => Kind::Float,
            Self::Library(kind) => kind,
        }
    }
}

/// A linear layer whose bias may differ from row to row.
#[derive(Debug)]
pub(crate) enum Affine {
    Own {
        matrix: Matrix,
        /// `(outputs)` or `(rows of one observation, outputs)`.
        bias: Vec<f32>,
    },
    Library {
        /// `(inputs, outputs)`, so that the product reads it as it is.
        weight: Tensor,
        /// As above.
        bias: Tensor,
    },
}

impl Affine {
    /// `weight` `(outputs, inputs)`; `bias` is `(outputs)` or `(rows of one observation, outputs)`.
    pub(crate) fn new(weight: &Tensor, bias: &Tensor, by: By) -> Result<Self, TchError> {
        let (weight, bias) = (weight.f_detach()?, bias.f_detach()?.f_contiguous()?);
        match by {
            By::Own(processor) if Matrix::fits(&weight) => Ok(Self::Own {
                matrix: Matrix::new(processor, &weight)?,
                bias: Vec::try_from(&bias.f_view([-1])?)?,
            }),
            By::Own(_) | By::Library(_) => Ok(Self::Library {
                weight: weight
                    .f_to_kind(by.kind())?
                    .f_transpose(0, 1)?
                    .f_contiguous()?,
                bias: bias.f_to_kind(by.kind())?,
            }),
        }
    }

    pub(crate) fn of(linear: &Linear, by: By) -> Result<Self, TchError> {
        Self::new(&linear.weight, &linear.bias, by)
    }

    /// `x` `(rows, inputs)` to `(rows, outputs)`.
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        self.apply(x, false)
    }

    /// The same, followed by a rectifier.
    pub(crate) fn rectified(&self, x: &Tensor) -> Result<Tensor, TchError> {
        self.apply(x, true)
    }

    fn apply(&self, x: &Tensor, rectified: bool) -> Result<Tensor, TchError> {
        match self {
            Self::Own { matrix, bias } => {
                matrix.apply(&x.f_contiguous()?, After { bias, rectified })
            }
            Self::Library { weight, bias } => {
                let mut sum = bias_of(bias, x)?.f_addmm(x, weight)?;
                // tch 0.24 hands the flag of the fused `_addmm_activation` to the parameter `beta`, so two steps.
                if rectified { sum.f_relu_() } else { Ok(sum) }
            }
        }
    }
}

/// `bias` as often as there are observations in `x`.
fn bias_of(bias: &Tensor, x: &Tensor) -> Result<Tensor, TchError> {
    let rows = x.size()[0];
    match bias.size().as_slice() {
        &[own, _] if own != rows => bias.f_repeat([rows / own.max(1), 1]),
        _ => Ok(bias.shallow_clone()),
    }
}
