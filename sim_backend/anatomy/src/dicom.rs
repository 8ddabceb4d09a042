//! A CT from a folder with a DICOM series: one slice a file, uncompressed.
//!
//! Files are put in order by where they are in the patient, not by name or number. A series that is
//! mixed with another, lacks a slice or has two at one place is refused: meshes of it would be
//! wrong and look right.
//!
//! Files are read twice: first the attributes that place the slice (`attributes`, by way of
//! `elements`), then, in order, the pixels. So only one slice's bytes are held besides the volume.
//! A value is `slope * stored + intercept` (PS3.3, C.11.1), in HU for CT; the lattice goes from
//! DICOM's LPS to RAS in `arrange`, by the signs of x and y alone.

mod arrange;
mod attributes;
mod elements;
#[cfg(test)]
mod tests;

use std::fs::{self, File};
use std::io::{self, Read};
use std::path::Path;

use dicom_dictionary_std::tags;

use arrange::arrange;
use attributes::{Attributes, READ, Slice};
use elements::{Wanted, read};

use crate::hounsfield::Ct;
use crate::number::single;

/// Why a series is refused.
#[derive(Debug, thiserror::Error)]
pub enum DicomError {
    /// The folder or a file can't be read.
    #[error("{path}: cannot be read")]
    Unreadable {
        /// The file or folder.
        path: String,
        /// The system's reason.
        #[source]
        source: io::Error,
    },
    /// A file is not what a slice should be.
    #[error("{path}: {reason}")]
    File {
        /// The file.
        path: String,
        /// What is wrong.
        reason: String,
    },
    /// The files are no volume.
    #[error("{folder}: {reason}")]
    Series {
        /// The folder.
        folder: String,
        /// What is wrong.
        reason: String,
    },
}

fn unreadable(path: &Path, source: io::Error) -> DicomError {
    DicomError::Unreadable {
        path: path.display().to_string(),
        source,
    }
}

/// Whether `path` begins as a DICOM file does.
fn is_dicom(path: &Path) -> Result<bool, DicomError> {
    let mut start = [0; 132];
    let read = File::open(path).and_then(|mut file| file.read_exact(&mut start));
    match read {
        Ok(()) => Ok(start.ends_with(b"DICM")),
        Err(error) if error.kind() == io::ErrorKind::UnexpectedEof => Ok(false),
        Err(error) => Err(unreadable(path, error)),
    }
}

/// The slices of `folder`; what is no DICOM file, or an index of some, is passed over.
fn slices(folder: &Path) -> Result<Vec<Slice>, DicomError> {
    let entries = fs::read_dir(folder).map_err(|error| unreadable(folder, error))?;
    let paths = entries.map(|entry| entry.map(|entry| entry.path()));
    let mut paths = paths
        .collect::<Result<Vec<_>, _>>()
        .map_err(|error| unreadable(folder, error))?;
    paths.sort();
    let mut slices = Vec::new();
    for path in paths {
        let index = path.file_name().is_some_and(|name| name == "DICOMDIR");
        if index || !path.is_file() || !is_dicom(&path)? {
            continue;
        }
        let object = &read(&path, &Wanted::Attributes(&READ))?;
        let path = path.as_path();
        slices.push(Attributes { path, object }.slice()?);
    }
    Ok(slices)
}

/// The values of a slice, HU.
fn hounsfield(slice: &Slice, values: &mut Vec<f32>) -> Result<(), DicomError> {
    let object = read(&slice.path, &Wanted::Pixels)?;
    let wrong = |reason: String| DicomError::File {
        path: slice.path.display().to_string(),
        reason,
    };
    let pixels = object
        .element(tags::PIXEL_DATA)
        .map_err(|_| wrong("PixelData is missing".to_owned()))?;
    let bytes = pixels
        .to_bytes()
        .map_err(|error| wrong(format!("PixelData: {error}")))?;
    let expected = 2 * slice.columns * slice.rows;
    if bytes.len() != expected {
        return Err(wrong(format!(
            "PixelData has {} bytes, {} x {} pixels have {expected}",
            bytes.len(),
            slice.columns,
            slice.rows
        )));
    }
    let unused = 16 - slice.bits_stored;
    let (pairs, _) = bytes.as_chunks::<2>();
    values.extend(pairs.iter().map(|pair| {
        let shifted = u16::from_le_bytes(*pair) << unused;
        let stored = if slice.signed {
            f64::from(shifted.cast_signed() >> unused)
        } else {
            f64::from(shifted >> unused)
        };
        single(slice.slope * stored + slice.intercept)
    }));
    Ok(())
}

/// Reads the series in `folder`; folders in it are not looked into.
///
/// # Errors
/// [`DicomError`] naming the file, or the folder and what does not fit together.
pub fn read_series(folder: &Path) -> Result<Ct, DicomError> {
    let mut slices = slices(folder)?;
    let grid = arrange(folder, &mut slices)?;
    let mut values = Vec::with_capacity(grid.len());
    for slice in &slices {
        hounsfield(slice, &mut values)?;
    }
    Ok(Ct {
        grid,
        hounsfield: values,
    })
}
