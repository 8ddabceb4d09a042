//! Volumes written a slice at a time.
//!
//! The header comes first and says how many slices there are, so a file that lacks some is refused
//! as cut when it is read.

use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::GzEncoder;

use super::NiftiError;
use super::header::{DataType, Header};
use crate::grid::Grid;

/// Where bytes go.
enum Sink {
    Plain(BufWriter<File>),
    Zipped(Box<GzEncoder<BufWriter<File>>>),
}

/// A volume being written: a header, then slices across the third axis in order.
pub struct Writer {
    /// For messages.
    path: PathBuf,
    sink: Sink,
    /// Slices that the header has promised and that have not come.
    slices_left: usize,
    /// Bytes of each slice.
    slice_bytes: usize,
}

impl Writer {
    /// Begins `path` (gzip if it ends with `.gz`) with the header of a volume of `data_type` on
    /// `grid`.
    ///
    /// An existing file is replaced. gzip is at its fastest level.
    ///
    /// # Errors
    /// [`NiftiError::Unwritable`].
    ///
    /// # Panics
    /// If a side of `grid` does not fit the header's 16 bits; [`SIDE_MAX`](super::SIDE_MAX) does.
    pub fn create(path: &Path, grid: &Grid, data_type: DataType) -> Result<Self, NiftiError> {
        let unwritable = |source| NiftiError::Unwritable {
            path: path.display().to_string(),
            source,
        };
        let file = BufWriter::with_capacity(1 << 20, File::create(path).map_err(unwritable)?);
        let zipped = path.extension().is_some_and(|extension| extension == "gz");
        let mut writer = Self {
            path: path.to_owned(),
            sink: if zipped {
                Sink::Zipped(Box::new(GzEncoder::new(file, Compression::fast())))
            } else {
                Sink::Plain(file)
            },
            slices_left: grid.dims[2],
            slice_bytes: grid.slice_len() * data_type.size(),
        };
        writer.put(&Header::bytes(grid, data_type))?;
        // No extensions.
        writer.put(&[0; 4])?;
        Ok(writer)
    }

    /// Writes through gzip or straight.
    fn put(&mut self, bytes: &[u8]) -> Result<(), NiftiError> {
        let written = match &mut self.sink {
            Sink::Plain(file) => file.write_all(bytes),
            Sink::Zipped(file) => file.write_all(bytes),
        };
        written.map_err(|source| self.unwritable(source))
    }

    fn unwritable(&self, source: io::Error) -> NiftiError {
        NiftiError::Unwritable {
            path: self.path.display().to_string(),
            source,
        }
    }

    /// The next slice, little-endian, the first axis fastest.
    ///
    /// # Errors
    /// [`NiftiError::Unwritable`].
    ///
    /// # Panics
    /// If it has another length than a slice, or there is none left to write.
    pub fn slice(&mut self, bytes: &[u8]) -> Result<(), NiftiError> {
        assert_eq!(bytes.len(), self.slice_bytes, "a whole slice");
        assert!(self.slices_left > 0, "no more slices than the header says");
        self.slices_left -= 1;
        self.put(bytes)
    }

    /// Ends the file.
    ///
    /// What gzip and the buffer hold is written only here.
    ///
    /// # Errors
    /// [`NiftiError::Unwritable`].
    ///
    /// # Panics
    /// If slices are missing.
    pub fn finish(self) -> Result<(), NiftiError> {
        assert_eq!(self.slices_left, 0, "all slices are written");
        let path = self.path.display().to_string();
        let ended = match self.sink {
            Sink::Plain(mut file) => file.flush(),
            Sink::Zipped(file) => file.finish().and_then(|mut file| file.flush()),
        };
        ended.map_err(|source| NiftiError::Unwritable { path, source })
    }
}

/// Writes `voxels`, of which each stands for the label at its index, as a label volume of 8 bits,
/// or of 16 if a label needs them.
///
/// `voxels` in the order of `grid`; one slice is converted at a time.
///
/// # Errors
/// [`NiftiError::Unwritable`].
///
/// # Panics
/// If there are not as many voxels as `grid` has, or a voxel has no label.
pub fn write_labels(
    path: &Path,
    grid: &Grid,
    voxels: &[u8],
    labels: &[u16],
) -> Result<(), NiftiError> {
    assert_eq!(voxels.len(), grid.len(), "a label a voxel");
    let small = labels.iter().all(|label| u8::try_from(*label).is_ok());
    let kind = if small { DataType::U8 } else { DataType::U16 };
    let mut writer = Writer::create(path, grid, kind)?;
    for slice in voxels.chunks_exact(grid.slice_len()) {
        let found = slice
            .iter()
            .map(|voxel| labels[usize::from(*voxel)].to_le_bytes());
        let bytes: Vec<u8> = if small {
            found.map(|[low, _]| low).collect()
        } else {
            found.flatten().collect()
        };
        writer.slice(&bytes)?;
    }
    writer.finish()
}
