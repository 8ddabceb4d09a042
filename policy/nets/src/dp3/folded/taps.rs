//! Convolutions over few steps as one matrix product each: what every step gives to every tap, then
//! the sum over the taps.
//!
//! With this few steps a convolution takes as long as reading its weights. Here these lie as the
//! product reads them: on the CPU in blocks of outputs, each of which is one stretch of memory;
//! elsewhere, and for few outputs, the inputs of each output together, and those of each step too.

use tch::{Device, Kind, TchError, Tensor};

use crate::dp3::blocks::{Convolution, Doubling};

/// A convolution for a fixed number of steps, from `(1, channels, steps)` to `(1, channels,
/// steps)`.
#[derive(Debug)]
pub(super) struct Taps {
    /// `(blocks, inputs, columns of a block)`; without the first dimension if there is one block,
    /// whose columns are then stretches of memory. The columns are the outputs of each tap, one tap
    /// after the other, then those of the residual convolution.
    weight: Tensor,
    /// `(blocks, 1, columns of a block)`, or `(columns)`: with the tap that meets a step for every
    /// output.
    bias: Tensor,
    /// The products, `(blocks, steps, columns of a block)`, or without the first dimension. In
    /// memory there are rows of zeros around the steps of each block, which stay zero.
    written: Tensor,
    /// The products by output and tap, the taps last.
    terms: Tensor,
    /// Those of the residual connection, by output and step.
    beside: Option<Tensor>,
    kind: Kind,
    inputs: i64,
    outputs: i64,
    steps: i64,
}

/// What makes up [`Taps`].
struct Parts {
    /// `(inputs, columns)`.
    weight: Tensor,
    /// `(columns)`.
    bias: Tensor,
    terms: Tensor,
    beside: Option<Tensor>,
    /// From the first row of zeros on.
    products: Tensor,
    around: i64,
    steps: i64,
}

/// Where the products lie in memory.
#[derive(Clone, Copy)]
struct Layout {
    /// Steps, and the rows of zeros before and after them.
    rows: i64,
    columns: i64,
    outputs: i64,
    /// Columns of a block.
    block: i64,
}

impl Layout {
    /// On the CPU blocks are as wide as measured to be read fastest; elsewhere there is one.
    fn new(rows: i64, columns: i64, outputs: i64, device: Device) -> Self {
        let fits = |block: &i64| device == Device::Cpu && outputs % block == 0;
        let block = [256, 128].into_iter().find(fits).unwrap_or(columns);
        Self {
            rows,
            columns,
            outputs,
            block,
        }
    }

    /// From a product to that of the next tap.
    const fn tap(self) -> i64 {
        if self.block == self.columns {
            self.outputs
        } else {
            // Whole blocks lie between.
            self.outputs * self.rows
        }
    }

    /// The outputs as one dimension or two, and their strides.
    const fn outputs(self) -> [[i64; 2]; 2] {
        let Self {
            rows,
            outputs,
            block,
            ..
        } = self;
        if block == self.columns {
            [[1, outputs], [outputs, 1]]
        } else {
            [[outputs / block, block], [rows * block, 1]]
        }
    }

    /// A view of `products` by output and the given further sizes and strides, from `offset` on.
    fn view<const N: usize>(
        self,
        products: &Tensor,
        sizes: [i64; N],
        strides: [i64; N],
        offset: i64,
    ) -> Result<Tensor, TchError> {
        let [of_outputs, apart] = self.outputs();
        products.f_as_strided(
            [&of_outputs[..], &sizes].concat(),
            [&apart[..], &strides].concat(),
            offset,
        )
    }

    /// `(rows of `matrix`, columns)` as `(blocks, rows, columns of a block)`.
    fn blocked(self, matrix: &Tensor, kind: Kind) -> Result<Tensor, TchError> {
        matrix
            .f_unflatten(1, [self.columns / self.block, self.block])?
            .f_transpose(0, 1)?
            .f_to_kind(kind)?
            .f_contiguous()
    }

    fn zeros(self, like: &Tensor, kind: Kind) -> Result<Tensor, TchError> {
        let blocks = self.columns / self.block;
        Tensor::f_zeros([blocks, self.rows, self.block], (kind, like.device()))
    }
}

