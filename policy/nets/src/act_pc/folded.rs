//! ACT-PC as inference runs it: made once from a trained network, with the same answers but for
//! rounding.
//!
//! Normalisations go into the layers before them. The one before the greatest of the neighbours is
//! a scale, which the layer takes, and a shift, which can wait until the greatest is found.

use tch::{Kind, TchError, Tensor};

use super::ActPc;
use super::clouds::Clouds;
use super::tokens::{PointTokens, pick, space_position};
use crate::act::{FoldedEncoderInput, FoldedTrunk};
use crate::layers::affine::{Affine, Backend};

/// An ACT-PC network for inference.
#[derive(Debug)]
pub struct FoldedActPc {
    /// From a point to its features, ReLU after each.
    point_net: Vec<Affine>,
    /// Of a point's place and features, without a shift.
    mix: Affine,
    /// Of a centre's place.
    centre: Affine,
    /// What is added to the greatest.
    shift: Tensor,
    pre_sample: bool,
    width: i64,
    trunk: FoldedTrunk,
    kind: Kind,
}

impl FoldedActPc {
    /// The network that answers as `network` does, computing in the precision `kind`, where
    /// `network` is.
    ///
    /// # Errors
    /// The network library's.
    pub fn new(network: &ActPc, kind: Kind) -> Result<Self, TchError> {
        Self::computed(
            network,
            Backend::fastest(kind, network.tokens.mix.weight.device()),
        )
    }

    /// The same, computed by `backend`.
    fn computed(network: &ActPc, backend: Backend) -> Result<Self, TchError> {
        let kind = backend.kind();
        tch::no_grad(|| {
            let PointTokens {
                point_net,
                mix,
                norm,
                pre_sample,
                width,
            } = &network.tokens;
            let layers = point_net.layers.iter().map(|(mix, norm)| {
                let fixed = norm.fixed()?;
                let weight = mix.weight.f_mul(&fixed.scale.f_unsqueeze(1)?)?;
                Affine::new(&weight, &fixed.shift, backend)
            });
            let fixed = norm.fixed()?;
            let weight = mix.weight.f_mul(&fixed.scale.f_unsqueeze(1)?)?;
            let nothing = fixed.shift.f_zeros_like()?;
            Ok(Self {
                point_net: layers.collect::<Result<_, _>>()?,
                mix: Affine::new(&weight, &nothing, backend)?,
                centre: Affine::new(&weight.f_narrow(1, 0, 3)?, &nothing, backend)?,
                shift: fixed.shift.f_detach()?.f_to_kind(kind)?,
                pre_sample: *pre_sample,
                width: *width,
                trunk: FoldedTrunk::new(&network.trunk, None, backend)?,
                kind,
            })
        })
    }

    /// The chunk for an observation, as [`ActPc::infer`] gives it: `(batch, steps, action)`,
    /// normalised, single precision.
    ///
    /// `state` is `(batch, state)`.
    ///
    /// # Errors
    /// The network library's, if shapes do not fit.
    pub fn infer(&self, clouds: &Clouds, state: &Tensor) -> Result<Tensor, TchError> {
        let batch = clouds.points.size()[0];
        let centres = pick(&clouds.points, &clouds.centres)?;
        let position = space_position(&centres, self.width)?;
        let points = clouds.points.f_to_kind(self.kind)?.f_flatten(0, 1)?;
        let centres = centres.f_to_kind(self.kind)?.f_flatten(0, 1)?;
        let tokens = if self.pre_sample {
            let around = self.group(&points, &points, &centres, clouds)?;
            self.features(around)?
        } else {
            let features = self.features(points.shallow_clone())?;
            self.group(&points, &features, &centres, clouds)?
        };
        let seen = FoldedEncoderInput {
            tokens: &tokens.f_unflatten(0, [batch, -1])?,
            position: Some(&position),
        };
        self.trunk.infer(&seen, state)
    }

    /// PointNet over rows, `(rows, 3)` to `(rows, features)`.
    fn features(&self, mut x: Tensor) -> Result<Tensor, TchError> {
        for layer in &self.point_net {
            x = layer.rectified(&x)?;
        }
        Ok(x)
    }

    /// The greatest of what the layer makes of each neighbour's place relative to the centre and
    /// its features; all are `(rows, ..)`.
    ///
    /// `max_j(W [p_j - c; f_j]) = max_j(W [p_j; f_j]) - W_p c` since `W_p c` is the same for all
    /// `j`; the shift and ReLU, which are monotonic, follow the maximum.
    fn group(
        &self,
        points: &Tensor,
        features: &Tensor,
        centres: &Tensor,
        clouds: &Clouds,
    ) -> Result<Tensor, TchError> {
        let of_points = self.mix.forward(&Tensor::f_cat(&[points, features], 1)?)?;
        let of_places = self.centre.forward(centres)?;
        let size = clouds.neighbours.size();
        let [batch, tokens, neighbours] = size.as_slice() else {
            return Err(TchError::Shape(format!("neighbours of shape {size:?}")));
        };
        let of_points = of_points.f_unflatten(0, [*batch, -1])?;
        let around = pick(&of_points, &clouds.neighbours.f_view([*batch, -1])?)?.f_view([
            batch * tokens,
            *neighbours,
            -1,
        ])?;
        // The centre's place is the same for all neighbours, so it can wait, too.
        let greatest = around.f_amax([1], false)?.f_sub(&of_places)?;
        greatest.f_add(&self.shift)?.f_relu()
    }
}

#[cfg(test)]
mod tests {
    use tch::{Device, Kind, Tensor};

    use super::FoldedActPc;
    use crate::act_pc::tests::{cloud, config, network};
    use crate::act_pc::{ActPcConfig, Clouds};
    use crate::layers::affine::Backend;
    use crate::layers::vectors::Processor;

    #[test]
    fn folding_changes_nothing_but_rounding() {
        let own = Processor::found().map(Backend::Native);
        for backend in own.into_iter().chain([Backend::Torch(Kind::Float)]) {
            check(backend, &config(false));
            check(backend, &config(true));
            let mut several = config(false);
            several.act.n_decoder_layers = 2;
            check(backend, &several);
        }
    }

    #[track_caller]
    fn check(backend: Backend, config: &ActPcConfig) {
        let network = network(config);
        let folded = FoldedActPc::computed(&network, backend).unwrap();
        let (first, second) = (cloud(1), cloud(2));
        let clouds = Clouds::new(&[&first, &second], config, Device::Cpu).unwrap();
        let state = Tensor::arange(14, (Kind::Float, Device::Cpu)).sin();
        let state = state.view([2, 7]);
        let (expected, actual) = tch::no_grad(|| {
            (
                network.infer(&clouds, &state).unwrap(),
                folded.infer(&clouds, &state).unwrap(),
            )
        });
        assert_eq!(expected.size(), actual.size());
        let scale = expected.abs().max().double_value(&[]);
        let off = (expected - actual).abs().max().double_value(&[]) / scale;
        assert!(
            off <= 3e-6 && scale > 0.1,
            "off by {off:e} of {scale}: {backend:?}"
        );
    }
}
