//! The product itself.

use super::columns::Columns;
use super::weights::Stored;
use super::{PANEL, Place};
use crate::layers::vectors::{SimdKernel, Vectors};

/// Prefetch distance, bytes, as measured.
const AHEAD: usize = 2048;

/// Bytes that memory is read by.
const LINE: usize = 64;

/// Where the outputs go.
pub(super) struct To<'a> {
    pub(super) bias: &'a [f32],
    /// From the first output on.
    pub(super) out: &'a mut [f32],
    pub(super) place: Place,
}

/// All of `panels` by `columns`.
pub(super) struct Gemm<'a, T> {
    pub(super) panels: &'a [T],
    pub(super) columns: &'a Columns,
    pub(super) to: To<'a>,
}

impl<T: Stored> SimdKernel for Gemm<'_, T> {
    #[inline(always)]
    fn run<V: Vectors>(self, simd: V) {
        let Self {
            panels,
            columns,
            to,
        } = self;
        match (V::F32_LANES, columns.width()) {
            (16, 16) => product::<V, T, 1, 16, 1>(simd, panels, columns, to),
            (16, 8) => product::<V, T, 1, 8, 2>(simd, panels, columns, to),
            (16, _) => product::<V, T, 1, 4, 4>(simd, panels, columns, to),
            _ => product::<V, T, 2, 4, 1>(simd, panels, columns, to),
        }
    }
}

/// All of `panels`, `PANELS` at a time, by `columns` in blocks of `COLUMNS`; a panel is `VECTORS`
/// vectors wide.
#[inline(always)]
fn product<
    V: Vectors,
    T: Stored,
    const VECTORS: usize,
    const COLUMNS: usize,
    const PANELS: usize,
>(
    simd: V,
    panels: &[T],
    columns: &Columns,
    mut to: To<'_>,
) {
    let rows = columns.rows();
    let mut groups = panels.chunks_exact(rows * PANELS);
    let mut panel = 0;
    for group in &mut groups {
        for block in 0..columns.blocks() {
            let rows = columns.block(block);
            let sums = sums::<V, T, VECTORS, COLUMNS, PANELS>(simd, group, rows);
            for (index, sums) in sums.iter().enumerate() {
                to.put::<V, VECTORS, COLUMNS>(sums, panel + index, (block, columns.count()));
            }
        }
        panel += PANELS;
    }
    for single in groups.remainder().chunks_exact(rows) {
        for block in 0..columns.blocks() {
            let rows = columns.block(block);
            let [sums] = sums::<V, T, VECTORS, COLUMNS, 1>(simd, single, rows);
            to.put::<V, VECTORS, COLUMNS>(&sums, panel, (block, columns.count()));
        }
        panel += 1;
    }
}

/// The sums of a panel for a block of columns, in registers.
type Sums<V, const VECTORS: usize, const COLUMNS: usize> = [[V; COLUMNS]; VECTORS];

/// `PANELS` panels, one after the other in `group`, by a block of columns.
#[expect(
    clippy::needless_range_loop,
    reason = "iterators over the sums keep them in memory instead of in registers"
)]
#[inline(always)]
fn sums<V: Vectors, T: Stored, const VECTORS: usize, const COLUMNS: usize, const PANELS: usize>(
    simd: V,
    group: &[T],
    columns: &[[f32; COLUMNS]],
) -> [Sums<V::f32s, VECTORS, COLUMNS>; PANELS] {
    let rows = columns.len();
    let panels: [&[T]; PANELS] = std::array::from_fn(|panel| &group[panel * rows..][..rows]);
    let mut sums = [[[simd.splat_f32s(0.0); COLUMNS]; VECTORS]; PANELS];
    for row in 0..rows {
        for panel in 0..PANELS {
            let weights = &panels[panel][row];
            if row.is_multiple_of((LINE / size_of::<T>()).max(1)) {
                simd.fetch(weights, AHEAD);
            }
            for vector in 0..VECTORS {
                let weights = weights.widened(simd, vector);
                for column in 0..COLUMNS {
                    let number = simd.splat_f32s(columns[row][column]);
                    let sum = sums[panel][vector][column];
                    sums[panel][vector][column] = simd.mul_add_f32s(number, weights, sum);
                }
            }
        }
    }
    sums
}

impl To<'_> {
    /// Puts down what a panel gives for a block, of `count` columns in all.
    #[inline(always)]
    fn put<V: Vectors, const VECTORS: usize, const COLUMNS: usize>(
        &mut self,
        sums: &Sums<V::f32s, VECTORS, COLUMNS>,
        panel: usize,
        (block, count): (usize, usize),
    ) {
        let Self { bias, out, place } = self;
        let outputs = panel * PANEL..bias.len().min((panel + 1) * PANEL);
        let columns = block * COLUMNS..count.min((block + 1) * COLUMNS);
        for (index, column) in columns.enumerate() {
            let mut numbers = [0.0; PANEL];
            let (vectors, _) = V::as_mut_simd_f32s(&mut numbers);
            for (vector, sums) in vectors.iter_mut().zip(sums) {
                *vector = sums[index];
            }
            let first = column * place.column;
            for (output, number) in outputs.clone().zip(numbers) {
                out[first + output * place.output] = number + bias[output];
            }
        }
    }
}