impl Taps {
    /// `convolution` over `steps`, and the residual connection's, of a single tap and as many
    /// outputs.
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
            let weight = beside.weight.f_detach()?;
            blocks.push(weight.f_squeeze_dim(2)?.f_transpose(0, 1)?);
            biases.push(beside.bias.f_detach()?);
        }
        let (weight, bias) = (Tensor::f_cat(&blocks, 1)?, Tensor::f_cat(&biases, 0)?);
        let around = taps / 2;
        let columns = bias.size()[0];
        let layout = Layout::new(steps + 2 * around, columns, outputs, weight.device());
        let products = layout.zeros(&weight, kind)?;
        let (row, tap, stride) = (layout.block, layout.tap(), convolution.stride);
        let steps_after = (steps + 2 * around - taps) / stride + 1;
        let besides = beside.map(|_| {
            let first = around * row + taps * tap;
            layout.view(&products, [steps], [row], first)
        });
        let parts = Parts {
            terms: layout.view(&products, [steps_after, taps], [stride * row, tap + row], 0)?,
            beside: besides.transpose()?,
            weight,
            bias,
            products,
            around,
            steps,
        };
        Self::of(parts, layout, kind)
    }

    /// Twice as many steps as went in.
    pub(super) fn doubling(doubling: &Doubling, steps: i64, kind: Kind) -> Result<Self, TchError> {
        let weight = doubling.weight.f_detach()?;
        let size = weight.size();
        let &[inputs, outputs, _] = size.as_slice() else {
            return Err(TchError::Shape(format!("weights of shape {size:?}")));
        };
        // An even step gets the step's second tap and the fourth of the one before; an odd one the
        // third, and the first of the one after.
        let order = Tensor::f_from_slice(&[3_i64, 1, 2, 0])?.f_to_device(weight.device())?;
        let ordered = weight.f_index_select(2, &order)?.f_permute([0, 2, 1])?;
        let layout = Layout::new(steps + 2, 4 * outputs, outputs, weight.device());
        let products = layout.zeros(&weight, kind)?;
        let (row, tap) = (layout.block, layout.tap());
        let parts = Parts {
            terms: layout.view(&products, [steps, 2, 2], [row, row + 2 * tap, row + tap], 0)?,
            beside: None,
            weight: ordered.f_reshape([inputs, -1])?,
            bias: bias_at(&doubling.bias, &[1, 2], 4)?,
            products,
            around: 1,
            steps,
        };
        Self::of(parts, layout, kind)
    }

    fn of(parts: Parts, layout: Layout, kind: Kind) -> Result<Self, TchError> {
        let Parts {
            weight,
            bias,
            terms,
            beside,
            products,
            around,
            steps,
        } = parts;
        let inputs = weight.size()[0];
        let one = layout.block == layout.columns;
        let flat = |tensor: Tensor| {
            if one {
                tensor.f_squeeze_dim(0)
            } else {
                Ok(tensor)
            }
        };
        let bias = layout.blocked(&bias.f_unsqueeze(0)?, kind)?;
        let mut weight = flat(layout.blocked(&weight, kind)?)?;
        if one {
            let columns = weight.f_transpose(0, 1)?.f_contiguous()?;
            weight = columns.f_transpose(0, 1)?;
        }
        Ok(Self {
            weight,
            bias: if one { bias.f_view([-1])? } else { bias },
            written: flat(products.f_narrow(1, around, steps)?)?,
            terms,
            beside,
            kind,
            inputs,
            outputs: layout.outputs,
            steps,
        })
    }

    /// The answer is in single precision, whatever the weights have, and contiguous.
    pub(super) fn apply(&mut self, x: &Tensor) -> Result<Tensor, TchError> {
        // Few calls into the network library: on an accelerator they are what takes the time.
        let rows = x.f_view([self.inputs, self.steps])?.f_transpose(0, 1)?;
        let rows = if self.kind == Kind::Float {
            rows
        } else {
            rows.f_to_kind(self.kind)?
        };
        let _written = if self.is_one() {
            let rows = rows.f_contiguous()?;
            self.bias.f_addmm_out(&self.written, &rows, &self.weight)?
        } else {
            let blocks = self.weight.size()[0];
            let rows = rows.f_expand([blocks, self.steps, self.inputs], false)?;
            self.bias
                .f_baddbmm_out(&self.written, &rows, &self.weight)?
        };
        self.terms
            .f_sum_dim_intlist([-1].as_slice(), false, Kind::Float)?
            .f_view([1, self.outputs, -1])
    }

    /// `x` after Mish, as convolutions like this one read it.
    pub(super) fn activated(&self, mut x: Tensor) -> Result<Tensor, TchError> {
        let size = x.size();
        match size.as_slice() {
            &[batch, channels, steps] if self.is_one() => {
                let strides = [channels * steps, 1, channels];
                let options = (x.kind(), x.device());
                let out = Tensor::f_empty_strided([batch, channels, steps], strides, options)?;
                x.f_mish_out(&out)
            }
            _ => x.f_mish_(),
        }
    }

    /// Whether the columns are one block.
    fn is_one(&self) -> bool {
        self.weight.dim() == 2
    }

    /// Adds the residual connection to `out`: its convolution's output for the last input, or `x`
    /// without one.
    pub(super) fn add_beside(&self, mut out: Tensor, x: &Tensor) -> Result<Tensor, TchError> {
        match &self.beside {
            Some(beside) => {
                let _sum = out.f_view(beside.size().as_slice())?.f_add_(beside)?;
                Ok(out)
            }
            None => out.f_add_(x),
        }
    }
}

/// `bias` at those of `taps` that are named, zeros at the others, one tap after the other.
fn bias_at(bias: &Tensor, named: &[i64], taps: i64) -> Result<Tensor, TchError> {
    let bias = bias.f_detach()?;
    let zeros = bias.f_zeros_like()?;
    let rows: Vec<&Tensor> = (0..taps)
        .map(|tap| if named.contains(&tap) { &bias } else { &zeros })
        .collect();
    Tensor::f_cat(&rows, 0)
}
