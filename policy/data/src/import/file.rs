//! An HDF5 file: what is in it, and its tables of numbers.
//!
//! All files are foreign and may be damaged: extents, chunks and readings are bounded before the
//! library allocates, and its errors keep their text. Names are paths within the episode.

use std::path::Path;
use std::sync::Arc;

use hdf5_reader::error::Error;
use hdf5_reader::{
    Dataset, Datatype, ExternalLinkResolver, FileStorage, H5Type, Hdf5File, OpenOptions,
};

use super::ImportError;
use super::filters::{self, CHUNK_MAX};

/// Bytes that one reading may give.
pub(super) const READ_MAX: usize = 256 << 20;

/// Steps of an episode at most: several hours.
const STEPS_MAX: u64 = 1_000_000;

/// Numbers of a step at most.
const WIDTH_MAX: u64 = 64;

/// Chunks that are read at once at most; the reader keeps a list of them.
const CHUNKS_MAX: u64 = 1 << 18;

/// How many times a file's own size its data can be: what gzip can do at most.
const EXPANSION_MAX: u64 = 1032;

/// An open file, and where in it an episode is.
pub(super) struct Recording {
    file: Hdf5File,
    /// The file's size, which bounds what any dataset in it can claim.
    size_bytes: u64,
    /// The file, and the episode within it, for messages.
    pub(super) place: String,
    /// What the episode's names begin with.
    prefix: String,
}

/// What a link to another file leads to: nothing that is imported, and nothing that is left out
/// without a word.
struct NotFollowed;

impl ExternalLinkResolver for NotFollowed {
    fn resolve_external_link(&self, filename: &str) -> Result<Option<Hdf5File>, Error> {
        let text = format!("a link leads to the file {filename:?}; it has to be copied in");
        Err(Error::InvalidData(text))
    }
}

/// A table of numbers, row after row. Finite; row-major `[steps, width]`.
pub(super) struct Numbers {
    pub(super) values: Vec<f64>,
    pub(super) width: usize,
}

impl Numbers {
    /// Rows; `width` is at least 1 by [`Recording::numbers`].
    pub(super) fn steps(&self) -> usize {
        self.values.len() / self.width
    }
}

impl Recording {
    /// Opens `path`; the episode is the group `episode` in it, or all of it.
    pub(super) fn open(path: &Path, episode: Option<&str>) -> Result<Self, ImportError> {
        let shown = path.display().to_string();
        let refuse = |source| ImportError::Hdf5 {
            place: shown.clone(),
            what: "the file".to_owned(),
            source: Box::new(source),
        };
        let size_bytes = size_of(path)?;
        // Not mapped into memory: a file that is cut off meanwhile would end the program.
        let storage = Arc::new(FileStorage::open(path).map_err(refuse)?);
        let options = OpenOptions::default()
            .with_filter_registry(filters::registry())
            .with_external_link_resolver(Arc::new(NotFollowed))
            .with_max_chunk_bytes(CHUNK_MAX)
            .with_max_read_bytes(READ_MAX);
        let file = Hdf5File::from_storage_with_options(storage, options).map_err(refuse)?;
        Ok(Self {
            file,
            size_bytes,
            place: episode.map_or_else(|| shown.clone(), |episode| format!("{shown}, {episode}")),
            prefix: episode.map_or(String::new(), |episode| format!("{episode}/")),
        })
    }

    /// The names of what is in the group `name` of the episode, sorted; `None` if there is no such
    /// group.
    pub(super) fn members(&self, name: &str) -> Result<Option<Vec<String>>, ImportError> {
        let names = self
            .file
            .group(&format!("{}{name}", self.prefix))
            .and_then(|group| group.member_names());
        match names {
            Ok((groups, datasets)) => {
                let mut names = [groups, datasets].concat();
                names.sort_unstable();
                Ok(Some(names))
            }
            Err(error) if is_missing(&error) => Ok(None),
            Err(error) => Err(self.unreadable(name, error)),
        }
    }

    /// The episode's dataset `name`, whose extent the file can hold.
    pub(super) fn dataset(&self, name: &str) -> Result<Dataset, ImportError> {
        let dataset = self
            .file
            .dataset(&format!("{}{name}", self.prefix))
            .map_err(|error| match is_missing(&error) {
                true => ImportError::Missing {
                    place: self.place.clone(),
                    name: name.to_owned(),
                },
                false => self.unreadable(name, error),
            })?;
        let header = self.file.get_or_parse_header(dataset.address());
        let header = header.map_err(|error| self.unreadable(name, error))?;
        if let Some(found) = filters::defect(&header) {
            let expected =
                "gzip (1) or lzf (32000), with shuffle (2) and fletcher32 (3) or without";
            return Err(self.mismatch(name, found, expected));
        }
        self.check_extent(name, &dataset)?;
        Ok(dataset)
    }

    /// Refuses a `dataset` that no file of this size can hold.
    fn check_extent(&self, name: &str, dataset: &Dataset) -> Result<(), ImportError> {
        let shape = dataset.shape();
        let item = hdf5_reader::dtype_element_size(dataset.dtype())
            .map_err(|error| self.unreadable(name, error))?;
        let bytes = shape
            .iter()
            .try_fold(item as u64, |bytes, &extent| bytes.checked_mul(extent));
        let most = self.size_bytes.saturating_mul(EXPANSION_MAX);
        if bytes.is_none_or(|bytes| bytes > most) {
            let found = format!("has the shape {shape:?}");
            let expected = format!("what a file of {} bytes can hold", self.size_bytes);
            return Err(self.mismatch(name, found, expected));
        }
        Ok(())
    }

