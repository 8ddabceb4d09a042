//! A CT: NIfTI, or a folder with a DICOM series.

use std::path::Path;

use crate::dicom::{self, DicomError};
use crate::nifti::{NiftiError, read_slices};
use crate::number::single;

pub use crate::hounsfield::Ct;

/// Why a CT is refused.
#[derive(Debug, thiserror::Error)]
pub enum CtError {
    /// The NIfTI file is.
    #[error(transparent)]
    Nifti(#[from] NiftiError),
    /// The DICOM series is.
    #[error(transparent)]
    Dicom(#[from] DicomError),
    /// A voxel is not a number.
    #[error("{path}: voxel {voxel:?} is {value}, no CT value")]
    NoNumber {
        /// The file or folder.
        path: String,
        /// Its indices, from 0.
        voxel: [usize; 3],
        /// What it is.
        value: f32,
    },
}

impl Ct {
    /// Reads `path`: `.nii`, `.nii.gz`, or a folder with one DICOM series.
    ///
    /// # Errors
    /// [`CtError`].
    pub fn read(path: &Path) -> Result<Self, CtError> {
        let ct = if path.is_dir() {
            dicom::read_series(path)?
        } else {
            let mut hounsfield = Vec::new();
            let header = read_slices(path, |_, _, values| {
                hounsfield.extend(values.iter().map(|value| single(*value)));
                Ok(())
            })?;
            let grid = header.grid;
            Self { grid, hounsfield }
        };
        let wrong = ct.hounsfield.iter().position(|value| !value.is_finite());
        match wrong {
            None => Ok(ct),
            Some(at) => {
                let [x, y, _] = ct.grid.dims;
                Err(CtError::NoNumber {
                    path: path.display().to_string(),
                    voxel: [at % x, at / x % y, at / x / y],
                    value: ct.hounsfield[at],
                })
            }
        }
    }
}
