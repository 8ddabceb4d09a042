//! What all these convolutions come to: some rows of inputs by a panel of weights.

use pulp::Simd;

/// Outputs whose weights lie side by side.
pub(super) const PANEL: usize = 32;

/// For each row, a panel of outputs as `VECTORS` vectors.
pub(super) type Sums<S, const ROWS: usize, const VECTORS: usize> =
    [[<S as Simd>::f32s; VECTORS]; ROWS];

/// Adds the products of each row's numbers with `weight` `(numbers, outputs of a panel)`, one number after the other.
///
/// As many sums as the processor has registers for, with the weights of a number and one number of a row; iterators over them
/// would keep them in memory instead.
#[inline(always)]
pub(super) fn accumulate<S: Simd, const ROWS: usize, const VECTORS: usize>(
    simd: S,
    mut sums: Sums<S, ROWS, VECTORS>,
    weight: &[f32],
    rows: [&[f32]; ROWS],
) -> Sums<S, ROWS, VECTORS> {
    let (weight, _) = pulp::as_arrays::<VECTORS, _>(S::as_simd_f32s(weight).0);
    let rows: [&[f32]; ROWS] = std::array::from_fn(|row| &rows[row][..weight.len()]);
    for (index, weight) in weight.iter().enumerate() {
        for row in 0..ROWS {
            let number = simd.splat_f32s(rows[row][index]);
            for vector in 0..VECTORS {
                let sum = sums[row][vector];
                sums[row][vector] = simd.mul_add_f32s(number, weight[vector], sum);
            }
        }
    }
    sums
}
