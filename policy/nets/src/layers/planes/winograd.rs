//! Convolutions of 3x3 with stride 1 by Winograd's minimal filtering: 36 multiplications for 4x4
//! outputs instead of 144.
//!
//! Pictures lie with their channels last. A tile of 6x6 inputs becomes 36 values by a transform
//! along both directions; each of the 36 goes through a matrix product over the channels of its
//! own; the transform back gives 4x4 outputs. Tiles go through all three in blocks that stay in the
//! second-level cache. Points of the interpolation: 0, infinity, and plus or minus the square roots
//! of a half and of two, whose powers are as close to one as four such points allow, so that little
//! is lost to rounding.

use tch::{TchError, Tensor};

use super::tile::{OUTPUTS, VALUES};
use super::transforms::{Constants, from_tile, kernel_to_tile, to_tile};
use super::{Epilogue, Plane, Size, Workspace, bias_of, shape_of};
use crate::layers::aligned::Aligned;
use crate::layers::kernel::{GROUP, InRegisters, PANEL, Summing, accumulate, share};
use crate::layers::vectors::Vectors;

/// Numbers between the tiles of one of the values and those of the next, so that they do not fall
/// on the same cache lines.
const GAP: usize = 16;

/// Inputs that are summed on their own before they are added to the others', so that fewer bits are
/// lost.
const PART: usize = 128;

/// A 3x3 convolution with stride 1 and zero padding, followed by ReLU, on the CPU.
#[derive(Debug)]
pub(crate) struct Winograd {
    /// For each value of a tile, for each panel of outputs: `(inputs, outputs of a panel)`.
    weight: Aligned,
    bias: Vec<f32>,
    inputs: usize,
    outputs: usize,
}

impl Winograd {
    /// `weight` `(outputs, inputs, 3, 3)` and `bias` `(outputs)`; outputs are a multiple of 32,
    /// inputs of 16.
    pub(crate) fn new(weight: &Tensor, bias: &Tensor) -> Result<Self, TchError> {
        let [outputs, inputs, high, wide] = shape_of(weight)?;
        let fits = outputs.is_multiple_of(PANEL) && inputs.is_multiple_of(16) && inputs > 0;
        if !fits || [high, wide] != [3, 3] {
            return Err(TchError::Shape(format!("weight {:?}", weight.size())));
        }
        let kernels = Vec::<f32>::try_from(&weight.f_contiguous()?.f_view([-1])?)?;
        let mut tiles = Aligned::zeros(VALUES * inputs * outputs);
        let (kernels, _) = kernels.as_chunks::<9>();
        for (index, kernel) in kernels.iter().enumerate() {
            let (output, input) = (index / inputs, index % inputs);
            let place = (output / PANEL * inputs + input) * PANEL + output % PANEL;
            for (value, number) in kernel_to_tile(kernel).into_iter().enumerate() {
                tiles[value * inputs * outputs + place] = number;
            }
        }
        Ok(Self {
            weight: tiles,
            bias: bias_of(bias, outputs)?,
            inputs,
            outputs,
        })
    }

    /// Whether images of this size need at most half the multiplications of a plain convolution: of
    /// few or narrow tiles much is thrown away.
    pub(crate) const fn pays(height: usize, width: usize) -> bool {
        let tiles = height.div_ceil(OUTPUTS) * width.div_ceil(OUTPUTS);
        2 * VALUES * whole_groups(tiles) <= 9 * height * width
    }

    /// The convolution of `x`, plus the residual input `beside`, then ReLU.
    pub(crate) fn apply(
        &self,
        x: &Plane,
        beside: Option<&Plane>,
        workspace: &mut Workspace,
    ) -> Result<Plane, TchError> {
        let size = Size {
            channels: self.outputs,
            ..x.size
        };
        x.check_channels(self.inputs)?;
        let ending = Epilogue::new(&self.bias, beside, true, size)?;
        let mut out = workspace.plane(size);
        // More channels need more tiles for each time that the weights are read.
        let block = whole_groups(size.tiles()).min(if self.inputs > 64 { 64 } else { 32 });
        if block == 0 {
            return Ok(out);
        }
        workspace.tiles.grow(VALUES * (block * self.inputs + GAP));
        workspace
            .products
            .grow(VALUES * (block * self.outputs + GAP));
        let processor = workspace.processor;
        processor.run(InRegisters(Tiles {
            convolution: self,
            x,
            ending,
            out: &mut out.values,
            block,
            workspace,
        }));
        Ok(out)
    }
}

