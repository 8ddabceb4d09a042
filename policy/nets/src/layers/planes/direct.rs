//! Convolutions tap by tap: of any stride, and of images that are too small for tiles.

use tch::{TchError, Tensor};

use super::{Epilogue, Plane, Size, Workspace, bias_of, shape_of};
use crate::layers::aligned::Aligned;
use crate::layers::kernel::{InRegisters, PANEL, Summing, Sums, accumulate, panels};
use crate::layers::vectors::Vectors;

/// Numbers of an input that a block of rows reads at most, so that it stays in the second-level
/// cache.
const BLOCK: usize = 1 << 17;

/// How a convolution goes over its input.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Steps {
    /// Pixels of the input from one output to the next.
    pub(crate) stride: usize,
    /// Zeros about the input.
    pub(crate) padding: usize,
}

/// A convolution on the CPU.
#[derive(Debug)]
pub(crate) struct Direct {
    /// For each panel of outputs, for each tap: `(inputs, outputs of a panel)`.
    weight: Aligned,
    bias: Vec<f32>,
    /// Taps along a side.
    side: usize,
    steps: Steps,
    inputs: usize,
    rectified: bool,
}

impl Direct {
    /// `weight` `(outputs, inputs, side, side)` and `bias` `(outputs)`; outputs are a multiple of 32.
    pub(crate) fn new(
        weight: &Tensor,
        bias: &Tensor,
        steps: Steps,
        rectified: bool,
    ) -> Result<Self, TchError> {
        let [outputs, inputs, side, across] = shape_of(weight)?;
        let fits = outputs.is_multiple_of(PANEL) && inputs > 0 && side == across;
        if !fits || steps.stride == 0 || steps.padding >= side {
            let text = format!("weight {:?} by {steps:?}", weight.size());
            return Err(TchError::Shape(text));
        }
        Ok(Self {
            weight: Aligned::of(&panels(weight, &[0, 3, 4, 2, 1])?),
            bias: bias_of(bias, outputs)?,
            side,
            steps,
            inputs,
            rectified,
        })
    }

    /// The size of what the convolution of images of size `before` gives.
    fn size_after(&self, before: Size) -> Size {
        let Steps { stride, padding } = self.steps;
        let along = |length: usize| match (length + 2 * padding).checked_sub(self.side) {
            Some(rest) => rest / stride + 1,
            None => 0,
        };
        Size {
            height: along(before.height),
            width: along(before.width),
            channels: self.bias.len(),
            ..before
        }
    }

    /// The convolution of `x`, plus the residual input `beside`, then ReLU if it has one.
    pub(crate) fn apply(
        &self,
        x: &Plane,
        beside: Option<&Plane>,
        workspace: &mut Workspace,
    ) -> Result<Plane, TchError> {
        let size = self.size_after(x.size);
        x.check_channels(self.inputs)?;
        let ending = Epilogue::new(&self.bias, beside, self.rectified, size)?;
        let mut out = workspace.plane(size);
        if size.numbers() > 0 {
            workspace.processor.run(InRegisters(Taps {
                convolution: self,
                x,
                zeros: &vec![0.0; self.inputs],
                ending,
                size,
                out: &mut out.values,
            }));
        }
        Ok(out)
    }
}

/// One convolution.
struct Taps<'a> {
    convolution: &'a Direct,
    x: &'a Plane,
    /// What lies outside of an image.
    zeros: &'a [f32],
    ending: Epilogue<'a>,
    /// Of the outputs.
    size: Size,
    out: &'a mut [f32],
}

impl Summing for Taps<'_> {
    #[inline(always)]
    fn run<V: Vectors, const ROWS: usize, const VECTORS: usize>(self, simd: V) {
        let Direct {
            weight,
            side,
            steps,
            inputs,
            ..
        } = self.convolution;
        let row = steps.stride * self.x.size.width * inputs;
        let rows = (BLOCK / row.max(1)).clamp(1, self.size.height);
        let pixels = self.size.height * self.size.width;
        for image in 0..self.size.batch {
            for first in (0..pixels).step_by(rows * self.size.width) {
                let end = pixels.min(first + rows * self.size.width);
                let panels = weight.chunks_exact(side * side * inputs * PANEL);
                for (panel, weight) in panels.enumerate() {
                    for pixel in (first..end).step_by(ROWS) {
                        let sums = self.group::<V, ROWS, VECTORS>(simd, weight, image, pixel);
                        for (pixel, sums) in (pixel..end).zip(sums) {
                            let at = (image * pixels + pixel) * self.size.channels;
                            for (vector, sum) in sums.into_iter().enumerate() {
                                let channel = panel * PANEL + vector * V::F32_LANES;
                                let ending = &self.ending;
                                ending.write(simd, sum, self.out, at + channel, channel);
                            }
                        }
                    }
                }
            }
        }
    }
}

impl Taps<'_> {
    /// The sums over the taps of the pixels from `first` on, row by row; behind the last pixel
    /// whatever.
    #[inline(always)]
    fn group<V: Vectors, const ROWS: usize, const VECTORS: usize>(
        &self,
        simd: V,
        weight: &[f32],
        image: usize,
        first: usize,
    ) -> Sums<V, ROWS, VECTORS> {
        let Direct {
            side,
            steps,
            inputs,
            ..
        } = self.convolution;
        let width = self.size.width;
        // Rows and columns of the first taps, in the input with its border.
        let mut places = [[0; 2]; ROWS];
        let mut place = [first / width, first % width];
        for to in &mut places {
            *to = place.map(|along| along * steps.stride);
            place[1] += 1;
            if place[1] == width {
                place = [place[0] + 1, 0];
            }
        }
        let mut sums = [[simd.splat_f32s(0.0); VECTORS]; ROWS];
        for (tap, weight) in weight.chunks_exact(inputs * PANEL).enumerate() {
            let tap = [tap / side, tap % side];
            let mut rows = [self.zeros; ROWS];
            for (row, place) in rows.iter_mut().zip(places) {
                *row = self.pixel(image, [place[0] + tap[0], place[1] + tap[1]]);
            }
            sums = accumulate(simd, sums, weight, rows, &[]);
        }
        sums
    }

    /// The numbers of the pixel at a place of the input with its border.
    #[inline(always)]
    fn pixel(&self, image: usize, [y, x]: [usize; 2]) -> &[f32] {
        let Size {
            height,
            width,
            channels,
            ..
        } = self.x.size;
        let padding = self.convolution.steps.padding;
        // Before the first is greater than any.
        let (y, x) = (y.wrapping_sub(padding), x.wrapping_sub(padding));
        if y < height && x < width {
            let pixel = (image * height + y) * width + x;
            &self.x.values[pixel * channels..][..channels]
        } else {
            self.zeros
        }
    }
}
