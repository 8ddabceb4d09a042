//! Convolutions over few steps as one matrix product each: what every step gives to every tap, then the sum over the taps.
//!
//! With this few steps a convolution takes as long as reading its weights. Here these lie as the product reads them.

use tch::{Kind, TchError, Tensor};

use crate::dp3::blocks::{Convolution, Doubling};

/// A convolution for a fixed number of steps, from `(channels, steps)` to `(channels, steps)`.
#[derive(Debug)]
pub(super) struct Taps {
    /// `(inputs, columns)`: the outputs of each tap, one tap beside the other, then what is asked for besides.
    weight: Tensor,
    /// `(columns)`: with the tap that meets a step for every output.
    bias: Tensor,
    /// The products, `(steps, columns)`. In memory there are rows of zeros around them that nobody writes to.
    written: Tensor,
    /// The products by output and tap, the taps last.
    terms: Tensor,
    /// Those of the convolution beside, `(outputs, steps)`.
    beside: Option<Tensor>,
    outputs: i64,
}

impl Taps {
    /// `convolution` over `steps`, and one of a single tap and as many outputs beside it.
    pub(super) fn new(
        convolution: &Convolution,
        beside: Option<&Convolution>,
        steps: i64,
        kind: Kind,
    ) -> Result<Self, TchError> {
        let weight = convolution.weight.f_detach()?;
        let size = weight.size();
        let &[outputs, inputs, taps] = size.as_slice() else {
            return Err(TchError::Shape(format!("weights of shape {size:?}")));
        };
        let mut blocks = vec![weight.f_permute([1, 2, 0])?.f_reshape([inputs, -1])?];
        let mut biases = vec![bias_at(&convolution.bias, &[taps / 2], taps)?];
        if let Some(beside) = beside {
            blocks.push(
                beside
                    .weight
                    .f_detach()?
                    .f_squeeze_dim(2)?
                    .f_transpose(0, 1)?,
            );
            biases.push(beside.bias.f_detach()?);
        }
        let columns = biases.iter().map(|bias| bias.size()[0]).sum::<i64>();
        let around = taps / 2;
        let products = products([steps, around, columns], &weight, kind)?;
        let stride = convolution.stride;
        let steps_after = (steps + 2 * around - taps) / stride + 1;
        let terms = products.f_as_strided(
            [outputs, steps_after, taps],
            [1, stride * columns, columns + outputs],
            0,
        )?;
        let beside = match beside {
            Some(_) => {
                let first = around * columns + taps * outputs;
                Some(products.f_as_strided([outputs, steps], [1, columns], first)?)
            }
            None => None,
        };
        Ok(Self {
            weight: Tensor::f_cat(&blocks, 1)?.f_to_kind(kind)?.f_contiguous()?,
            bias: Tensor::f_cat(&biases, 0)?.f_to_kind(kind)?,
            written: products.f_narrow(0, around, steps)?,
            terms,
            beside,
            outputs,
        })
    }

    /// Twice as many steps as went in.
    pub(super) fn doubling(doubling: &Doubling, steps: i64, kind: Kind) -> Result<Self, TchError> {
        let weight = doubling.weight.f_detach()?;
        let size = weight.size();
        let &[inputs, outputs, _] = size.as_slice() else {
            return Err(TchError::Shape(format!("weights of shape {size:?}")));
        };
        // An even step gets the step's second tap and the fourth of the one before; an odd one the third, and the first of
        // the one after.
        let order = Tensor::f_from_slice(&[3_i64, 1, 2, 0])?.f_to_device(weight.device())?;
        let ordered = weight.f_index_select(2, &order)?.f_permute([0, 2, 1])?;
        let columns = 4 * outputs;
        let products = products([steps, 1, columns], &weight, kind)?;
        Ok(Self {
            weight: ordered
                .f_reshape([inputs, -1])?
                .f_to_kind(kind)?
                .f_contiguous()?,
            bias: bias_at(&doubling.bias, &[1, 2], 4)?.f_to_kind(kind)?,
            written: products.f_narrow(0, 1, steps)?,
            terms: products.f_as_strided(
                [outputs, steps, 2, 2],
                [1, columns, columns + 2 * outputs, columns + outputs],
                0,
            )?,
            beside: None,
            outputs,
        })
    }

    /// `(channels, steps)` in single precision, whatever the weights have.
    pub(super) fn apply(&mut self, x: &Tensor) -> Result<Tensor, TchError> {
        let rows = x.f_to_kind(self.weight.kind())?.f_transpose(0, 1)?;
        let _written = self.bias.f_addmm_out(&self.written, &rows, &self.weight)?;
        self.terms
            .f_sum_dim_intlist([-1].as_slice(), false, Kind::Float)?
            .f_view([self.outputs, -1])
    }

    /// What the convolution beside makes of what was last applied to; overwritten by the next.
    pub(super) const fn beside(&self) -> Option<&Tensor> {
        self.beside.as_ref()
    }
}

/// Zeros for `steps` and so many rows on both sides.
fn products(
    [steps, around, columns]: [i64; 3],
    like: &Tensor,
    kind: Kind,
) -> Result<Tensor, TchError> {
    Tensor::f_zeros([steps + 2 * around, columns], (kind, like.device()))
}

/// `bias` at those of `taps` that are named, zeros at the others, one tap beside the other.
fn bias_at(bias: &Tensor, named: &[i64], taps: i64) -> Result<Tensor, TchError> {
    let bias = bias.f_detach()?;
    let zeros = bias.f_zeros_like()?;
    let rows: Vec<&Tensor> = (0..taps)
        .map(|tap| if named.contains(&tap) { &bias } else { &zeros })
        .collect();
    Tensor::f_cat(&rows, 0)
}
