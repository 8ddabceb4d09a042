//! CT values on the lattice of a scan.
//!
//! The struct lies apart from [`crate::ct`], which reads it, so that the DICOM reader can make one
//! without knowing NIfTI.

use crate::grid::Grid;

/// A volume of CT values.
///
/// Hounsfield units: -1000 is air, 0 water.
#[derive(Clone, Debug)]
pub struct Ct {
    /// Where its voxels lie.
    pub grid: Grid,
    /// Values, HU, the first axis fastest, `grid.len()` of them. All finite where [`Ct::read`] made
    /// it; `dicom::read_series` alone does not check that.
    pub hounsfield: Vec<f32>,
}
