//! The stem of a ResNet: a 7x7 convolution with stride 2, ReLU, and 3x3 max pooling with stride 2.
//!
//! A row of the convolution goes through the pooling as soon as its neighbours are there, so that
//! the largest picture of the network never leaves the second-level cache.

use pulp::Simd;
use tch::{TchError, Tensor};

use super::{Epilogue, Plane, Size, Workspace, bias_of, load, shape_of, store};
use crate::dimension::dimension;
use crate::layers::aligned::Aligned;
use crate::layers::kernel::{GROUP, InRegisters, PANEL, Summing, Sums, panels};
use crate::layers::vectors::Vectors;

/// Colours of an image.
const COLOURS: usize = 3;

/// Taps along a side.
const TAPS: usize = 7;

/// Inputs along a row that as many outputs see.
const SEEN: usize = 2 * (GROUP - 1) + TAPS;

/// Rows of the convolution that a row of the pooling sees.
const POOLED: usize = 3;

/// The first layers, on the CPU.
#[derive(Debug)]
pub(crate) struct Stem {
    /// For each panel of outputs: `(colours, taps down, taps across, outputs of a panel)`.
    weight: Aligned,
    bias: Vec<f32>,
}

/// Lengths along the way.
#[derive(Clone, Copy)]
struct Lengths {
    /// Of the convolution's picture.
    high: usize,
    wide: usize,
    /// Columns of it that are computed.
    columns: usize,
    /// Of the input with its border.
    padded_high: usize,
    padded_wide: usize,
}

impl Lengths {
    const fn of(height: usize, width: usize) -> Self {
        let (high, wide) = (height.div_ceil(2), width.div_ceil(2));
        let columns = wide.next_multiple_of(GROUP);
        Self {
            high,
            wide,
            columns,
            padded_high: 2 * (high - 1) + TAPS,
            padded_wide: 2 * (columns - 1) + TAPS,
        }
    }
}

impl Stem {
    /// `weight` `(outputs, 3, 7, 7)` and `bias` `(outputs)`; outputs are a multiple of 32.
    pub(crate) fn new(weight: &Tensor, bias: &Tensor) -> Result<Self, TchError> {
        let [outputs, rest @ ..] = shape_of(weight)?;
        if !outputs.is_multiple_of(PANEL) || rest != [COLOURS, TAPS, TAPS] {
            return Err(TchError::Shape(format!("weight {:?}", weight.size())));
        }
        Ok(Self {
            weight: Aligned::of(&panels(weight, &[0, 2, 3, 4, 1])?),
            bias: bias_of(bias, outputs)?,
        })
    }

    /// `images` `(n, 3, h, w)` to a quarter of their size, rounded up.
    pub(crate) fn apply(
        &self,
        images: &Tensor,
        workspace: &mut Workspace,
    ) -> Result<Plane, TchError> {
        let [batch, colours, height, width] = shape_of(images)?;
        if colours != COLOURS || batch * height * width == 0 {
            return Err(TchError::Shape(format!("images {:?}", images.size())));
        }
        let lengths = Lengths::of(height, width);
        let size = Size {
            batch,
            height: lengths.high.div_ceil(2),
            width: lengths.wide.div_ceil(2),
            channels: self.bias.len(),
        };
        let mut out = workspace.plane(size);
        let processor = workspace.processor;
        let Workspace {
            tiles: padded,
            products: other,
            ..
        } = workspace;
        let numbers = COLOURS * height * width;
        other.grow(numbers.max(POOLED * lengths.columns * size.channels));
        let of_picture = size.height * size.width * size.channels;
        for (image, out) in out.values[..size.numbers()]
            .chunks_exact_mut(of_picture)
            .enumerate()
        {
            images
                .f_select(0, dimension(image))?
                .f_contiguous()?
                .f_copy_data(other, numbers)?;
            pad(&other[..numbers], padded, [height, width], lengths);
            processor.run(InRegisters(Image {
                stem: self,
                padded,
                rows: other,
                lengths,
                size,
                out,
            }));
        }
        Ok(out)
    }
}

/// Copies a picture `(colours, height, width)` into one with a border of zeros.
fn pad(image: &[f32], padded: &mut Aligned, [height, width]: [usize; 2], lengths: Lengths) {
    let Lengths {
        padded_high,
        padded_wide,
        ..
    } = lengths;
    let border = TAPS / 2;
    let numbers = COLOURS * padded_high * padded_wide;
    padded.grow(numbers);
    let rows = padded[..numbers].chunks_exact_mut(padded_wide);
    for (index, to) in rows.enumerate() {
        let (colour, y) = (index / padded_high, index % padded_high);
        // Above the picture it is greater than any.
        let y = y.wrapping_sub(border);
        if y >= height {
            to.fill(0.0);
            continue;
        }
        let (before, to) = to.split_at_mut(border);
        let (within, behind) = to.split_at_mut(width);
        before.fill(0.0);
        within.copy_from_slice(&image[(colour * height + y) * width..][..width]);
        behind.fill(0.0);
    }
}

