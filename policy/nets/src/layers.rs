//! Layers that networks share: linear, layer normalisation, attention, feed-forward. Batch first
//! throughout.
//!
//! Here as training and reference inference use them, by the network library; the modules below are
//! what folded networks compute with. `affine` picks the backend of a linear layer and `matrix`
//! multiplies; `narrow` is for convolutions over few steps, `planes` for those of images; `kernel`
//! holds sums in registers, `vectors` is what the processor can do.

pub(crate) mod affine;
mod aligned;
pub(crate) mod folded;
mod kernel;
pub(crate) mod matrix;
mod memory;
pub(crate) mod narrow;
pub(crate) mod planes;
#[cfg(test)]
#[cfg(target_arch = "x86_64")]
mod seeded;
pub(crate) mod vectors;

use tch::{Device, Kind, TchError, Tensor};

use crate::parameters::{Init, ParameterError, ParameterSource};

/// A linear layer with bias.
#[derive(Debug)]
pub(crate) struct Linear {
    /// `(outputs, inputs)`.
    pub(crate) weight: Tensor,
    pub(crate) bias: Tensor,
}

impl Linear {
    /// Starts as PyTorch's linear layers do.
    pub(crate) fn new(
        source: &mut ParameterSource,
        key: &str,
        inputs: i64,
        outputs: i64,
    ) -> Result<Self, ParameterError> {
        Self::with_init(source, key, inputs, outputs, &Init::fan_in(inputs))
    }

    /// Starts with weights from `init`.
    pub(crate) fn with_init(
        source: &mut ParameterSource,
        key: &str,
        inputs: i64,
        outputs: i64,
        init: &Init,
    ) -> Result<Self, ParameterError> {
        Ok(Self {
            weight: source.trainable(&format!("{key}.weight"), &[outputs, inputs], init)?,
            bias: source.trainable(&format!("{key}.bias"), &[outputs], &Init::fan_in(inputs))?,
        })
    }

    /// `x W^T + b` over the last dimension.
    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        x.f_linear(&self.weight, Some(&self.bias))
    }

    /// Where its parameters are.
    pub(crate) fn device(&self) -> Device {
        self.weight.device()
    }
}

/// Normalisation over the last dimension.
///
/// `(x - mean) / sqrt(variance + 1e-5) * weight + bias` (Ba et al. 2016), the variance that of the
/// population.
#[derive(Debug)]
pub(crate) struct LayerNorm {
    weight: Tensor,
    bias: Tensor,
    width: i64,
}

impl LayerNorm {
    pub(crate) fn new(
        source: &mut ParameterSource,
        key: &str,
        width: i64,
    ) -> Result<Self, ParameterError> {
        Ok(Self {
            weight: source.trainable(&format!("{key}.weight"), &[width], &Init::Constant(1.0))?,
            bias: source.trainable(&format!("{key}.bias"), &[width], &Init::Constant(0.0))?,
            width,
        })
    }

    /// The same in the precision `kind`, apart from training.
    pub(crate) fn of_kind(&self, kind: Kind) -> Result<Self, TchError> {
        Ok(Self {
            weight: self.weight.f_detach()?.f_to_kind(kind)?,
            bias: self.bias.f_detach()?.f_to_kind(kind)?,
            width: self.width,
        })
    }

    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        x.f_layer_norm(
            [self.width],
            Some(&self.weight),
            Some(&self.bias),
            1e-5,
            true,
        )
    }
}

/// Attention with several heads and one packed projection of queries, keys and values.
///
/// `softmax(Q K^T / sqrt(width / heads)) V` for each head (Vaswani et al. 2017, eq. 1), with
/// PyTorch's parameter names.
#[derive(Debug)]
pub(crate) struct Attention {
    /// `(3 * width, width)`: of queries, keys, values.
    pub(crate) in_weight: Tensor,
    pub(crate) in_bias: Tensor,
    /// `(width, width)`, from the joined heads.
    pub(crate) out_weight: Tensor,
    pub(crate) out_bias: Tensor,
    pub(crate) width: i64,
    pub(crate) heads: i64,
}

impl Attention {
    pub(crate) fn new(
        source: &mut ParameterSource,
        key: &str,
        width: i64,
        heads: i64,
    ) -> Result<Self, ParameterError> {
        let zero = Init::Constant(0.0);
        let place = |name: &str| format!("{key}.{name}");
        let in_init = Init::xavier(3 * width, width);
        let out_init = Init::xavier(width, width);
        Ok(Self {
            in_weight: source.trainable(&place("in_proj_weight"), &[3 * width, width], &in_init)?,
            in_bias: source.trainable(&place("in_proj_bias"), &[3 * width], &zero)?,
            out_weight: source.trainable(&place("out_proj.weight"), &[width, width], &out_init)?,
            out_bias: source.trainable(&place("out_proj.bias"), &[width], &zero)?,
            width,
            heads,
        })
    }

    /// `(batch, queries, width)`; `allowed` is `(batch, 1, 1, keys)`, true where a key may be
    /// looked at.
    pub(crate) fn forward(
        &self,
        query: &Tensor,
        key: &Tensor,
        value: &Tensor,
        allowed: Option<&Tensor>,
        dropout: f64,
    ) -> Result<Tensor, TchError> {
        // In one go: the gradient of a part alone would be one of the whole.
        let weights = self.in_weight.f_chunk(3, 0)?;
        let biases = self.in_bias.f_chunk(3, 0)?;
        let q = self.project(query, &weights[0], &biases[0])?;
        let k = self.project(key, &weights[1], &biases[1])?;
        let v = self.project(value, &weights[2], &biases[2])?;
        let mixed = Tensor::f_scaled_dot_product_attention(
            &q, &k, &v, allowed, dropout, false, None, false,
        )?;
        let joined = mixed
            .f_transpose(1, 2)?
            .f_reshape([query.size()[0], -1, self.width])?;
        joined.f_linear(&self.out_weight, Some(&self.out_bias))
    }

    /// `x` projected and split into heads.
    fn project(&self, x: &Tensor, weight: &Tensor, bias: &Tensor) -> Result<Tensor, TchError> {
        let projected = x.f_linear(weight, Some(bias))?;
        projected
            .f_view([x.size()[0], -1, self.heads, self.width / self.heads])?
            .f_transpose(1, 2)
    }
}

/// Two linear layers with ReLU between them. `W_2 relu(W_1 x + b_1) + b_2`, with dropout between
/// them in training.
#[derive(Debug)]
pub(crate) struct FeedForward {
    pub(crate) widen: Linear,
    pub(crate) narrow: Linear,
}

impl FeedForward {
    /// `key` is the layer's; the two are its `linear1` and `linear2`.
    pub(crate) fn new(
        source: &mut ParameterSource,
        key: &str,
        width: i64,
        hidden: i64,
    ) -> Result<Self, ParameterError> {
        let init = Init::xavier(width, hidden);
        Ok(Self {
            widen: Linear::with_init(source, &format!("{key}.linear1"), width, hidden, &init)?,
            narrow: Linear::with_init(source, &format!("{key}.linear2"), hidden, width, &init)?,
        })
    }

    pub(crate) fn forward(&self, x: &Tensor, dropout: f64) -> Result<Tensor, TchError> {
        self.narrow
            .forward(&drop(self.widen.forward(x)?.f_relu()?, dropout)?)
    }
}

/// Dropout with probability `p`; nothing at all if it is zero. Draws from the network library's
/// generator.
pub(crate) fn drop(x: Tensor, p: f64) -> Result<Tensor, TchError> {
    if p > 0.0 { x.f_dropout(p, true) } else { Ok(x) }
}
