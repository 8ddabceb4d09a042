//! The U-Net's convolutions: by products of our own where the processor's instructions are known, by the network library
//! elsewhere.

use tch::{Device, Kind, TchError, Tensor};

use super::streamed::{Streamed, Workspace};
use super::taps::Taps;
use crate::dimension::length;
use crate::dp3::blocks::{Convolution, Doubling};
use crate::layers::vectors::Processor;

/// By what convolutions are computed.
#[derive(Clone, Copy, Debug)]
pub(super) enum By {
    /// Our own products, in single precision on the CPU, on as many threads as given.
    Own(Processor, usize),
    /// The network library, with weights of this kind.
    Library(Kind),
}

impl By {
    /// The fastest for weights of `kind` on `device`, with the network library's threads.
    pub(super) fn fastest(kind: Kind, device: Device) -> Self {
        let threads = length(i64::from(tch::get_num_threads()));
        match Processor::found() {
            Some(processor) if kind == Kind::Float && device == Device::Cpu => {
                Self::Own(processor, threads)
            }
            _ => Self::Library(kind),
        }
    }
}

/// A convolution for a fixed number of steps, from `(1, channels, steps)` to `(1, channels, steps)`.
#[derive(Debug)]
pub(super) enum Convolved {
    Own(Streamed),
    Library(Taps),
}

impl Convolved {
    /// `convolution` over `steps`, and one of a single tap and as many outputs beside it.
    pub(super) fn new(
        convolution: &Convolution,
        beside: Option<&Convolution>,
        steps: i64,
        by: By,
    ) -> Result<Self, TchError> {
        Ok(match by {
            By::Own(processor, threads) => Self::Own(Streamed::new(
                convolution,
                beside,
                steps,
                (processor, threads),
            )?),
            By::Library(kind) => Self::Library(Taps::new(convolution, beside, steps, kind)?),
        })
    }

    /// Twice as many steps as went in.
    pub(super) fn doubling(doubling: &Doubling, steps: i64, by: By) -> Result<Self, TchError> {
        Ok(match by {
            By::Own(processor, threads) => {
                Self::Own(Streamed::doubling(doubling, steps, (processor, threads))?)
            }
            By::Library(kind) => Self::Library(Taps::doubling(doubling, steps, kind)?),
        })
    }

    /// The answer is in single precision, whatever the weights have, and contiguous.
    pub(super) fn apply(
        &mut self,
        x: &Tensor,
        workspace: &mut Workspace,
    ) -> Result<Tensor, TchError> {
        match self {
            Self::Own(streamed) => streamed.apply(x, workspace),
            Self::Library(taps) => taps.apply(x),
        }
    }

    /// `x`, made of what [`Self::apply`] answered, after Mish, as the next convolution reads it best.
    pub(super) fn activated(&self, mut x: Tensor) -> Result<Tensor, TchError> {
        match self {
            Self::Own(_) => x.f_mish_(),
            Self::Library(taps) => taps.activated(x),
        }
    }

    /// Adds to `out` what the convolution beside made of what was last applied to; or `x` if there is none.
    pub(super) fn add_beside(&self, mut out: Tensor, x: &Tensor) -> Result<Tensor, TchError> {
        match self {
            Self::Own(streamed) => out.f_add_(streamed.beside().unwrap_or(x)),
            Self::Library(taps) => taps.add_beside(out, x),
        }
    }
}
