//! Points to tokens: what is around each centre, and where it is.

use tch::{Kind, TchError, Tensor};

use super::clouds::Clouds;
use super::config::ActPcConfig;
use super::point_net::{BatchNorm, Mix, POINT_FEATURES, PointNet};
use crate::dimension::width;
use crate::parameters::{ParameterError, ParameterSource};

/// The base of the position's frequencies.
const TEMPERATURE: f64 = 10_000.0;

/// Makes a token of what is around each centre.
#[derive(Debug)]
pub(super) struct PointTokens {
    pub(super) point_net: PointNet,
    /// From a neighbour's relative place and features to what the maximum is taken of.
    pub(super) mix: Mix,
    /// Before the maximum; in training its statistics are over all neighbours of all groups.
    pub(super) norm: BatchNorm,
    pub(super) pre_sample: bool,
    pub(super) width: i64,
}

impl PointTokens {
    pub(super) fn new(
        source: &mut ParameterSource,
        config: &ActPcConfig,
    ) -> Result<Self, ParameterError> {
        let width = config.act.dim_model;
        // Beside the three coordinates relative to the centre.
        let (features, outputs) = if config.pre_sample {
            (3, 3)
        } else {
            (POINT_FEATURES, width)
        };
        Ok(Self {
            point_net: PointNet::new(source, "model.backbone", 3)?,
            mix: Mix::new(source, "model.linear", 3 + features, outputs)?,
            norm: BatchNorm::new(source, "model.bn", outputs, 0.1, 1e-5)?,
            pre_sample: config.pre_sample,
            width,
        })
    }

    /// What training changes and in which precision it is.
    pub(super) fn kind(&self) -> Kind {
        self.mix.weight.kind()
    }

    /// Tokens and their positions, `(batch, tokens, width)` each.
    pub(super) fn forward(
        &self,
        clouds: &Clouds,
        training: bool,
    ) -> Result<(Tensor, Tensor), TchError> {
        let centres = pick(&clouds.points, &clouds.centres)?;
        let points = clouds.points.f_to_kind(self.kind())?;
        let tokens = if self.pre_sample {
            let grouped = self.group(&points, &points, clouds, training)?;
            self.point_net.forward(&grouped, training)?
        } else {
            let features = self.point_net.forward(&points, training)?;
            self.group(&points, &features, clouds, training)?
        };
        let position = space_position(&centres, self.width)?.f_to_kind(self.kind())?;
        Ok((tokens, position))
    }

    /// The greatest of what the layer makes of each neighbour's place relative to the centre and
    /// its features.
    ///
    /// The layer is linear, so its part for the centre's place is computed once a centre and its
    /// part for a point once a point, not once for every pair.
    fn group(
        &self,
        points: &Tensor,
        features: &Tensor,
        clouds: &Clouds,
        training: bool,
    ) -> Result<Tensor, TchError> {
        let weight = &self.mix.weight;
        let of_points =
            Tensor::f_cat(&[points, features], -1)?.f_linear(weight, None::<&Tensor>)?;
        let of_places =
            pick(points, &clouds.centres)?.f_linear(&weight.f_narrow(1, 0, 3)?, None::<&Tensor>)?;
        let size = clouds.neighbours.size();
        let [batch, tokens, neighbours] = size.as_slice() else {
            return Err(TchError::Shape(format!("neighbours of shape {size:?}")));
        };
        let around = pick(&of_points, &clouds.neighbours.f_view([*batch, -1])?)?.f_view([
            *batch,
            *tokens,
            *neighbours,
            -1,
        ])?;
        let relative = around.f_sub(&of_places.f_unsqueeze(2)?)?;
        let (greatest, _) = self
            .norm
            .forward(&relative, training)?
            .f_max_dim(2, false)?;
        greatest.f_relu()
    }
}

/// Rows of `values` `(batch, rows, width)` by `indices` `(batch, picked)`.
pub(super) fn pick(values: &Tensor, indices: &Tensor) -> Result<Tensor, TchError> {
    let sizes = [-1, -1, width(values)];
    let indices = indices.f_unsqueeze(-1)?.f_expand(sizes, false)?;
    values.f_gather(1, &indices, false)
}

/// Sine positions in space of `centres` `(batch, tokens, 3)`, in metres, as `(batch, tokens,
/// width)`.
///
/// A third of the width for each axis: first the sines, then the cosines; what is left is zero.
/// Angles are metres over periods from 1 to nearly 10000, so that within a few centimetres even the
/// fastest sine turns little.
pub(super) fn space_position(centres: &Tensor, width: i64) -> Result<Tensor, TchError> {
    let third = width / 3;
    let index = Tensor::f_arange(third, (Kind::Float, centres.device()))?;
    // The same frequency for a sine and its cosine.
    let pair = index.f_div_scalar_mode(2.0, "floor")?;
    #[expect(clippy::cast_precision_loss, reason = "a width is small")]
    let octave = 2.0 * TEMPERATURE.ln() / third as f64;
    let periods = pair.f_mul_scalar(octave)?.f_exp()?;
    let angles = centres.f_unsqueeze(-1)?.f_div(&periods)?;
    let sines = angles.f_slice(-1, 0, third, 2)?.f_sin()?;
    let cosines = angles.f_slice(-1, 1, third, 2)?.f_cos()?;
    let axes = Tensor::f_cat(&[sines, cosines], -1)?.f_flatten(2, 3)?;
    axes.f_constant_pad_nd([0, width - 3 * third])
}
