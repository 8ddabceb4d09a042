//! Convolutions of 3x3 with stride 1 by Winograd's minimal filtering: 36 multiplications for 4x4 outputs instead of 144.
//!
//! Pictures lie with their channels last. A tile of 6x6 inputs becomes 36 values by a transform along both directions; each of
//! the 36 goes through a matrix product over the channels of its own; the transform back gives 4x4 outputs. Tiles go through
//! all three in blocks that stay in the second-level cache. Points of the interpolation: 0, infinity, and plus or minus the
//! square roots of a half and of two, whose powers are as close to one as four such points allow, so that little is lost to
//! rounding.

mod product;
#[cfg(test)]
mod tests;
mod transforms;

use pulp::{Arch, Simd, WithSimd};
use tch::{TchError, Tensor};

use product::{PANEL, Sizes, product, whole_groups};
use transforms::{Constants, from_tile, kernel_to_tile, to_tile};

/// Outputs along a side of a tile.
const OUTPUTS: usize = 4;

/// Inputs along a side of a tile.
const INPUTS: usize = 6;

/// Values that a tile has of each channel.
const VALUES: usize = INPUTS * INPUTS;

/// Numbers between the tiles of one of the values and those of the next, so that they do not fall on the same cache lines.
const GAP: usize = 16;

/// Pictures of one size, channels last.
#[derive(Debug, Default)]
pub(crate) struct Plane {
    values: Vec<f32>,
    size: Size,
}

#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
struct Size {
    pictures: usize,
    height: usize,
    width: usize,
    channels: usize,
}

impl Size {
    const fn numbers(self) -> usize {
        self.pictures * self.height * self.width * self.channels
    }

    const fn tiles(self) -> usize {
        self.pictures * self.height.div_ceil(OUTPUTS) * self.width.div_ceil(OUTPUTS)
    }

    /// Where the tile `index` is.
    const fn place(self, index: usize) -> Place {
        let high = self.height.div_ceil(OUTPUTS);
        let wide = self.width.div_ceil(OUTPUTS);
        Place {
            picture: index / (high * wide) * self.height * self.width,
            top: index / wide % high * OUTPUTS,
            left: index % wide * OUTPUTS,
            height: self.height,
            width: self.width,
        }
    }
}

/// Memory that convolutions work in, and planes that are not needed now.
#[derive(Debug, Default)]
pub(crate) struct Workspace {
    tiles: Vec<f32>,
    products: Vec<f32>,
    spare: Vec<Plane>,
}

/// A convolution 3x3 with stride 1, a border of zeros and a rectifier behind it, on the CPU.
#[derive(Debug)]
pub(crate) struct Winograd {
    /// For each value of a tile, for each panel of outputs: `(inputs, outputs of a panel)`.
    weight: Vec<f32>,
    bias: Vec<f32>,
    inputs: usize,
    outputs: usize,
}

impl Plane {
    /// Height and width.
    pub(crate) const fn sides(&self) -> [usize; 2] {
        [self.size.height, self.size.width]
    }

    /// As `(pictures, channels, height, width)`, channels last in memory.
    pub(crate) fn tensor(&self) -> Result<Tensor, TchError> {
        let Size {
            pictures,
            height,
            width,
            channels,
        } = self.size;
        let shape = [pictures, height, width, channels].map(|n| i64::try_from(n).unwrap_or(0));
        Tensor::f_from_slice(&self.values[..self.size.numbers()])?
            .f_view(shape)?
            .f_permute([0, 3, 1, 2])
    }
}

impl Workspace {
    /// A copy of `x` `(pictures, channels, height, width)`.
    pub(crate) fn plane_of(&mut self, x: &Tensor) -> Result<Plane, TchError> {
        let shape = x.size();
        let size = shape.iter().map(|&n| usize::try_from(n).unwrap_or(0));
        let [pictures, channels, height, width] = size.collect::<Vec<_>>()[..] else {
            return Err(TchError::Shape(format!("pictures {shape:?}")));
        };
        let mut plane = self.plane(Size {
            pictures,
            height,
            width,
            channels,
        });
        let numbers = plane.size.numbers();
        x.f_permute([0, 2, 3, 1])?
            .f_contiguous()?
            .f_copy_data(&mut plane.values, numbers)?;
        Ok(plane)
    }

    /// Takes back what is not needed any more.
    pub(crate) fn give_back(&mut self, plane: Plane) {
        self.spare.push(plane);
    }

