//! Volumes read a slice at a time.
//!
//! gzip is told by its first two bytes, not by the name. Voxels become `f64` whatever the file's
//! type: exact for all integers of 32 bits, so that labels can be checked for being whole.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{self, BufRead, BufReader, Read};
use std::path::Path;

use flate2::bufread::MultiGzDecoder;

use super::NiftiError;
use super::header::{DataType, HEADER_LEN, Header};
use crate::grid::Grid;
use crate::groups::Groups;
use crate::number::label;

/// A volume of groups: 0 for background, else the group's index in [`Groups::groups`] plus 1; the
/// first axis runs fastest.
///
/// It is only made of whole volumes: `voxels.len() == grid.len()`.
#[derive(Clone, Debug)]
pub struct LabelVolume {
    /// Where its voxels lie.
    pub grid: Grid,
    /// A group a voxel.
    pub voxels: Vec<u8>,
}

/// A failure to read, with the file's name.
fn file_error(path: &Path, source: io::Error) -> NiftiError {
    NiftiError::Unreadable {
        path: path.display().to_string(),
        source,
    }
}

/// The bytes of `path`, out of gzip if it is that.
///
/// Several gzip members one after another are one stream, as bgzip writes them. Pipes and devices
/// are refused, since they could block.
fn open(path: &Path) -> Result<Box<dyn Read>, NiftiError> {
    let unreadable = |source| file_error(path, source);
    let found = std::fs::metadata(path).map_err(unreadable)?;
    if !found.is_file() {
        return Err(unreadable(io::Error::other("it is no file")));
    }
    let mut file = BufReader::with_capacity(1 << 16, File::open(path).map_err(unreadable)?);
    let zipped = file
        .fill_buf()
        .map_err(unreadable)?
        .starts_with(&[0x1f, 0x8b]);
    Ok(if zipped {
        Box::new(BufReader::with_capacity(1 << 16, MultiGzDecoder::new(file)))
    } else {
        Box::new(file)
    })
}

/// The header, and the reader behind it.
fn begin(path: &Path) -> Result<(Header, Box<dyn Read>), NiftiError> {
    let mut reader = open(path)?;
    let mut bytes = [0; HEADER_LEN];
    reader.read_exact(&mut bytes).map_err(|error| {
        let short = error.kind() == io::ErrorKind::UnexpectedEof;
        let reason = || io::Error::other("it ends within the header of 348 bytes");
        file_error(path, if short { reason() } else { error })
    })?;
    let header = Header::parse(&path.display().to_string(), &bytes)?;
    Ok((header, reader))
}

/// What the header of `path` says; voxels are not looked at.
///
/// # Errors
/// [`NiftiError`] if the file can't be read or its header is not allowed.
pub fn read_header(path: &Path) -> Result<Header, NiftiError> {
    Ok(begin(path)?.0)
}

/// Values of `bytes`.
///
/// Values are `slope * stored + intercept`; the product is left out where it changes nothing.
/// `values` is cleared and its room used again.
fn decode(header: &Header, bytes: &[u8], values: &mut Vec<f64>) {
    values.clear();
    macro_rules! numbers {
        ($kind:ty) => {
            values.extend(bytes.chunks_exact(size_of::<$kind>()).map(|chunk| {
                let mut whole = [0; size_of::<$kind>()];
                whole.copy_from_slice(chunk);
                f64::from(if header.big_endian {
                    <$kind>::from_be_bytes(whole)
                } else {
                    <$kind>::from_le_bytes(whole)
                })
            }))
        };
    }
    match header.data_type {
        DataType::U8 => numbers!(u8),
        DataType::I8 => numbers!(i8),
        DataType::U16 => numbers!(u16),
        DataType::I16 => numbers!(i16),
        DataType::U32 => numbers!(u32),
        DataType::I32 => numbers!(i32),
        DataType::F32 => numbers!(f32),
        DataType::F64 => numbers!(f64),
    }
    let scaled = (header.slope - 1.0).abs() > 0.0 || header.intercept.abs() > 0.0;
    if scaled {
        for value in values {
            *value = header.slope * *value + header.intercept;
        }
    }
}

/// Gives `slice` each slice across the third axis in order, with its index and its values, the
/// first axis fastest.
///
/// Memory is that of one slice.
///
/// # Errors
/// [`NiftiError`] if the file can't be read, is cut or not allowed, or what `slice` returns.
pub fn read_slices(
    path: &Path,
    mut slice: impl FnMut(&Header, usize, &[f64]) -> Result<(), NiftiError>,
) -> Result<Header, NiftiError> {
    let (header, mut reader) = begin(path)?;
    let cut = |z: usize| NiftiError::Cut {
        path: path.display().to_string(),
        slice: z + 1,
        slices: header.grid.dims[2],
    };
    let failed = |z: usize, error: io::Error| {
        if error.kind() == io::ErrorKind::UnexpectedEof {
            cut(z)
        } else {
            file_error(path, error)
        }
    };
    let mut gap = vec![0; header.offset - HEADER_LEN];
    reader
        .read_exact(&mut gap)
        .map_err(|error| failed(0, error))?;
    let mut bytes = vec![0; header.grid.slice_len() * header.data_type.size()];
    let mut values = Vec::with_capacity(header.grid.slice_len());
    for z in 0..header.grid.dims[2] {
        reader
            .read_exact(&mut bytes)
            .map_err(|error| failed(z, error))?;
        decode(&header, &bytes, &mut values);
        slice(&header, z, &values)?;
    }
    // What follows the voxels is nobody's, but gzip has its checksum there.
    let last = header.grid.dims[2] - 1;
    reader.read(&mut [0]).map_err(|error| failed(last, error))?;
    Ok(header)
}

/// Labels that `groups` does not have, with their voxels, as text.
///
/// The ten lowest by name, the others by number.
fn unknown_text(unknown: &BTreeMap<u16, u64>) -> String {
    let mut names: Vec<String> = unknown
        .iter()
        .take(10)
        .map(|(label, voxels)| format!("label {label} ({voxels} voxels)"))
        .collect();
    if unknown.len() > 10 {
        names.push(format!("{} more", unknown.len() - 10));
    }
    names.join(", ")
}

/// The labels of `path` as groups.
///
/// Memory is a byte a voxel and one slice. All unknown labels are gathered before the volume is
/// refused, so that one run shows what a table lacks; a voxel that is no label ends it at once.
///
/// # Errors
/// [`NiftiError`]: besides what [`read_slices`] refuses, voxels that are no labels and labels that
/// `groups` does not know.
pub fn read_labels(path: &Path, groups: &Groups) -> Result<LabelVolume, NiftiError> {
    let mut voxels = Vec::new();
    let mut unknown = BTreeMap::new();
    let header = read_slices(path, |header, z, values| {
        for (i, &value) in values.iter().enumerate() {
            let found = label(value).ok_or_else(|| NiftiError::NoLabel {
                path: path.display().to_string(),
                voxel: [i % header.grid.dims[0], i / header.grid.dims[0], z],
                value,
            })?;
            voxels.push(groups.group_of(found).unwrap_or_else(|| {
                *unknown.entry(found).or_insert(0) += 1;
                0
            }));
        }
        Ok(())
    })?;
    if !unknown.is_empty() {
        return Err(NiftiError::Unknown {
            path: path.display().to_string(),
            table: groups.table.clone(),
            labels: unknown_text(&unknown),
        });
    }
    Ok(LabelVolume {
        grid: header.grid,
        voxels,
    })
}
