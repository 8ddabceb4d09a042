//! The matrix products of a block of tiles: for each value, tiles by channels in times channels in by channels out.

use pulp::Simd;

use super::VALUES;

/// Outputs whose weights lie side by side.
pub(super) const PANEL: usize = 32;

/// Tiles that a product takes at once.
const GROUP: usize = 8;

/// What a product needs to know of its matrices.
pub(super) struct Sizes {
    /// Channels in.
    pub(super) inputs: usize,
    /// Channels out.
    pub(super) outputs: usize,
    /// Numbers from the tiles of one value to those of the next.
    pub(super) between_tiles: usize,
    /// The same of the products.
    pub(super) between_products: usize,
}

/// The number of tiles that are computed if `tiles` are asked for.
pub(super) const fn whole_groups(tiles: usize) -> usize {
    tiles.next_multiple_of(GROUP)
}

/// For each value, for each of the first `count` tiles: the products with the weights of all outputs. Tiles are done in
/// groups, so some more of `products` may be written to.
#[inline(always)]
pub(super) fn product<S: Simd>(
    simd: S,
    weight: &[f32],
    tiles: &[f32],
    products: &mut [f32],
    count: usize,
    sizes: &Sizes,
) {
    let &Sizes {
        inputs, outputs, ..
    } = sizes;
    for value in 0..VALUES {
        let weight = &weight[value * inputs * outputs..][..inputs * outputs];
        let tiles = &tiles[value * sizes.between_tiles..];
        let products = &mut products[value * sizes.between_products..];
        for (panel, weight) in weight.chunks_exact(inputs * PANEL).enumerate() {
            for tile in (0..count).step_by(GROUP) {
                let tiles = &tiles[tile * inputs..][..GROUP * inputs];
                let products = &mut products[tile * outputs + panel * PANEL..];
                // As many sums as the processor has registers for, with the weights of an input and one number of a tile.
                match S::F32_LANES {
                    16 => group::<S, 8, 2>(simd, weight, tiles, products, outputs),
                    8 => group::<S, 2, 4>(simd, weight, tiles, products, outputs),
                    4 => group::<S, 2, 8>(simd, weight, tiles, products, outputs),
                    _ => group::<S, 1, PANEL>(simd, weight, tiles, products, outputs),
                }
            }
        }
    }
}

/// A group of tiles by one panel, `ROWS` tiles at a time; a panel is `VECTORS` vectors wide.
#[expect(
    clippy::needless_range_loop,
    reason = "iterators over the sums keep them in memory instead of in registers"
)]
#[inline(always)]
fn group<S: Simd, const ROWS: usize, const VECTORS: usize>(
    simd: S,
    weight: &[f32],
    tiles: &[f32],
    products: &mut [f32],
    outputs: usize,
) {
    let (weight, _) = pulp::as_arrays::<VECTORS, _>(S::as_simd_f32s(weight).0);
    let inputs = weight.len();
    for (rows, tiles) in tiles.chunks_exact(ROWS * inputs).enumerate() {
        let tiles: [&[f32]; ROWS] = std::array::from_fn(|row| &tiles[row * inputs..][..inputs]);
        let mut sums = [[simd.splat_f32s(0.0); VECTORS]; ROWS];
        for (input, weight) in weight.iter().enumerate() {
            for row in 0..ROWS {
                let number = simd.splat_f32s(tiles[row][input]);
                for vector in 0..VECTORS {
                    let sum = sums[row][vector];
                    sums[row][vector] = simd.mul_add_f32s(number, weight[vector], sum);
                }
            }
        }
        for (row, sums) in sums.iter().enumerate() {
            let products = &mut products[(rows * ROWS + row) * outputs..][..PANEL];
            let (products, _) = S::as_mut_simd_f32s(products);
            products[..VECTORS].copy_from_slice(sums);
        }
    }
}
