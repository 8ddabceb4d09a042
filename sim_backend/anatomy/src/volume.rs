//! Groups a voxel, with background all around, so that every surface closes.

use crate::grid::Grid;
use crate::nifti::LabelVolume;

/// A volume of groups with a margin of one voxel of background.
#[derive(Clone, Debug)]
pub struct Padded {
    /// The lattice without the margin.
    pub grid: Grid,
    /// Voxels along the axes with the margin.
    pub dims: [usize; 3],
    /// A group a voxel, the first axis fastest; 0 is background.
    pub voxels: Vec<u8>,
}

impl Padded {
    /// `volume` with its margin.
    #[must_use]
    pub fn new(volume: LabelVolume) -> Self {
        let [width, height, _] = volume.grid.dims;
        let dims = volume.grid.dims.map(|side| side + 2);
        let mut voxels = vec![0; dims.iter().product()];
        for (row, line) in volume.voxels.chunks_exact(width).enumerate() {
            let (y, z) = (row % height + 1, row / height + 1);
            let start = 1 + dims[0] * (y + dims[1] * z);
            voxels[start..start + width].copy_from_slice(line);
        }
        Self {
            grid: volume.grid,
            dims,
            voxels,
        }
    }

    /// The index of a voxel; coordinates count the margin.
    #[must_use]
    pub const fn index(&self, x: usize, y: usize, z: usize) -> usize {
        x + self.dims[0] * (y + self.dims[1] * z)
    }

    /// Steps in `voxels` to the neighbour along each axis.
    #[must_use]
    pub const fn strides(&self) -> [usize; 3] {
        [1, self.dims[0], self.dims[0] * self.dims[1]]
    }

    /// Voxels by group number.
    #[must_use]
    pub fn counts(&self) -> Vec<u64> {
        let mut counts = vec![0; 256];
        for &group in &self.voxels {
            counts[usize::from(group)] += 1;
        }
        counts
    }
}
