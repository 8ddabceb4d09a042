//! ACT as inference runs it: made once from a trained network, with the same answers but for
//! rounding.
//!
//! What is done while building: fixed normalisations go into the convolutions; what positions add
//! to queries and keys, and the token of the latent, which is zero, become biases; the first
//! decoder layer's attention of the steps to each other, which starts from zeros, becomes a
//! constant with the queries that follow from it. Nothing of the variational encoder is kept.
//!
//! The trained network in `super` is the reference: `tests` compares both, and `tests/golden`
//! compares the reference with LeRobot's numbers. An inference allocates in the network library. On
//! CUDA the first one captures a graph; later ones of the same shapes copy their inputs and replay
//! it.

mod backbone;
mod native_backbone;
#[cfg(test)]
mod tests;
mod trunk;

use tch::{Kind, TchError, Tensor};

use super::Act;
use crate::cuda_graph::NetworkGraph;
use crate::dimension::length;
use crate::layers::affine::{Affine, Backend};
use backbone::FoldedBackbone;
pub(crate) use trunk::{FoldedEncoderInput, FoldedTrunk};

/// An ACT network for inference.
#[derive(Debug)]
pub struct FoldedAct {
    /// Dropped before the network that it repeats.
    graph: NetworkGraph,
    network: Network,
}

/// What is computed for an observation, in this order: backbone, projection of its features to
/// tokens, transformer.
#[derive(Debug)]
struct Network {
    backbone: FoldedBackbone,
    /// The 1x1 convolution from the backbone's channels to the transformer's width, as a linear
    /// layer over pixels.
    image_input: Affine,
    trunk: FoldedTrunk,
    /// Precision of weights and activations; the chunk is single precision whatever it is.
    kind: Kind,
}

impl FoldedAct {
    /// The network that answers as `act` does, computing in the precision `kind`, where `act` is.
    ///
    /// # Errors
    /// The network library's.
    pub fn new(act: &Act, kind: Kind) -> Result<Self, TchError> {
        Self::computed(
            act,
            Backend::fastest(kind, act.backbone.stem.weight.device()),
        )
    }

    /// The same, computed by `backend`.
    fn computed(act: &Act, backend: Backend) -> Result<Self, TchError> {
        tch::no_grad(|| {
            let config = act.config();
            let sides = [config.image_height, config.image_width];
            let sides = sides.map(length);
            let image_weight = act.image_weight.f_flatten(1, 3)?;
            let position = act.image_position.f_squeeze_dim(0)?;
            Ok(Self {
                graph: NetworkGraph::default(),
                network: Network {
                    backbone: FoldedBackbone::new(&act.backbone, sides, backend)?,
                    image_input: Affine::new(&image_weight, &act.image_bias, backend)?,
                    trunk: FoldedTrunk::new(&act.trunk, Some(&position), backend)?,
                    kind: backend.kind(),
                },
            })
        })
    }

    /// The chunk for an observation, as [`Act::infer`] gives it: `(batch, steps, action)`,
    /// normalised, single precision.
    ///
    /// `images` is `(batch, cameras, 3, height, width)`, all of which go through the backbone
    /// together; `state` is `(batch, state)`. It writes into tensors of its own: one inference ends
    /// before the next begins, and on CUDA the next one overwrites the output.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn infer(&mut self, images: &Tensor, state: &Tensor) -> Result<Tensor, TchError> {
        let network = &mut self.network;
        self.graph.answer([images, state], |[images, state]| {
            network.infer(images, state)
        })
    }
}

impl Network {
    /// As [`FoldedAct::infer`], kernel by kernel.
    fn infer(&mut self, images: &Tensor, state: &Tensor) -> Result<Tensor, TchError> {
        let batch = images.size()[0];
        let images = images.f_to_kind(self.kind)?.f_flatten(0, 1)?;
        let features = self.backbone.forward(&images)?;
        let rows = self.image_input.forward(&features)?;
        let tokens = rows.f_unflatten(0, [batch, -1])?;
        let position = None;
        self.trunk.infer(
            &FoldedEncoderInput {
                tokens: &tokens,
                position,
            },
            state,
        )
    }
}