/// One image.
struct Image<'a> {
    stem: &'a Stem,
    padded: &'a [f32],
    /// The last rows of the convolution, each at its number's remainder.
    rows: &'a mut [f32],
    lengths: Lengths,
    /// Of the outputs.
    size: Size,
    out: &'a mut [f32],
}

impl Summing for Image<'_> {
    #[inline(always)]
    fn run<V: Vectors, const ROWS: usize, const VECTORS: usize>(mut self, simd: V) {
        let mut computed = 0;
        for y in 0..self.size.height {
            let seen = 2 * y + 2;
            while computed < seen.min(self.lengths.high) {
                self.convolve::<V, ROWS, VECTORS>(simd, computed);
                computed += 1;
            }
            self.pool(simd, y);
        }
    }
}

impl Image<'_> {
    /// One row of the convolution, without the bias.
    #[inline(always)]
    fn convolve<S: Simd, const ROWS: usize, const VECTORS: usize>(&mut self, simd: S, y: usize) {
        let Lengths {
            columns,
            padded_high,
            padded_wide,
            ..
        } = self.lengths;
        let channels = self.size.channels;
        let to = &mut self.rows[y % POOLED * columns * channels..][..columns * channels];
        let panels = self.stem.weight.chunks_exact(COLOURS * TAPS * TAPS * PANEL);
        for (panel, weight) in panels.enumerate() {
            let (weight, _) = weight.as_chunks::<{ TAPS * PANEL }>();
            for column in (0..columns).step_by(GROUP) {
                for first in (0..GROUP).step_by(ROWS) {
                    let mut sums = [[simd.splat_f32s(0.0); VECTORS]; ROWS];
                    for (line, weight) in weight.iter().enumerate() {
                        let (colour, tap) = (line / TAPS, line % TAPS);
                        let at = (colour * padded_high + 2 * y + tap) * padded_wide + 2 * column;
                        let (seen, _) = self.padded[at..at + SEEN].as_chunks();
                        sums = taps(simd, sums, weight, &seen[0], first);
                    }
                    for (row, sums) in sums.into_iter().enumerate() {
                        for (vector, sum) in sums.into_iter().enumerate() {
                            let channel = panel * PANEL + vector * S::F32_LANES;
                            store::<S>(to, (column + first + row) * channels + channel, sum);
                        }
                    }
                }
            }
        }
    }

    /// A row of the max pooling over up to 3x3, with bias and ReLU.
    #[inline(always)]
    fn pool<S: Simd>(&mut self, simd: S, y: usize) {
        let Lengths {
            high,
            wide,
            columns,
            ..
        } = self.lengths;
        let channels = self.size.channels;
        let ending = Epilogue {
            bias: &self.stem.bias,
            beside: None,
            rectified: true,
        };
        let [above, below] = [(2 * y).saturating_sub(1), high.min(2 * y + 2)];
        for x in 0..self.size.width {
            let [left, right] = [(2 * x).saturating_sub(1), wide.min(2 * x + 2)];
            for channel in (0..channels).step_by(S::F32_LANES) {
                let mut greatest = simd.splat_f32s(f32::NEG_INFINITY);
                // The maximum drops NaN: a sum keeps it.
                let mut nothing = simd.splat_f32s(0.0);
                for row in above..below {
                    for column in left..right {
                        let at = (row % POOLED * columns + column) * channels + channel;
                        let number = load::<S>(self.rows, at);
                        greatest = simd.max_f32s(greatest, number);
                        nothing = simd.mul_add_f32s(number, simd.splat_f32s(0.0), nothing);
                    }
                }
                let at = (y * self.size.width + x) * channels + channel;
                let greatest = simd.add_f32s(greatest, nothing);
                ending.write(simd, greatest, self.out, at, channel);
            }
        }
    }
}

/// Adds the products of `ROWS` outputs, from the `first` on, with the taps of one line.
#[inline(always)]
fn taps<S: Simd, const ROWS: usize, const VECTORS: usize>(
    simd: S,
    mut sums: Sums<S, ROWS, VECTORS>,
    weight: &[f32; TAPS * PANEL],
    seen: &[f32; SEEN],
    first: usize,
) -> Sums<S, ROWS, VECTORS> {
    let (weight, _) = pulp::as_arrays::<VECTORS, _>(S::as_simd_f32s(weight).0);
    for tap in 0..TAPS {
        for row in 0..ROWS {
            let number = simd.splat_f32s(seen[2 * (first + row) + tap]);
            for vector in 0..VECTORS {
                let sum = sums[row][vector];
                sums[row][vector] = simd.mul_add_f32s(number, weight[tap][vector], sum);
            }
        }
    }
    sums
}