    /// Refuses a `dataset` of which `steps` read at once are in more pieces than fit into memory.
    ///
    /// The first axis counts steps; the others are read whole. Contiguous datasets have no chunks
    /// and pass.
    pub(super) fn check_chunks(
        &self,
        name: &str,
        dataset: &Dataset,
        steps: u64,
    ) -> Result<(), ImportError> {
        let Some(chunks) = dataset.chunks() else {
            return Ok(());
        };
        let extents = dataset
            .shape()
            .iter()
            .enumerate()
            .map(|(axis, &extent)| match axis {
                0 => steps.min(extent),
                _ => extent,
            });
        let pieces = extents
            .zip(&chunks)
            .try_fold(1_u64, |pieces, (extent, &chunk)| {
                pieces.checked_mul(extent.div_ceil(u64::from(chunk.max(1))))
            });
        if pieces.is_some_and(|pieces| pieces <= CHUNKS_MAX) {
            return Ok(());
        }
        let found = format!("of shape {:?} is in chunks of {chunks:?}", dataset.shape());
        let expected = format!("larger ones, so that {steps} steps are in at most {CHUNKS_MAX}");
        Err(self.mismatch(name, found, expected))
    }

    /// The dataset `name`, (steps, numbers) and finite.
    ///
    /// Of any float of 32 or 64 bits and any integer of up to 32, all exact in `f64`; 64-bit
    /// integers are refused.
    pub(super) fn numbers(&self, name: &str) -> Result<Numbers, ImportError> {
        let dataset = self.dataset(name)?;
        let width = match dataset.shape() {
            &[steps @ 1..=STEPS_MAX, width @ 1..=WIDTH_MAX] => {
                self.check_chunks(name, &dataset, steps)?;
                usize::try_from(width).ok()
            }
            _ => None,
        };
        let Some(width) = width else {
            let found = format!("has the shape {:?}", dataset.shape());
            let expected = format!("(steps, numbers), of at most {STEPS_MAX} and {WIDTH_MAX}");
            return Err(self.mismatch(name, found, expected));
        };
        let values = self.widened(&dataset);
        let values = values.map_err(|error| self.unreadable(name, error))?;
        let Some(values) = values else {
            let found = format!("is of {}", kind(dataset.dtype()));
            let expected = "floats of 32 or 64 bits, or integers of up to 32";
            return Err(self.mismatch(name, found, expected));
        };
        if let Some(place) = values.iter().position(|value| !value.is_finite()) {
            return Err(ImportError::NotFinite {
                place: self.place.clone(),
                name: name.to_owned(),
                step: place / width,
            });
        }
        Ok(Numbers { values, width })
    }

    /// All numbers of `dataset` in double precision; `None` if they are of no type that fits into
    /// it.
    fn widened(&self, dataset: &Dataset) -> Result<Option<Vec<f64>>, Error> {
        let dtype = dataset.dtype();
        Ok(Some(if let Datatype::FloatingPoint { size, .. } = dtype {
            match size {
                8 => all::<f64>(dataset)?,
                4 => all::<f32>(dataset)?,
                _ => return Ok(None),
            }
        } else if let Datatype::FixedPoint { size, signed, .. } = dtype {
            match (size, signed) {
                (1, true) => all::<i8>(dataset)?,
                (2, true) => all::<i16>(dataset)?,
                (4, true) => all::<i32>(dataset)?,
                (1, false) => all::<u8>(dataset)?,
                (2, false) => all::<u16>(dataset)?,
                (4, false) => all::<u32>(dataset)?,
                _ => return Ok(None),
            }
        } else {
            return Ok(None);
        }))
    }

    /// The library's reason why `name` can't be read.
    pub(super) fn unreadable(&self, name: &str, source: Error) -> ImportError {
        ImportError::Hdf5 {
            place: self.place.clone(),
            what: name.to_owned(),
            source: Box::new(source),
        }
    }

    /// `name` is not as it has to be.
    pub(super) fn mismatch(
        &self,
        name: &str,
        found: String,
        expected: impl Into<String>,
    ) -> ImportError {
        ImportError::Mismatch {
            place: self.place.clone(),
            name: name.to_owned(),
            found,
            expected: expected.into(),
        }
    }
}

/// The size of the file `path`, bytes.
fn size_of(path: &Path) -> Result<u64, ImportError> {
    let found = std::fs::metadata(path).and_then(|found| match found.is_file() {
        true => Ok(found.len()),
        false => Err(std::io::ErrorKind::IsADirectory.into()),
    });
    found.map_err(|source| ImportError::Io {
        path: path.to_owned(),
        source,
    })
}

/// The whole dataset, widened; `T` must be the stored type.
fn all<T: H5Type + Copy + Into<f64>>(dataset: &Dataset) -> Result<Vec<f64>, Error> {
    let values = dataset.read_array::<T>()?;
    Ok(values.iter().map(|&value| value.into()).collect())
}

/// What `dtype` is called.
pub(super) fn kind(dtype: &Datatype) -> String {
    if let Datatype::FloatingPoint { size, .. } = dtype {
        return format!("float{}", 8 * u32::from(*size));
    }
    if let Datatype::FixedPoint { size, signed, .. } = dtype {
        let unsigned = if *signed { "" } else { "u" };
        return format!("{unsigned}int{}", 8 * u32::from(*size));
    }
    "another type than numbers".to_owned()
}

/// Whether the library found nothing of that name, rather than something that it can't read.
fn is_missing(error: &Error) -> bool {
    if let Error::Context { source, .. } = error {
        return is_missing(source);
    }
    matches!(error, Error::GroupNotFound(_) | Error::DatasetNotFound(_))
}
