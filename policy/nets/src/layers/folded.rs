//! Layers as inference runs them: made once from trained ones, with the same answers but for
//! rounding.
//!
//! What positions add to a projection is part of its bias, since a projection is linear. Values are
//! `(rows, width)`, a row for every token of every observation.

use tch::{TchError, Tensor};

use super::Attention;
use super::affine::{Affine, Backend};

/// Attention of tokens to each other.
///
/// One product gives queries, keys and values of all tokens where positions are fixed; else two.
#[derive(Debug)]
pub(crate) struct SelfAttention {
    input: Projections,
    output: Affine,
    /// Divides the width.
    heads: i64,
}

/// Projections of what sees positions and of what does not, concatenated.
#[derive(Debug)]
enum Projections {
    /// Places are always the same and part of the bias.
    Together(Affine),
    /// Places come with the tokens.
    Apart { placed: Affine, values: Affine },
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
        backend: Backend,
    ) -> Result<Self, TchError> {
        Ok(Self {
            input: Projections::new(attention, position, 0, backend)?,
            output: Affine::new(&attention.out_weight, &attention.out_bias, backend)?,
            heads: attention.heads,
        })
    }

    pub(crate) fn forward(&self, x: &Tensor, rows: Rows<'_>) -> Result<Tensor, TchError> {
        let parts = self.input.apply(x, rows)?;
        let [q, k, v] = parts.as_slice() else {
            return Err(TchError::Shape(format!("{} projections", parts.len())));
        };
        let split = |x: &Tensor| split_heads(x, rows.batch, self.heads);
        self.output
            .forward(&mix(&split(q)?, &split(k)?, &split(v)?)?)
    }
}

impl Projections {
    /// The parts of the packed projection from `first` on: 0 queries, 1 keys, 2 values. The last
    /// sees no places.
    fn new(
        attention: &Attention,
        position: Option<&Tensor>,
        first: i64,
        backend: Backend,
    ) -> Result<Self, TchError> {
        let width = attention.width;
        let layer = |first: i64, end: i64, bias: &Tensor| {
            let weight = attention
                .in_weight
                .f_narrow(0, first * width, (end - first) * width)?;
            Affine::new(&weight, bias, backend)
        };
        let Some(position) = position else {
            let bias = |first: i64, end: i64| {
                attention
                    .in_bias
                    .f_narrow(0, first * width, (end - first) * width)
            };
            return Ok(Self::Apart {
                placed: layer(first, 2, &bias(first, 2)?)?,
                values: layer(2, 3, &bias(2, 3)?)?,
            });
        };
        let parts: Vec<(i64, bool)> = (first..3).map(|part| (part, part < 2)).collect();
        let bias = placed_bias(attention, position, &parts)?;
        Ok(Self::Together(layer(first, 3, &bias)?))
    }

    /// Each part for `x` `(rows, width)`.
    fn apply(&self, x: &Tensor, rows: Rows<'_>) -> Result<Vec<Tensor>, TchError> {
        let &[_, width] = x.size().as_slice() else {
            return Err(TchError::Shape(format!("rows of {:?}", x.size())));
        };
        let split = |x: &Tensor| x.f_split(width, 1);
        match (self, rows.position) {
            (Self::Together(all), None) => split(&all.forward(x)?),
            (Self::Apart { placed, values }, Some(position)) => {
                let mut parts = split(&placed.forward(&x.f_add(position)?)?)?;
                parts.push(values.forward(x)?);
                Ok(parts)
            }
            (Self::Together(_), Some(_)) => Err(TchError::Shape("places twice".to_owned())),
            (Self::Apart { .. }, None) => Err(TchError::Shape("tokens without places".to_owned())),
        }
    }
}

/// Attention of the chunk's steps to what the encoder made.
#[derive(Debug)]
pub(crate) struct CrossAttention {
    /// To queries; their places are part of the bias.
    query: Affine,
    /// To keys and values.
    memory: Projections,
    output: Affine,
    heads: i64,
}

impl CrossAttention {
    /// `queries` `(steps, width)`: the places of the steps; `position` as for [`SelfAttention`].
    pub(crate) fn new(
        attention: &Attention,
        queries: &Tensor,
        position: Option<&Tensor>,
        backend: Backend,
    ) -> Result<Self, TchError> {
        let weight = attention.in_weight.f_narrow(0, 0, attention.width)?;
        let bias = placed_bias(attention, queries, &[(0, true)])?;
        Ok(Self {
            query: Affine::new(&weight, &bias, backend)?,
            memory: Projections::new(attention, position, 1, backend)?,
            output: Affine::new(&attention.out_weight, &attention.out_bias, backend)?,
            heads: attention.heads,
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
        let parts = self.memory.apply(memory, rows)?;
        let [k, v] = parts.as_slice() else {
            return Err(TchError::Shape(format!("{} projections", parts.len())));
        };
        let split = |x: &Tensor| split_heads(x, rows.batch, self.heads);
        self.output.forward(&mix(queries, &split(k)?, &split(v)?)?)
    }
}

/// Biases of the named parts of the packed projection, concatenated; true where a part sees the
/// places `position` `(tokens, width)`.
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

/// Values by how much queries and keys agree, as `(rows, width)`. All are
/// `(batch, heads, tokens, width of a head)`.
fn mix(q: &Tensor, k: &Tensor, v: &Tensor) -> Result<Tensor, TchError> {
    let none: Option<&Tensor> = None;
    let mixed = Tensor::f_scaled_dot_product_attention(q, k, v, none, 0.0, false, None, false)?;
    mixed.f_transpose(1, 2)?.f_flatten(2, 3)?.f_flatten(0, 1)
}
