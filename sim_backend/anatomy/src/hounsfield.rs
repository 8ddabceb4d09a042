//! CT values on the lattice of a scan.

use crate::grid::Grid;

/// A volume of CT values.
#[derive(Clone, Debug)]
pub struct Ct {
    /// Where its voxels lie.
    pub grid: Grid,
    /// Values, HU, the first axis fastest.
    pub hounsfield: Vec<f32>,
}
