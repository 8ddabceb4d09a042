//! Layers as inference runs them: made once from trained ones, with the same answers but for rounding.
//!
//! Matrices lie with their inputs first, so that the product reads them as they are. What positions add to a projection is
//! part of its bias, since a projection is linear. Values are `(rows, width)`, a row for every token of every observation.

use tch::{Kind, TchError, Tensor};

use super::{Attention, Linear};

/// A linear layer whose bias may differ from row to row.
#[derive(Debug)]
pub(crate) struct Affine {
    /// `(inputs, outputs)`.
    weight: Tensor,
    /// `(outputs)` or `(rows of one observation, outputs)`.
    bias: Tensor,
}

impl Affine {
    /// `weight` `(outputs, inputs)` and `bias` in the precision `kind`.
    pub(crate) fn new(weight: &Tensor, bias: &Tensor, kind: Kind) -> Result<Self, TchError> {
        let weight = weight.f_detach()?.f_to_kind(kind)?;
        Ok(Self {
            weight: weight.f_transpose(0, 1)?.f_contiguous()?,
            bias: bias.f_detach()?.f_to_kind(kind)?.f_contiguous()?,
        })
    }

    pub(crate) fn of(linear: &Linear, kind: Kind) -> Result<Self, TchError> {
        Self::new(&linear.weight, &linear.bias, kind)
    }

    pub(crate) fn forward(&self, x: &Tensor) -> Result<Tensor, TchError> {
        self.bias_of(x)?.f_addmm(x, &self.weight)
    }

    /// Followed by a rectifier.
    pub(crate) fn rectified(&self, x: &Tensor) -> Result<Tensor, TchError> {
        // tch 0.24 hands the flag of the fused `_addmm_activation` to the parameter `beta`, so two steps.
        self.forward(x)?.f_relu_()
    }

    /// Outputs from `first` on, `count` of them.
    fn part(&self, x: &Tensor, first: i64, count: i64) -> Result<Tensor, TchError> {
        let bias = self.bias_of(x)?.f_narrow(-1, first, count)?;
        bias.f_addmm(x, &self.weight.f_narrow(1, first, count)?)
    }

    /// The bias as often as there are observations.
    fn bias_of(&self, x: &Tensor) -> Result<Tensor, TchError> {
        let rows = x.size()[0];
        match self.bias.size().as_slice() {
            &[own, _] if own != rows => self.bias.f_repeat([rows / own.max(1), 1]),
            _ => Ok(self.bias.shallow_clone()),
        }
    }
}

/// Attention of tokens to each other.
#[derive(Debug)]
pub(crate) struct SelfAttention {
    /// To queries, keys and values, one beside the other.
    input: Affine,
    output: Affine,
    width: i64,
    heads: i64,
}

/// What attention needs to know about its input.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rows<'a> {
    /// Observations; each has as many rows.
    pub(crate) batch: i64,
    /// Where the tokens are, if building did not know it: `(rows, width)`.
    pub(crate) position: Option<&'a Tensor>,
}

impl SelfAttention {
    /// `position` `(tokens, width)` if it is always the same.
    pub(crate) fn new(
        attention: &Attention,
        position: Option<&Tensor>,
        kind: Kind,
    ) -> Result<Self, TchError> {
        let Attention { width, heads, .. } = *attention;
        let bias = match position {
            Some(position) => {
                placed_bias(attention, position, &[(0, true), (1, true), (2, false)])?
            }
            None => attention.in_bias.shallow_clone(),
        };
        Ok(Self {
            input: Affine::new(&attention.in_weight, &bias, kind)?,
            output: Affine::new(&attention.out_weight, &attention.out_bias, kind)?,
            width,
            heads,
        })
    }

    pub(crate) fn forward(&self, x: &Tensor, rows: Rows<'_>) -> Result<Tensor, TchError> {
        let width = self.width;
        let [q, k, v] = if let Some(position) = rows.position {
            let located = self.input.part(&x.f_add(position)?, 0, 2 * width)?;
            let values = self.input.part(x, 2 * width, width)?;
            [
                located.f_narrow(1, 0, width)?,
                located.f_narrow(1, width, width)?,
                values,
            ]
        } else {
            let all = self.input.forward(x)?;
            let part = |index: i64| all.f_narrow(1, index * width, width);
            [part(0)?, part(1)?, part(2)?]
        };
        let split = |x: &Tensor| split_heads(x, rows.batch, self.heads);
        let mixed = mix(&split(&q)?, &split(&k)?, &split(&v)?)?;
        self.output.forward(&mixed)
    }
}