/// One convolution.
struct Tiles<'a> {
    convolution: &'a Winograd,
    x: &'a Plane,
    ending: Epilogue<'a>,
    out: &'a mut [f32],
    /// Tiles that go through together.
    block: usize,
    workspace: &'a mut Workspace,
}

impl Summing for Tiles<'_> {
    #[inline(always)]
    fn run<V: Vectors, const ROWS: usize, const VECTORS: usize>(self, simd: V) {
        let constants = Constants::new(simd);
        let &Winograd {
            inputs, outputs, ..
        } = self.convolution;
        let map = self.x.size;
        let all = map.tiles();
        let between_tiles = self.block * inputs + GAP;
        let between_products = self.block * outputs + GAP;
        let Workspace {
            tiles, products, ..
        } = self.workspace;
        for first in (0..all).step_by(self.block) {
            let count = self.block.min(all - first);
            for index in 0..count {
                let to = (&mut tiles[index * inputs..], between_tiles);
                let place = map.place(first + index);
                to_tile(&constants, &self.x.values, &place, inputs, to);
            }
            for value in 0..VALUES {
                let weight = &self.convolution.weight[value * inputs * outputs..];
                let tiles = &tiles[value * between_tiles..];
                let products = &mut products[value * between_products..];
                let lengths = [count, inputs, outputs];
                product::<V, ROWS, VECTORS>(simd, weight, tiles, products, lengths);
            }
            for index in 0..count {
                let from = (&products[index * outputs..], between_products);
                let place = map.place(first + index);
                from_tile(&constants, from, &place, &self.ending, self.out);
            }
        }
    }
}

/// The first `count` of `tiles` `(tiles, inputs)` by the first panels of `weight` `(panels, inputs,
/// outputs of a panel)`. Tiles are done in groups, so some more of `products` may be written to.
#[inline(always)]
fn product<V: Vectors, const ROWS: usize, const VECTORS: usize>(
    simd: V,
    weight: &[f32],
    tiles: &[f32],
    products: &mut [f32],
    [count, inputs, outputs]: [usize; 3],
) {
    let (groups, parts) = (count.div_ceil(ROWS), inputs.div_ceil(PART));
    let size = inputs * PANEL;
    for panel in 0..outputs / PANEL {
        let (weight, rest) = weight[panel * size..].split_at(size);
        // While this panel is used, each group prefetches a part of the next one.
        let next = &rest[..rest.len().min(size)];
        for group in 0..groups {
            let tiles = &tiles[group * ROWS * inputs..][..ROWS * inputs];
            let products = &mut products[group * ROWS * outputs + panel * PANEL..];
            for (part, weight) in weight.chunks(PART * PANEL).enumerate() {
                let depth = weight.len() / PANEL;
                let rows = std::array::from_fn(|row| &tiles[row * inputs + part * PART..][..depth]);
                let zeros = [[simd.splat_f32s(0.0); VECTORS]; ROWS];
                let ahead = share(next, group * parts + part, groups * parts);
                let sums = accumulate(simd, zeros, weight, rows, ahead);
                for (row, sums) in sums.iter().enumerate() {
                    let to = &mut products[row * outputs..][..PANEL];
                    let (to, _) = V::as_mut_simd_f32s(to);
                    if part == 0 {
                        to[..VECTORS].copy_from_slice(sums);
                    } else {
                        for (to, sum) in to.iter_mut().zip(sums) {
                            *to = simd.add_f32s(*to, *sum);
                        }
                    }
                }
            }
        }
    }
}

/// The number of tiles that are computed for `tiles`: whole groups.
const fn whole_groups(tiles: usize) -> usize {
    tiles.next_multiple_of(GROUP)
}
