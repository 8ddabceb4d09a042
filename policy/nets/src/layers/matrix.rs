//! GEMM on the CPU without libtorch: one thread, single precision.
//!
//! Weights are packed once in the order in which the kernel reads them, and bias and ReLU are its
//! epilogue. Each number is the same sum in the same order whatever the processor's vectors: sums
//! over parts of the inputs, added up one after the other.

use tch::{TchError, Tensor};

use super::aligned::Aligned;
use super::kernel::{InRegisters, PANEL, Summing, Sums, accumulate, panels, share};
use super::memory;
use super::vectors::{Processor, Vectors};
use crate::dimension::{dimension, length};

/// Inputs that are summed on their own before they are added to the others', so that fewer bits are
/// lost and the weights of a panel stay in the second-level cache.
const DEPTH: usize = 512;

/// Rows whose inputs stay in the second-level cache.
const ROWS_AT_ONCE: usize = 264;

/// So few rows are done on their own.
const FEW: usize = 2;

/// A matrix `(inputs, outputs)`.
#[derive(Debug)]
pub(crate) struct Matrix {
    processor: Processor,
    /// For each [`DEPTH`] inputs, for each panel of outputs: `(inputs, outputs of a panel)`.
    weight: Aligned,
    inputs: usize,
    outputs: usize,
}

/// The epilogue: the bias of each output, and whether ReLU follows.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Epilogue<'a> {
    /// `(outputs)`, or `(rows, outputs)` of as many rows as often as they go into all.
    pub(crate) bias: &'a [f32],
    pub(crate) rectified: bool,
}

impl Matrix {
    /// Whether `weight` `(outputs, inputs)` is of whole panels.
    pub(crate) fn fits(weight: &Tensor) -> bool {
        const PANEL_OUTPUTS: i64 = dimension(PANEL);
        matches!(weight.size().as_slice(), &[outputs, inputs] if inputs > 0 && outputs > 0 && outputs % PANEL_OUTPUTS == 0)
    }

    /// `weight` is `(outputs, inputs)`.
    pub(crate) fn new(processor: Processor, weight: &Tensor) -> Result<Self, TchError> {
        let shape = weight.size();
        let &[outputs, inputs] = shape.as_slice() else {
            return Err(TchError::Shape(format!("weight {shape:?}")));
        };
        if !Self::fits(weight) {
            return Err(TchError::Shape(format!("weight {shape:?}")));
        }
        let mut numbers = Vec::with_capacity(length(outputs) * length(inputs));
        for first in (0..inputs).step_by(DEPTH) {
            let depth = (inputs - first).min(dimension(DEPTH));
            let part = weight.f_narrow(1, first, depth)?;
            numbers.extend(panels(&part, &[0, 2, 1])?);
        }
        Ok(Self {
            processor,
            weight: Aligned::of(&numbers),
            inputs: length(inputs),
            outputs: length(outputs),
        })
    }

    /// `x` `(rows, inputs)`, contiguous, by the matrix, with the epilogue: `(rows, outputs)`.
    pub(crate) fn apply(&self, x: &Tensor, after: Epilogue<'_>) -> Result<Tensor, TchError> {
        let shape = x.size();
        let rows = match shape.as_slice() {
            &[rows, inputs] if length(inputs) == self.inputs => length(rows),
            _ => {
                let text = format!("{shape:?} into {} inputs", self.inputs);
                return Err(TchError::Shape(text));
            }
        };
        let bias_rows = after.bias.len() / self.outputs;
        let whole = bias_rows > 0 && bias_rows * self.outputs == after.bias.len();
        if !whole || !rows.is_multiple_of(bias_rows) {
            let text = format!("bias of {} for {rows} rows", after.bias.len());
            return Err(TchError::Shape(text));
        }
        let x = memory::numbers(x)?;
        memory::filled([rows, self.outputs], |out| {
            self.processor.run(InRegisters(Gemm {
                matrix: self,
                x,
                after,
                out,
            }));
        })
    }
}

/// One product.
///
/// Loops, from outside: blocks of rows, parts of the inputs, panels of outputs, groups of rows; so
/// a panel's weights are read from memory once for a block of rows.
struct Gemm<'a> {
    matrix: &'a Matrix,
    x: &'a [f32],
    after: Epilogue<'a>,
    out: &'a mut [f32],
}

