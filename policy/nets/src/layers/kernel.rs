//! The micro-kernel of convolutions and linear layers: some rows of inputs by a panel of packed
//! weights.
//!
//! A sum stays in one register from its first product to its last. AVX-512 has 32 registers: 8 rows
//! by 2 vectors of 16 numbers are 16 sums; AVX2 has 16: 2 rows by 4 vectors of 8 are 8 sums. Both
//! are a panel of 32 outputs wide, so packed weights are the same.

use pulp::Simd;
use tch::{TchError, Tensor};

use super::vectors::{SimdKernel, Vectors};
use crate::dimension::dimension;

/// Outputs of a panel of packed weights.
pub(super) const PANEL: usize = 32;

/// For each row, a panel of outputs as `VECTORS` vectors.
pub(super) type Sums<S, const ROWS: usize, const VECTORS: usize> =
    [[<S as Simd>::f32s; VECTORS]; ROWS];

/// Rows that are done at once at most. Buffers hold whole groups of rows, whatever the processor
/// does at once.
pub(super) const GROUP: usize = 8;

/// A kernel whose accumulators the processor's registers should hold.
pub(super) trait Summing {
    /// All of it, `ROWS` rows by `VECTORS` vectors of sums at once.
    fn run<V: Vectors, const ROWS: usize, const VECTORS: usize>(self, simd: V);
}

/// A kernel in whichever registers the processor has.
pub(super) struct InRegisters<W>(pub(super) W);

impl<W: Summing> SimdKernel for InRegisters<W> {
    #[inline(always)]
    fn run<V: Vectors>(self, simd: V) {
        match V::F32_LANES {
            16 => self.0.run::<V, GROUP, 2>(simd),
            _ => self.0.run::<V, 2, 4>(simd),
        }
    }
}

/// `weight` `(outputs, ..)` with the outputs of a panel last: its dimensions, the outputs in two,
/// in this order.
pub(super) fn panels(weight: &Tensor, order: &[i64]) -> Result<Vec<f32>, TchError> {
    let last = weight
        .f_unflatten(0, [-1, dimension(PANEL)])?
        .f_permute(order)?;
    Vec::try_from(&last.f_contiguous()?.f_view([-1])?)
}

/// The part `index` of `count` parts of `all`, in whole lines; the last ones may be smaller or
/// nothing.
#[inline(always)]
pub(super) fn share(all: &[f32], index: usize, count: usize) -> &[f32] {
    assert!(index < count, "part {index} of {count}");
    let size = all.len().div_ceil(count).next_multiple_of(LINE);
    all.chunks(size.max(1)).nth(index).unwrap_or_default()
}

/// Numbers of a row that are taken as one: the processor checks no lengths in between.
const STRETCH: usize = 8;

/// Numbers of a cache line.
const LINE: usize = 16;

/// Adds the products of each row's numbers with `weight` `(numbers, outputs of a panel)`, one
/// number after the other, and prefetches the numbers `ahead`.
///
/// As many sums as the processor has registers for, with the weights of a number and one number of
/// a row; iterators over them would keep them in memory instead.
#[inline(always)]
pub(super) fn accumulate<V: Vectors, const ROWS: usize, const VECTORS: usize>(
    simd: V,
    mut sums: Sums<V, ROWS, VECTORS>,
    weight: &[f32],
    rows: [&[f32]; ROWS],
    mut ahead: &[f32],
) -> Sums<V, ROWS, VECTORS> {
    let (weight, _) = pulp::as_arrays::<VECTORS, _>(V::as_simd_f32s(weight).0);
    let whole = weight.len() / STRETCH;
    let (stretches, rest) = weight.as_chunks::<STRETCH>();
    let numbers: [&[[f32; STRETCH]]; ROWS] =
        std::array::from_fn(|row| &rows[row].as_chunks().0[..whole]);
    let lines = ahead.len().div_ceil(whole.max(1)).next_multiple_of(LINE);
    for (index, weight) in stretches.iter().enumerate() {
        if !ahead.is_empty() {
            let (now, later) = ahead.split_at(lines.min(ahead.len()));
            for line in now.iter().step_by(LINE) {
                simd.fetch_near(line);
            }
            ahead = later;
        }
        let numbers: [&[f32; STRETCH]; ROWS] = std::array::from_fn(|row| &numbers[row][index]);
        for (at, weight) in weight.iter().enumerate() {
            let numbers = std::array::from_fn(|row| numbers[row][at]);
            sums = add_products(simd, sums, weight, numbers);
        }
    }
    for (index, weight) in rest.iter().enumerate() {
        let numbers = std::array::from_fn(|row| rows[row][whole * STRETCH + index]);
        sums = add_products(simd, sums, weight, numbers);
    }
    sums
}

/// Adds the products of a number of each row with the `weight` of these numbers.
#[inline(always)]
fn add_products<S: Simd, const ROWS: usize, const VECTORS: usize>(
    simd: S,
    mut sums: Sums<S, ROWS, VECTORS>,
    weight: &[S::f32s; VECTORS],
    numbers: [f32; ROWS],
) -> Sums<S, ROWS, VECTORS> {
    for row in 0..ROWS {
        let number = simd.splat_f32s(numbers[row]);
        for vector in 0..VECTORS {
            let sum = sums[row][vector];
            sums[row][vector] = simd.mul_add_f32s(number, weight[vector], sum);
        }
    }
    sums
}

#[cfg(test)]
mod tests {
    use super::share;

    #[test]
    fn shares_are_all_of_it_in_order() {
        let all: Vec<f32> = (0_u8..=250).map(f32::from).collect();
        for length in [0, 1, 15, 16, 17, 100, 251] {
            for count in [1, 2, 3, 16, 40] {
                let parts = (0..count).map(|index| share(&all[..length], index, count));
                assert_eq!(parts.collect::<Vec<_>>().concat(), &all[..length]);
            }
        }
    }

    #[test]
    #[should_panic(expected = "part 3 of 3")]
    fn a_share_beyond_the_last_is_a_defect() {
        share(&[0.0; 64], 3, 3);
    }
}
