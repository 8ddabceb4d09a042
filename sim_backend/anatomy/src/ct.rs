//! A CT: NIfTI, or a folder with a DICOM series.
//!
//! Both come out as the same lattice and HU values. The NIfTI values are what the header's slope
//! and intercept make of the stored numbers; they are taken for HU without a check, since nothing
//! in such a file says so. Segmentation reads CTs; the mesh pipeline reads label volumes and never
//! comes here.

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
    /// A voxel is NaN or infinite, as floating-point NIfTI files may hold outside of the field of
    /// view.
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
    /// A CT of a gigavoxel takes 4 GiB: values are kept in single precision, which holds every
    /// 16-bit CT value exactly.
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
