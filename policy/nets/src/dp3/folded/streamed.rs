//! Convolutions over so few steps that reading their weights bounds the time, on the CPU.
//!
//! Weights are read once for a block of up to 16 steps, so that a step more costs almost nothing;
//! inputs become the columns of a matrix, a window of the convolution each.

use tch::{TchError, Tensor};

use crate::dimension::dimension;
use crate::dp3::blocks::{Convolution, Doubling};
use crate::layers::narrow::{Columns, Narrow, Place, Windows};
use crate::layers::vectors::Processor;

/// A convolution for a fixed number of steps, from `(1, channels, steps)` to `(1, channels,
/// steps)`.
#[derive(Debug)]
pub(super) struct Streamed {
    processor: Processor,
    threads: usize,
    /// One product; of a doubling one for the even and one for the odd steps.
    parts: Vec<Part>,
    /// The residual connection's convolution, of a single tap.
    beside: Option<Part>,
    /// Its output for the last input.
    of_beside: Option<Tensor>,
    inputs: usize,
    steps: usize,
}

/// A product, the windows that make its columns, and where its outputs go.
#[derive(Debug)]
struct Part {
    weights: Narrow,
    windows: Windows,
    place: Place,
}

/// Memory that convolutions work in, one after the other.
#[derive(Debug, Default)]
pub(super) struct Workspace {
    /// The input's numbers, `(inputs, steps)`.
    x: Vec<f32>,
    columns: Columns,
    /// The outputs' numbers, `(outputs, steps)`.
    out: Vec<f32>,
}

impl Streamed {
    /// `convolution` over `steps`, and the residual connection's, of a single tap and as many
    /// outputs.
    pub(super) fn new(
        convolution: &Convolution,
        beside: Option<&Convolution>,
        steps: i64,
        (processor, threads): (Processor, usize),
    ) -> Result<Self, TchError> {
        let part = |convolution: &Convolution| {
            let weight = convolution.weight.f_detach()?;
            let [_, inputs, taps] = sizes(&weight)?;
            let (steps, stride) = (size(steps)?, size(convolution.stride)?);
            let count = (steps - 1) / stride.max(1) + 1;
            let weights = weight.f_flatten(1, 2)?;
            let part = Part {
                weights: Narrow::new(processor, &weights, &convolution.bias.f_detach()?)?,
                windows: Windows {
                    steps,
                    taps,
                    before: taps / 2,
                    stride,
                    count,
                },
                place: Place {
                    first: 0,
                    column: 1,
                    output: count,
                },
            };
            Ok::<_, TchError>((part, inputs))
        };
        let (own, inputs) = part(convolution)?;
        let beside = beside.map(part).transpose()?;
        Ok(Self {
            processor,
            threads,
            steps: own.windows.steps,
            parts: vec![own],
            beside: beside.map(|(part, _)| part),
            of_beside: None,
            inputs,
        })
    }

    /// Twice as many steps as went in.
    pub(super) fn doubling(
        doubling: &Doubling,
        steps: i64,
        (processor, threads): (Processor, usize),
    ) -> Result<Self, TchError> {
        let weight = doubling.weight.f_detach()?;
        let bias = doubling.bias.f_detach()?;
        let ([inputs, ..], steps) = (sizes(&weight)?, size(steps)?);
        let part = |taps: [i64; 2], [before, first]: [usize; 2]| {
            let taps = Tensor::f_from_slice(&taps)?;
            let matrix = weight.f_index_select(2, &taps)?.f_permute([1, 0, 2])?;
            Ok::<Part, TchError>(Part {
                weights: Narrow::new(processor, &matrix.f_flatten(1, 2)?, &bias)?,
                windows: Windows {
                    steps,
                    taps: 2,
                    before,
                    stride: 1,
                    count: steps,
                },
                place: Place {
                    first,
                    column: 2,
                    output: 2 * steps,
                },
            })
        };
        Ok(Self {
            processor,
            threads,
            // An even step gets the fourth tap of the step before and the second of its own; an odd
            // one the third of its own and the first of the one after.
            parts: vec![part([3, 1], [1, 0])?, part([2, 0], [0, 1])?],
            beside: None,
            of_beside: None,
            inputs,
            steps,
        })
    }

    /// `x` is contiguous.
    pub(super) fn apply(
        &mut self,
        x: &Tensor,
        workspace: &mut Workspace,
    ) -> Result<Tensor, TchError> {
        let Workspace {
            x: numbers,
            columns,
            out,
        } = workspace;
        numbers.resize(self.inputs * self.steps, 0.0);
        if x.numel() != numbers.len() {
            let text = format!("{:?} for {} inputs", x.size(), self.inputs);
            return Err(TchError::Shape(text));
        }
        let all = numbers.len();
        x.f_copy_data(numbers, all)?;
        let mut answer = |parts: &[Part]| {
            let mut outputs = 0;
            let mut steps = 0;
            for part in parts {
                outputs = part.weights.outputs();
                steps += part.windows.count;
            }
            out.resize(outputs * steps, 0.0);
            for part in parts {
                columns.set(self.processor, numbers, part.windows);
                part.weights.apply(columns, out, part.place, self.threads)?;
            }
            Tensor::f_from_slice(out)?.f_view([1, dimension(outputs), dimension(steps)])
        };
        let beside = self.beside.as_slice();
        self.of_beside = (!beside.is_empty()).then(|| answer(beside)).transpose()?;
        answer(&self.parts)
    }

    /// The residual connection's output for the last input.
    pub(super) const fn beside(&self) -> Option<&Tensor> {
        self.of_beside.as_ref()
    }
}

fn size(number: i64) -> Result<usize, TchError> {
    usize::try_from(number).map_err(|_| TchError::Shape(format!("{number} steps")))
}

/// Of weights with three dimensions.
fn sizes(weight: &Tensor) -> Result<[usize; 3], TchError> {
    let shape = weight.size();
    match shape.as_slice() {
        &[first, second, third] => Ok([size(first)?, size(second)?, size(third)?]),
        _ => Err(TchError::Shape(format!("weights of shape {shape:?}"))),
    }
}
