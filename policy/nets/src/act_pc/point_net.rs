//! PointNet: features of every point by itself, with batch normalisation.
//!
//! The same layers for each point (Qi et al. 2017), as a product over all points of a batch.
//! Momentum (0.01) and epsilon (1e-3) of the normalisations are those of PointCloudMatters' code,
//! which has PyTorch's defaults where groups become tokens.

use tch::{TchError, Tensor};

use crate::dimension::width;
use crate::parameters::{Init, ParameterError, ParameterSource};

/// Features of a point.
pub(super) const POINT_FEATURES: i64 = 512;

/// Features after each layer.
const WIDTHS: [i64; 5] = [64, 64, 64, 128, POINT_FEATURES];

/// A linear layer without bias.
#[derive(Debug)]
pub(super) struct Mix {
    /// `(outputs, inputs)`.
    pub(super) weight: Tensor,
}

impl Mix {
    pub(super) fn new(
        source: &mut ParameterSource,
        key: &str,
        inputs: i64,
        outputs: i64,
    ) -> Result<Self, ParameterError> {
        let init = Init::fan_in(inputs);
        let weight = source.trainable(&format!("{key}.weight"), &[outputs, inputs], &init)?;
        Ok(Self { weight })
    }
}

/// Batch normalisation over the last of several dimensions.
///
/// In training it normalises by what is in the batch, and its own statistics move towards that.
#[derive(Debug)]
pub(super) struct BatchNorm {
    /// The trained scale.
    weight: Tensor,
    /// The trained shift.
    bias: Tensor,
    /// Running mean, which training moves.
    mean: Tensor,
    /// Running variance, likewise.
    variance: Tensor,
    /// The share of a batch's statistics that the running ones take over.
    momentum: f64,
    epsilon: f64,
}

/// What a batch normalisation does outside of training: `x * scale + shift`.
pub(super) struct Fixed {
    pub(super) scale: Tensor,
    pub(super) shift: Tensor,
}

impl BatchNorm {
    pub(super) fn new(
        source: &mut ParameterSource,
        key: &str,
        width: i64,
        momentum: f64,
        epsilon: f64,
    ) -> Result<Self, ParameterError> {
        let (zero, one) = (Init::Constant(0.0), Init::Constant(1.0));
        let key = |name: &str| format!("{key}.{name}");
        Ok(Self {
            weight: source.trainable(&key("weight"), &[width], &one)?,
            bias: source.trainable(&key("bias"), &[width], &zero)?,
            mean: source.fixed(&key("running_mean"), &[width], &zero)?,
            variance: source.fixed(&key("running_var"), &[width], &one)?,
            momentum,
            epsilon,
        })
    }

    pub(super) fn forward(&self, x: &Tensor, training: bool) -> Result<Tensor, TchError> {
        let shape = x.size();
        x.f_reshape([-1, width(x)])?
            .f_batch_norm(
                Some(&self.weight),
                Some(&self.bias),
                Some(&self.mean),
                Some(&self.variance),
                training,
                self.momentum,
                self.epsilon,
                true,
            )?
            .f_view(shape.as_slice())
    }

    /// Its statistics as they are now, in one scale and one shift.
    /// `scale = weight / sqrt(variance + epsilon)`, `shift = bias - mean * scale`.
    pub(super) fn fixed(&self) -> Result<Fixed, TchError> {
        let spread = self.variance.f_add_scalar(self.epsilon)?;
        let scale = self.weight.f_mul(&spread.f_rsqrt()?)?;
        let shift = self.bias.f_sub(&self.mean.f_mul(&scale)?)?;
        Ok(Fixed { scale, shift })
    }
}

/// Five layers of linear, batch normalisation, ReLU.
#[derive(Debug)]
pub(super) struct PointNet {
    pub(super) layers: Vec<(Mix, BatchNorm)>,
}

impl PointNet {
    pub(super) fn new(
        source: &mut ParameterSource,
        key: &str,
        inputs: i64,
    ) -> Result<Self, ParameterError> {
        let mut layers = Vec::new();
        let mut inputs = inputs;
        for (index, outputs) in (1..).zip(WIDTHS) {
            let key = |place: usize| format!("{key}.conv{index}.{place}");
            layers.push((
                Mix::new(source, &key(0), inputs, outputs)?,
                BatchNorm::new(source, &key(1), outputs, 0.01, 1e-3)?,
            ));
            inputs = outputs;
        }
        Ok(Self { layers })
    }

    /// `(.., inputs)` to `(.., POINT_FEATURES)`.
    pub(super) fn forward(&self, points: &Tensor, training: bool) -> Result<Tensor, TchError> {
        let mut x = points.shallow_clone();
        for (mix, norm) in &self.layers {
            let mixed = x.f_linear(&mix.weight, None::<&Tensor>)?;
            x = norm.forward(&mixed, training)?.f_relu()?;
        }
        Ok(x)
    }
}