/// Attention of the chunk's steps to what the encoder made.
#[derive(Debug)]
pub(crate) struct CrossAttention {
    /// To queries; their places are part of the bias.
    query: Affine,
    /// To keys and values, one beside the other.
    memory: Affine,
    output: Affine,
    width: i64,
    heads: i64,
}

impl CrossAttention {
    /// `queries` `(steps, width)`: the places of the steps; `position` as for [`SelfAttention`].
    pub(crate) fn new(
        attention: &Attention,
        queries: &Tensor,
        position: Option<&Tensor>,
        kind: Kind,
    ) -> Result<Self, TchError> {
        let Attention { width, heads, .. } = *attention;
        let query = placed_bias(attention, queries, &[(0, true)])?;
        let memory = match position {
            Some(position) => placed_bias(attention, position, &[(1, true), (2, false)])?,
            None => attention.in_bias.f_narrow(0, width, 2 * width)?,
        };
        let weight = |first: i64, count: i64| attention.in_weight.f_narrow(0, first, count);
        Ok(Self {
            query: Affine::new(&weight(0, width)?, &query, kind)?,
            memory: Affine::new(&weight(width, 2 * width)?, &memory, kind)?,
            output: Affine::new(&attention.out_weight, &attention.out_bias, kind)?,
            width,
            heads,
        })
    }

    /// The queries of `x` `(rows, width)`, `(batch, heads, steps, width of a head)`.
    pub(crate) fn queries(&self, x: &Tensor, batch: i64) -> Result<Tensor, TchError> {
        split_heads(&self.query.forward(x)?, batch, self.heads)
    }

    /// What `queries` find in `memory` `(rows, width)`.
    pub(crate) fn forward(
        &self,
        queries: &Tensor,
        memory: &Tensor,
        rows: Rows<'_>,
    ) -> Result<Tensor, TchError> {
        let width = self.width;
        let [k, v] = if let Some(position) = rows.position {
            let located = memory.f_add(position)?;
            [
                self.memory.part(&located, 0, width)?,
                self.memory.part(memory, width, width)?,
            ]
        } else {
            let all = self.memory.forward(memory)?;
            [all.f_narrow(1, 0, width)?, all.f_narrow(1, width, width)?]
        };
        let split = |x: &Tensor| split_heads(x, rows.batch, self.heads);
        self.output
            .forward(&mix(queries, &split(&k)?, &split(&v)?)?)
    }
}

/// Biases of the named parts of the packed projection, one beside the other; true where a part sees the places
/// `position` `(tokens, width)`.
fn placed_bias(
    attention: &Attention,
    position: &Tensor,
    parts: &[(i64, bool)],
) -> Result<Tensor, TchError> {
    let width = attention.width;
    let rows = position.size()[0];
    let biases = parts.iter().map(|&(part, placed)| {
        let bias = attention.in_bias.f_narrow(0, part * width, width)?;
        if placed {
            let weight = attention.in_weight.f_narrow(0, part * width, width)?;
            position.f_linear(&weight, Some(&bias))
        } else {
            bias.f_unsqueeze(0)?.f_expand([rows, width], false)
        }
    });
    Tensor::f_cat(&biases.collect::<Result<Vec<_>, _>>()?, 1)
}

/// `(rows, width)` to `(batch, heads, tokens, width of a head)`, without a copy.
fn split_heads(x: &Tensor, batch: i64, heads: i64) -> Result<Tensor, TchError> {
    let size = x.size();
    let [rows, width] = size.as_slice() else {
        return Err(TchError::Shape(format!("tokens {size:?}")));
    };
    let tokens = rows / batch.max(1);
    x.f_unflatten(0, [batch, tokens])?
        .f_unflatten(2, [heads, width / heads.max(1)])?
        .f_transpose(1, 2)
}

/// Values by how much queries and keys agree, as `(rows, width)`.
fn mix(q: &Tensor, k: &Tensor, v: &Tensor) -> Result<Tensor, TchError> {
    let none: Option<&Tensor> = None;
    let mixed = Tensor::f_scaled_dot_product_attention(q, k, v, none, 0.0, false, None, false)?;
    mixed.f_transpose(1, 2)?.f_flatten(2, 3)?.f_flatten(0, 1)
}
