//! Groups a voxel, with background all around, so that every surface closes.
//!
//! Two frames of voxel coordinates follow from the margin: padded voxel `(x, y, z)` is voxel
//! `(x - 1, y - 1, z - 1)` of the grid. Surfaces give vertices in the grid's, distances are
//! measured in the padded one.

use crate::grid::Grid;
use crate::nifti::LabelVolume;

/// A volume of groups with a margin of one voxel of background.
///
/// Invariant: all voxels in the outermost layer are 0. Repairs keep it, and surface nets, which
/// look only backwards from voxel 1 on, rely on it to close every surface. Groups are at most 31.
#[derive(Clone, Debug)]
pub struct Padded {
    /// The lattice without the margin: `grid.world` takes unpadded coordinates.
    pub grid: Grid,
    /// Voxels along the axes with the margin.
    pub dims: [usize; 3],
    /// A group a voxel, the first axis fastest; 0 is background. As many as the product of `dims`.
    pub voxels: Vec<u8>,
}

impl Padded {
    /// `volume` with its margin.
    ///
    /// The voxels are copied row by row; both volumes are held for a moment. Panics if the volume
    /// has no voxel in a row.
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
    ///
    /// No bounds are checked here; the look-up in `voxels` does.
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
    ///
    /// 256 numbers, one for each value of a byte; entry 0 counts the margin with the background.
    /// O(n).
    #[must_use]
    pub fn counts(&self) -> Vec<u64> {
        let mut counts = vec![0; 256];
        for &group in &self.voxels {
            counts[usize::from(group)] += 1;
        }
        counts
    }
}