impl Summing for Gemm<'_> {
    #[inline(always)]
    fn run<V: Vectors, const ROWS: usize, const VECTORS: usize>(mut self, simd: V) {
        let &Matrix {
            ref weight,
            inputs,
            outputs,
            ..
        } = self.matrix;
        let rows = self.x.len() / inputs;
        for block in (0..rows).step_by(ROWS_AT_ONCE) {
            let end = rows.min(block + ROWS_AT_ONCE);
            let groups = (end - block).div_ceil(ROWS);
            for first in (0..inputs).step_by(DEPTH) {
                let depth = DEPTH.min(inputs - first);
                let size = depth * PANEL;
                for panel in 0..outputs / PANEL {
                    let at = first * outputs + panel * size;
                    let (panel_weight, mut rest) = weight[at..].split_at(size);
                    if rest.is_empty() && end < rows {
                        rest = weight;
                    }
                    let next = &rest[..rest.len().min(size)];
                    for group in 0..groups {
                        let place = Place {
                            row: block + group * ROWS,
                            end,
                            input: first,
                            panel,
                        };
                        let ahead = share(next, group, groups);
                        if place.row + FEW < place.end {
                            self.group::<V, ROWS, VECTORS>(simd, panel_weight, &place, ahead);
                        } else {
                            self.group::<V, FEW, VECTORS>(simd, panel_weight, &place, ahead);
                        }
                    }
                }
            }
        }
    }
}

/// Where in a product some rows are.
struct Place {
    /// The first row of the group.
    row: usize,
    /// One behind the last row that counts.
    end: usize,
    /// The first input of the part.
    input: usize,
    /// The number of the panel.
    panel: usize,
}

impl Gemm<'_> {
    /// Some rows by the `weight` of a panel.
    #[inline(always)]
    fn group<V: Vectors, const ROWS: usize, const VECTORS: usize>(
        &mut self,
        simd: V,
        weight: &[f32],
        place: &Place,
        ahead: &[f32],
    ) {
        let inputs = self.matrix.inputs;
        let depth = weight.len() / PANEL;
        // Behind the last row it is that one again.
        let rows = std::array::from_fn(|row| {
            let row = (place.row + row).min(place.end - 1);
            &self.x[row * inputs + place.input..][..depth]
        });
        let zeros = [[simd.splat_f32s(0.0); VECTORS]; ROWS];
        let sums = accumulate(simd, zeros, weight, rows, ahead);
        self.put(simd, &sums, place, place.input + depth);
    }

    /// Adds the sums over the inputs from the place's to before `end` to the outputs.
    #[inline(always)]
    fn put<V: Vectors, const ROWS: usize, const VECTORS: usize>(
        &mut self,
        simd: V,
        sums: &Sums<V, ROWS, VECTORS>,
        place: &Place,
        end: usize,
    ) {
        let &Matrix {
            inputs, outputs, ..
        } = self.matrix;
        let column = place.panel * PANEL;
        for (row, sums) in (place.row..place.end).zip(sums) {
            let at = row * outputs + column;
            let (out, _) = V::as_mut_simd_f32s(&mut self.out[at..at + PANEL]);
            for (out, sum) in out.iter_mut().zip(sums) {
                *out = if place.input == 0 {
                    *sum
                } else {
                    simd.add_f32s(*out, *sum)
                };
            }
            if end == inputs {
                self.finish(simd, row, column);
            }
        }
    }

    /// The epilogue of a panel of a row.
    #[inline(always)]
    fn finish<V: Vectors>(&mut self, simd: V, row: usize, column: usize) {
        let outputs = self.matrix.outputs;
        let Epilogue { bias, rectified } = self.after;
        let bias = &bias[row * outputs % bias.len() + column..][..PANEL];
        let (bias, _) = V::as_simd_f32s(bias);
        let (out, _) = V::as_mut_simd_f32s(&mut self.out[row * outputs + column..][..PANEL]);
        for (out, bias) in out.iter_mut().zip(bias) {
            let sum = simd.add_f32s(*out, *bias);
            // In this order NaN stays NaN.
            *out = if rectified {
                simd.max_f32s(simd.splat_f32s(0.0), sum)
            } else {
                sum
            };
        }
    }
}

#[cfg(test)]
#[cfg(target_arch = "x86_64")]
mod tests;
