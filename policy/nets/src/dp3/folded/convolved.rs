//! The U-Net's convolutions: by products of our own where the processor's instructions are known,
//! by the network library elsewhere.

use tch::{Device, Kind, TchError, Tensor};

use super::streamed::{Streamed, Workspace};
use super::taps::Taps;
use crate::dimension::length;
use crate::dp3::blocks::{Convolution, Doubling};
use crate::layers::vectors::Processor;

/// What computes convolutions.
#[derive(Clone, Copy, Debug)]
pub(super) enum Backend {
    /// Our GEMM kernel, on the CPU in single precision, on so many threads.
    Native(Processor, usize),
    /// libtorch, with weights of this kind.
    Torch(Kind),
}

impl Backend {
    /// The fastest for weights of `kind` on `device`, with the network library's threads.
    pub(super) fn fastest(kind: Kind, device: Device) -> Self {
        let threads = length(i64::from(tch::get_num_threads()));
        match Processor::found() {
            Some(processor) if kind == Kind::Float && device == Device::Cpu => {
                Self::Native(processor, threads)
            }
            _ => Self::Torch(kind),
        }
    }
}

/// A convolution for a fixed number of steps, from `(1, channels, steps)` to `(1, channels,
/// steps)`.
#[derive(Debug)]
pub(super) enum Convolved {
    Native(Streamed),
    Torch(Taps),
}

impl Convolved {
    /// `convolution` over `steps`, and the residual connection's, of a single tap and as many
    /// outputs.
    pub(super) fn new(
        convolution: &Convolution,
        beside: Option<&Convolution>,
        steps: i64,
        backend: Backend,
    ) -> Result<Self, TchError> {
        Ok(match backend {
            Backend::Native(processor, threads) => Self::Native(Streamed::new(
                convolution,
                beside,
                steps,
                (processor, threads),
            )?),
            Backend::Torch(kind) => Self::Torch(Taps::new(convolution, beside, steps, kind)?),
        })
    }

    /// Twice as many steps as went in.
    pub(super) fn doubling(
        doubling: &Doubling,
        steps: i64,
        backend: Backend,
    ) -> Result<Self, TchError> {
        Ok(match backend {
            Backend::Native(processor, threads) => {
                Self::Native(Streamed::doubling(doubling, steps, (processor, threads))?)
            }
            Backend::Torch(kind) => Self::Torch(Taps::doubling(doubling, steps, kind)?),
        })
    }

    /// The output is in single precision, whatever the weights have, and contiguous.
    pub(super) fn apply(
        &mut self,
        x: &Tensor,
        workspace: &mut Workspace,
    ) -> Result<Tensor, TchError> {
        match self {
            Self::Native(streamed) => streamed.apply(x, workspace),
            Self::Torch(taps) => taps.apply(x),
        }
    }

    /// `x`, made of what [`Self::apply`] answered, after Mish, as the next convolution reads it
    /// best: in place, or in a new tensor of another layout.
    pub(super) fn activated(&self, mut x: Tensor) -> Result<Tensor, TchError> {
        match self {
            Self::Native(_) => x.f_mish_(),
            Self::Torch(taps) => taps.activated(x),
        }
    }

    /// Adds the residual connection to `out`: its convolution's output for the last input, or `x`
    /// without one.
    pub(super) fn add_beside(&self, mut out: Tensor, x: &Tensor) -> Result<Tensor, TchError> {
        match self {
            Self::Native(streamed) => out.f_add_(streamed.beside().unwrap_or(x)),
            Self::Torch(taps) => taps.add_beside(out, x),
        }
    }
}