    /// A plane with whatever numbers.
    fn plane(&mut self, size: Size) -> Plane {
        let mut plane = self.spare.pop().unwrap_or_default();
        plane.size = size;
        grow(&mut plane.values, size.numbers());
        plane
    }
}

fn grow(memory: &mut Vec<f32>, length: usize) {
    if memory.len() < length {
        memory.resize(length, 0.0);
    }
}

impl Winograd {
    /// `weight` `(outputs, inputs, 3, 3)` and `bias` `(outputs)`; outputs are a multiple of 32, inputs of 16.
    pub(crate) fn new(weight: &Tensor, bias: &Tensor) -> Result<Self, TchError> {
        let shape = weight.size();
        let size = shape.iter().map(|&n| usize::try_from(n).unwrap_or(0));
        let (outputs, inputs) = match size.collect::<Vec<_>>()[..] {
            [outputs, inputs, 3, 3]
                if outputs.is_multiple_of(PANEL) && inputs.is_multiple_of(16) =>
            {
                (outputs, inputs)
            }
            _ => return Err(TchError::Shape(format!("weight {shape:?}"))),
        };
        let kernels = Vec::<f32>::try_from(&weight.f_contiguous()?.f_view([-1])?)?;
        let mut tiles = vec![0.0; VALUES * inputs * outputs];
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
            bias: Vec::try_from(bias)?,
            inputs,
            outputs,
        })
    }

    /// Whether pictures of this size need at most half the multiplications of a plain convolution: of few or narrow tiles
    /// much is thrown away.
    pub(crate) const fn pays(height: usize, width: usize) -> bool {
        let tiles = height.div_ceil(OUTPUTS) * width.div_ceil(OUTPUTS);
        2 * VALUES * whole_groups(tiles) <= 9 * height * width
    }

    /// The convolution of `x`, plus `beside` if there is something, then the rectifier.
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
        if x.size.channels != self.inputs || beside.is_some_and(|beside| beside.size != size) {
            let beside = beside.map(|beside| beside.size);
            return Err(TchError::Shape(format!("{:?} beside {beside:?}", x.size)));
        }
        let mut out = workspace.plane(size);
        // More channels need more tiles for each time that the weights are read.
        let block = whole_groups(size.tiles()).min(if self.inputs > 64 { 64 } else { 32 });
        if block == 0 {
            return Ok(out);
        }
        grow(&mut workspace.tiles, VALUES * (block * self.inputs + GAP));
        grow(
            &mut workspace.products,
            VALUES * (block * self.outputs + GAP),
        );
        Arch::new().dispatch(Work {
            convolution: self,
            x,
            beside: beside.map(|beside| beside.values.as_slice()),
            out: &mut out.values,
            block,
            workspace,
        });
        Ok(out)
    }
}

/// One convolution, for whichever vector instructions the processor has.
struct Work<'a> {
    convolution: &'a Winograd,
    x: &'a Plane,
    beside: Option<&'a [f32]>,
    out: &'a mut [f32],
    /// Tiles that go through together.
    block: usize,
    workspace: &'a mut Workspace,
}

impl WithSimd for Work<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Winograd {
            weight,
            bias,
            inputs,
            outputs,
        } = self.convolution;
        let constants = Constants::new(simd);
        let map = self.x.size;
        let all = map.tiles();
        let sizes = Sizes {
            inputs: *inputs,
            outputs: *outputs,
            between_tiles: self.block * inputs + GAP,
            between_products: self.block * outputs + GAP,
        };
        let Workspace {
            tiles, products, ..
        } = self.workspace;
        for first in (0..all).step_by(self.block) {
            let count = self.block.min(all - first);
            for index in 0..count {
                let to = (&mut tiles[index * inputs..], sizes.between_tiles);
                to_tile(
                    &constants,
                    &self.x.values,
                    &map.place(first + index),
                    *inputs,
                    to,
                );
            }
            product(simd, weight, tiles, products, count, &sizes);
            for index in 0..count {
                let from = (&products[index * outputs..], sizes.between_products);
                let add = (bias.as_slice(), self.beside);
                from_tile(&constants, from, &map.place(first + index), add, self.out);
            }
        }
    }
}

/// Where a tile is.
struct Place {
    /// Pixels before its picture.
    picture: usize,
    /// Its first row of outputs.
    top: usize,
    /// Its first column of outputs.
    left: usize,
    /// Of the picture.
    height: usize,
    width: usize,
}
