//! DP3 as inference runs it: made once from a trained network, with the same answers but for
//! rounding.
//!
//! Of the scales and shifts that the condition gives each channel, the part of the diffusion's
//! timesteps is known while building, since inference has few of them, and the part of the
//! observations is the same in all of them. Convolutions over so few steps are matrix products.

mod convolved;
mod streamed;
mod taps;
#[cfg(test)]
mod tests;
mod unet;

use tch::{Kind, TchError, Tensor};

use super::config::Dp3Config;
use super::diffusion::Diffusion;
use super::encoder::Encoder;
use super::{CloudObservation, Dp3};
use crate::cuda_graph::NetworkGraph;
use convolved::Backend;
use unet::FoldedUNet;

/// A DP3 network for inference, one observation at a time.
#[derive(Debug)]
pub struct FoldedDp3 {
    config: Dp3Config,
    /// Dropped before the network whose work it replays.
    graph: NetworkGraph,
    network: Network,
}

/// What is computed for an observation: encoder once, U-Net once a timestep.
#[derive(Debug)]
struct Network {
    encoder: Encoder,
    unet: FoldedUNet,
    diffusion: Diffusion,
}

impl FoldedDp3 {
    /// The network that answers as `dp3` did, where `dp3` was; its convolutions compute in the
    /// precision `kind`, the rest in single precision.
    ///
    /// # Errors
    /// The network library's.
    pub fn new(dp3: Dp3, kind: Kind) -> Result<Self, TchError> {
        let backend = Backend::fastest(kind, dp3.unet.device());
        Self::computed(dp3, backend)
    }

    /// The same with convolutions computed by `backend`.
    fn computed(dp3: Dp3, backend: Backend) -> Result<Self, TchError> {
        let Dp3 {
            config,
            encoder,
            unet,
            diffusion,
            ..
        } = dp3;
        let timesteps = diffusion.timesteps();
        let unet = tch::no_grad(|| FoldedUNet::new(&unet, &timesteps, config.horizon, backend))?;
        Ok(Self {
            config,
            graph: NetworkGraph::default(),
            network: Network {
                encoder,
                unet,
                diffusion,
            },
        })
    }

    /// What the network was built from.
    #[must_use]
    pub const fn config(&self) -> &Dp3Config {
        &self.config
    }

    /// The actions that `noise` leads to, as [`Dp3::infer`] gives them, for one observation: `(1,
    /// horizon, action)`.
    ///
    /// It writes into tensors of its own: one inference ends before the next begins, and on CUDA
    /// the next one overwrites the output.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn infer(
        &mut self,
        observation: &CloudObservation<'_>,
        noise: &Tensor,
    ) -> Result<Tensor, TchError> {
        let shape = [1, self.config.horizon, self.config.action_dim];
        if noise.size() != shape {
            let actual = noise.size();
            return Err(TchError::Shape(format!("noise {actual:?}, not {shape:?}")));
        }
        let inputs = [observation.points, observation.state, noise];
        let network = &mut self.network;
        self.graph.answer(inputs, |[points, state, noise]| {
            network.infer(&CloudObservation { points, state }, noise)
        })
    }
}

impl Network {
    fn infer(
        &mut self,
        observation: &CloudObservation<'_>,
        noise: &Tensor,
    ) -> Result<Tensor, TchError> {
        let points = observation.points.f_flatten(0, 1)?;
        let state = observation.state.f_flatten(0, 1)?;
        let observed = self.encoder.forward(&points, &state)?.f_view([1, -1])?;
        let modulations = self.unet.modulations(&observed)?;
        let mut steps = modulations.iter();
        self.diffusion.sample(noise, |noisy, _| {
            let step = steps
                .next()
                .ok_or_else(|| TchError::Shape("timesteps".to_owned()))?;
            self.unet.forward(noisy, step)
        })
    }
}
