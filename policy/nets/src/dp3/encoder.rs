//! What DP3 makes of an observation: features of the points, whatever their order, and of the
//! state.
//!
//! A point's features depend on it alone, and the maximum over points on no order (PointNet, Qi et
//! al. 2017), here with layer normalisation. Points without colour: three numbers each.

use tch::{TchError, Tensor};

use super::config::{Dp3Config, STATE_FEATURES};
use crate::layers::{LayerNorm, Linear};
use crate::parameters::{ParameterError, ParameterSource};

/// Features of a point after each layer.
const POINT_WIDTHS: [i64; 3] = [64, 128, 256];

/// Two branches whose outputs are concatenated: points, then state.
#[derive(Debug)]
pub(super) struct Encoder {
    /// Three layers, ReLU after each.
    points: Vec<(Linear, LayerNorm)>,
    /// Of the maximum over the points.
    projection: (Linear, LayerNorm),
    /// ReLU between them.
    state: [Linear; 2],
}

impl Encoder {
    pub(super) fn new(
        source: &mut ParameterSource,
        key: &str,
        config: &Dp3Config,
    ) -> Result<Self, ParameterError> {
        let mut points = Vec::new();
        let mut inputs = 3;
        // Every third place is a ReLU without parameters.
        for (layer, outputs) in (0..).step_by(3).zip(POINT_WIDTHS) {
            let place = |offset: usize| format!("{key}.extractor.mlp.{}", layer + offset);
            points.push((
                Linear::new(source, &place(0), inputs, outputs)?,
                LayerNorm::new(source, &place(1), outputs)?,
            ));
            inputs = outputs;
        }
        let place = |index: usize| format!("{key}.extractor.final_projection.{index}");
        let features = config.encoder_output_dim;
        let projection = (
            Linear::new(source, &place(0), inputs, features)?,
            LayerNorm::new(source, &place(1), features)?,
        );
        let place = |index: usize| format!("{key}.state_mlp.{index}");
        Ok(Self {
            points,
            projection,
            state: [
                Linear::new(source, &place(0), config.state_dim, STATE_FEATURES)?,
                Linear::new(source, &place(2), STATE_FEATURES, STATE_FEATURES)?,
            ],
        })
    }

    /// `points` `(observations, points, 3)` and `state` `(observations, state)` to `(observations,
    /// features)`, in the weights' precision.
    pub(super) fn forward(&self, points: &Tensor, state: &Tensor) -> Result<Tensor, TchError> {
        let kind = self.state[0].weight.kind();
        let (mut x, state) = (points.f_to_kind(kind)?, &state.f_to_kind(kind)?);
        for (linear, norm) in &self.points {
            x = norm.forward(&linear.forward(&x)?)?.f_relu()?;
        }
        let (greatest, _) = x.f_max_dim(1, false)?;
        let (linear, norm) = &self.projection;
        let of_points = norm.forward(&linear.forward(&greatest)?)?;
        let [first, second] = &self.state;
        let of_state = second.forward(&first.forward(state)?.f_relu()?)?;
        Tensor::f_cat(&[of_points, of_state], -1)
    }
}
