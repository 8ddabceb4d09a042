//! The right-hand side of the product: few columns, packed row by row.

use crate::layers::vectors::Processor;

/// The columns of a product: for each block of columns, for each row, the numbers of the block's
/// columns.
///
/// As `im2col` makes them, but with a row's numbers of a block side by side, so that the numbers
/// that a kernel broadcasts lie together.
#[derive(Debug, Default)]
pub(crate) struct Columns {
    /// `(blocks, rows, columns of a block)`.
    values: Vec<f32>,
    rows: usize,
    count: usize,
    /// Columns of a block. Where there are no more the numbers are any.
    width: usize,
    /// An input with what is around it.
    around: Vec<f32>,
}

/// What a convolution sees of each input: for each of its outputs a window.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Windows {
    /// Steps of an input.
    pub(crate) steps: usize,
    /// Steps of a window.
    pub(crate) taps: usize,
    /// Zeros before the first step that the first window sees.
    pub(crate) before: usize,
    /// From a window to the next.
    pub(crate) stride: usize,
    /// Windows.
    pub(crate) count: usize,
}

impl Columns {
    pub(super) const fn rows(&self) -> usize {
        self.rows
    }

    pub(super) const fn count(&self) -> usize {
        self.count
    }

    /// Columns of a block.
    pub(super) const fn width(&self) -> usize {
        self.width
    }

    pub(super) const fn blocks(&self) -> usize {
        self.count.div_ceil(self.width)
    }

    /// The rows of a block; `WIDTH` is [`Self::width`].
    pub(super) fn block<const WIDTH: usize>(&self, index: usize) -> &[[f32; WIDTH]] {
        let size = self.rows * WIDTH;
        let (rows, _) = self.values[index * size..][..size].as_chunks();
        rows
    }

    /// The windows into `x` `(inputs, steps)`: a row for every step of a window of every input, a
    /// column for every window.
    pub(crate) fn set(&mut self, processor: Processor, x: &[f32], windows: Windows) {
        let Windows {
            steps, taps, count, ..
        } = windows;
        self.rows = x.len() / steps.max(1) * taps;
        self.count = count;
        self.width = width(processor, count);
        self.values.clear();
        if count == 0 {
            return;
        }
        match self.width {
            16 => self.fill::<16>(x, windows),
            8 => self.fill::<8>(x, windows),
            _ => self.fill::<4>(x, windows),
        }
    }

    /// Packs all blocks; for each block an input is copied into a line with its border of zeros.
    fn fill<const WIDTH: usize>(&mut self, x: &[f32], windows: Windows) {
        let Windows {
            steps,
            taps,
            before,
            stride,
            ..
        } = windows;
        let blocks = self.blocks();
        self.values.reserve(blocks * self.rows * WIDTH);
        self.around.clear();
        // As far as the last window of the last block sees.
        let seen = (blocks * WIDTH - 1) * stride + taps;
        self.around.resize(seen.max(before + steps), 0.0);
        for block in 0..blocks {
            let first = block * WIDTH * stride;
            for input in x.chunks_exact(steps) {
                self.around[before..before + steps].copy_from_slice(input);
                for tap in 0..taps {
                    let from = &self.around[first + tap..];
                    if stride == 1 {
                        self.values.extend_from_slice(&from[..WIDTH]);
                    } else {
                        let column = |column: usize| from[column * stride];
                        self.values.extend((0..WIDTH).map(column));
                    }
                }
            }
        }
    }
}

/// Of `count` columns, how many a block takes: as many as the processor has registers for.
const fn width(processor: Processor, count: usize) -> usize {
    match (processor.lanes(), count) {
        (16, 9..) => 16,
        (16, 5..) => 8,
        _ => 4,
    }
}
