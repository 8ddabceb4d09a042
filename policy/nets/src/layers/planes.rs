//! Convolutions on the CPU without the network library: channels last, one thread, single
//! precision.
//!
//! They are for processors with vectors of at least eight numbers and fused multiply-add; on
//! others, whoever asks uses the library's. Each number is the same sum in the same order whatever
//! the vectors' width, so processors with AVX2 and with AVX-512 give the same bits.

mod direct;
mod stem;
#[cfg(test)]
#[cfg(target_arch = "x86_64")]
mod tests;
mod tile;
mod transforms;
mod winograd;

use pulp::Simd;
use tch::{TchError, Tensor};

use super::aligned::Aligned;
use super::vectors::Processor;
use crate::dimension::{dimension, length};

pub(crate) use direct::{Direct, Steps};
pub(crate) use stem::Stem;
pub(crate) use winograd::Winograd;

/// Pictures of one size, channels last. `(batch, height, width, channels)`, row-major.
#[derive(Debug, Default)]
pub(crate) struct Plane {
    /// May be longer than the size says, after another use.
    values: Aligned,
    size: Size,
}

/// Of a [`Plane`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Size {
    batch: usize,
    height: usize,
    width: usize,
    channels: usize,
}

impl Size {
    const fn numbers(self) -> usize {
        self.batch * self.height * self.width * self.channels
    }
}

/// The processor, memory that convolutions work in, and planes that are not needed now.
#[derive(Debug)]
pub(crate) struct Workspace {
    processor: Processor,
    /// Inputs of the convolution at work, transformed or padded.
    tiles: Aligned,
    /// Products before the transform back, or rows of the stem.
    products: Aligned,
    /// Planes that were given back; the last one is used first.
    spare: Vec<Plane>,
}

/// The epilogue of a convolution: bias, residual input, ReLU.
#[derive(Clone, Copy)]
struct Epilogue<'a> {
    /// Of each channel.
    bias: &'a [f32],
    /// The residual input, added to the output.
    beside: Option<&'a [f32]>,
    rectified: bool,
}

impl Plane {
    /// Refuses to go into a convolution of other than its channels.
    fn check_channels(&self, inputs: usize) -> Result<(), TchError> {
        if self.size.channels == inputs {
            return Ok(());
        }
        let text = format!("{:?} into a convolution of {inputs} channels", self.size);
        Err(TchError::Shape(text))
    }

    /// As `(pixels of all images, channels)`, row by row.
    pub(crate) fn rows(&self) -> Result<Tensor, TchError> {
        let channels = dimension(self.size.channels);
        Tensor::f_from_slice(&self.values[..self.size.numbers()])?.f_view([-1, channels])
    }
}

impl Workspace {
    pub(crate) fn of(processor: Processor) -> Self {
        Self {
            processor,
            tiles: Aligned::default(),
            products: Aligned::default(),
            spare: Vec::new(),
        }
    }

    /// Takes back what is not needed any more.
    pub(crate) fn give_back(&mut self, plane: Plane) {
        self.spare.push(plane);
    }

    /// A plane with whatever numbers.
    fn plane(&mut self, size: Size) -> Plane {
        let mut plane = self.spare.pop().unwrap_or_default();
        plane.size = size;
        plane.values.grow(size.numbers());
        plane
    }
}

impl<'a> Epilogue<'a> {
    /// Refuses a residual input of another size than `size`.
    fn new(
        bias: &'a [f32],
        beside: Option<&'a Plane>,
        rectified: bool,
        size: Size,
    ) -> Result<Self, TchError> {
        if let Some(beside) = beside.filter(|beside| beside.size != size) {
            let text = format!("residual input {:?} for outputs {size:?}", beside.size);
            return Err(TchError::Shape(text));
        }
        Ok(Self {
            bias,
            beside: beside.map(|beside| &*beside.values),
            rectified,
        })
    }

    /// Writes the outputs from `at` on, which are of the channels from `channel` on.
    #[inline(always)]
    fn write<S: Simd>(&self, simd: S, sum: S::f32s, out: &mut [f32], at: usize, channel: usize) {
        let mut sum = simd.add_f32s(sum, load::<S>(self.bias, channel));
        if let Some(beside) = self.beside {
            sum = simd.add_f32s(sum, load::<S>(beside, at));
        }
        if self.rectified {
            // In this order NaN stays NaN.
            sum = simd.max_f32s(simd.splat_f32s(0.0), sum);
        }
        store::<S>(out, at, sum);
    }
}

#[inline(always)]
fn load<S: Simd>(from: &[f32], at: usize) -> S::f32s {
    S::as_simd_f32s(&from[at..at + S::F32_LANES]).0[0]
}

#[inline(always)]
fn store<S: Simd>(to: &mut [f32], at: usize, value: S::f32s) {
    S::as_mut_simd_f32s(&mut to[at..at + S::F32_LANES]).0[0] = value;
}

/// A convolution's bias, one number for each of its `outputs`.
fn bias_of(bias: &Tensor, outputs: usize) -> Result<Vec<f32>, TchError> {
    let numbers = Vec::<f32>::try_from(bias)?;
    if numbers.len() == outputs {
        return Ok(numbers);
    }
    let text = format!("bias {:?} of {outputs} outputs", bias.size());
    Err(TchError::Shape(text))
}

/// The lengths of a tensor's four dimensions.
fn shape_of(tensor: &Tensor) -> Result<[usize; 4], TchError> {
    let shape = tensor.size();
    let lengths = shape.iter().map(|&n| length(n));
    <[usize; 4]>::try_from(lengths.collect::<Vec<_>>())
        .map_err(|_| TchError::Shape(format!("four dimensions, not {shape:?}")))
}
