//! Products of a big matrix of weights with few columns, on the CPU: bound by reading the weights.
//!
//! Weights all of which are numbers of half precision lie in memory as such and are widened in
//! registers, exactly; others lie there in single precision. The arithmetic is the same: in single
//! precision, for each output one sum over the rows in their order, each product fused with its
//! addition. Weights are packed in panels of 16 outputs; several panels are read at once, since a
//! core reads several streams faster than one. Needs AVX2 and FMA or AVX-512; other processors use
//! libtorch.

mod columns;
mod kernel;
#[cfg(test)]
#[cfg(target_arch = "x86_64")]
mod tests;
mod weights;

use std::thread;

use tch::{TchError, Tensor};

use super::vectors::Processor;
use crate::dimension::{dimension, length};
pub(crate) use columns::{Columns, Windows};
use kernel::{Gemm, To};
use weights::{Bf16, F16, F32, Stored, Weights};

/// Outputs of a panel.
const PANEL: usize = 16;

/// The most panels that are read at once.
const TOGETHER: usize = 4;

/// Bytes of weights for which a thread pays. Starting one takes longer than reading fewer.
const WORTH_A_THREAD: usize = 1 << 19;

/// A matrix of weights, `(outputs, rows)`, and a bias for each output.
#[derive(Debug)]
pub(crate) struct Narrow {
    processor: Processor,
    /// In panels, in the narrowest type that holds all of them exactly.
    weights: Weights,
    /// `(outputs)`; its length says how many outputs count of the last panel.
    bias: Vec<f32>,
    /// Inputs of the product: for a convolution inputs times taps.
    rows: usize,
}

/// Where outputs go: the first, and how far apart those of a column and of the next are, and an
/// output and the next.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    pub(crate) first: usize,
    pub(crate) column: usize,
    pub(crate) output: usize,
}

impl Narrow {
    /// `matrix` is `(outputs, rows)`, with a row at least, `bias` `(outputs)`.
    pub(crate) fn new(
        processor: Processor,
        matrix: &Tensor,
        bias: &Tensor,
    ) -> Result<Self, TchError> {
        let bias = Vec::<f32>::try_from(bias)?;
        let shape = matrix.size();
        let outputs = dimension(bias.len());
        let rows = match shape.as_slice() {
            &[of_matrix, rows] if of_matrix == outputs && rows > 0 => length(rows),
            _ => {
                let text = format!("weights {shape:?} of {outputs} outputs");
                return Err(TchError::Shape(text));
            }
        };
        let values = Vec::<f32>::try_from(&matrix.f_contiguous()?.f_view([-1])?)?;
        Ok(Self {
            processor,
            weights: Weights::new(&values, rows),
            bias,
            rows,
        })
    }

    pub(crate) const fn outputs(&self) -> usize {
        self.bias.len()
    }

    /// The matrix by `columns`, and the bias, to where `place` says in `out`, on at most `threads`;
    /// their number changes no bit.
    pub(crate) fn apply(
        &self,
        columns: &Columns,
        out: &mut [f32],
        place: Place,
        threads: usize,
    ) -> Result<(), TchError> {
        let (count, outputs) = (columns.count(), self.outputs());
        if columns.rows() != self.rows {
            let text = format!("{} rows for {}", columns.rows(), self.rows);
            return Err(TchError::Shape(text));
        }
        if count == 0 || outputs == 0 {
            return Ok(());
        }
        let of_output = (count - 1) * place.column + 1;
        let needed = place.first + (outputs - 1) * place.output + of_output;
        if needed > out.len() || of_output > place.output {
            let text = format!("{place:?} in {} numbers", out.len());
            return Err(TchError::Shape(text));
        }
        let out = &mut out[place.first..];
        match &self.weights {
            Weights::F16(panels) => self.shared::<F16>(panels, columns, out, (place, threads)),
            Weights::Bf16(panels) => self.shared::<Bf16>(panels, columns, out, (place, threads)),
            Weights::F32(panels) => self.shared::<F32>(panels, columns, out, (place, threads)),
        }
    }

    /// Shares of all panels, each on a thread of its own. `out` begins with the first output.
    ///
    /// The first share runs on the caller's thread, the others on threads that live for this call.
    fn shared<T: Stored>(
        &self,
        panels: &[T],
        columns: &Columns,
        out: &mut [f32],
        (place, threads): (Place, usize),
    ) -> Result<(), TchError> {
        let most = size_of_val(panels) / WORTH_A_THREAD;
        let share = (panels.len() / self.rows)
            .div_ceil(threads.min(most).max(1))
            .next_multiple_of(TOGETHER);
        let shares = panels
            .chunks(share * self.rows)
            .zip(self.bias.chunks(share * PANEL))
            .zip(out.chunks_mut(share * PANEL * place.output))
            .map(|((panels, bias), out)| (panels, To { bias, out, place }));
        thread::scope(|scope| {
            let mut own = None;
            for (panels, to) in shares {
                if own.is_none() {
                    own = Some((panels, to));
                } else {
                    let work = move || {
                        self.processor.run(Gemm {
                            panels,
                            columns,
                            to,
                        })
                    };
                    thread::Builder::new().spawn_scoped(scope, work)?;
                }
            }
            if let Some((panels, to)) = own {
                self.processor.run(Gemm {
                    panels,
                    columns,
                    to,
                });
            }
            Ok(())
        })
    }
}
