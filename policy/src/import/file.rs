//! An HDF5 file: what is in it, and its tables of numbers.

use std::path::Path;
use std::sync::Arc;

use hdf5_reader::error::Error;
use hdf5_reader::{Dataset, Datatype, FileStorage, H5Type, Hdf5File, OpenOptions};

use super::ImportError;
use super::filters::{self, CHUNK_MAX};

/// Bytes that one reading may give.
pub(super) const READ_MAX: usize = 256 << 20;

/// How many times a file's own size its data can be: what gzip can do at most.
const EXPANSION_MAX: u64 = 1032;

/// An open file, and where in it an episode is.
pub(super) struct Recording {
    file: Hdf5File,
    size_bytes: u64,
    /// The file, and the episode within it, for messages.
    pub(super) place: String,
    /// What the episode's names begin with.
    prefix: String,
}

/// A table of numbers, row after row.
pub(super) struct Numbers {
    pub(super) values: Vec<f64>,
    pub(super) width: usize,
}

impl Numbers {
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
        let size_bytes = std::fs::metadata(path)
            .and_then(|found| match found.is_file() {
                true => Ok(found.len()),
                false => Err(std::io::ErrorKind::IsADirectory.into()),
            })
            .map_err(|source| ImportError::Io {
                path: path.to_owned(),
                source,
            })?;
        // Not mapped into memory: a file that is cut off meanwhile would end the program.
        let storage = Arc::new(FileStorage::open(path).map_err(refuse)?);
        let options = OpenOptions::default()
            .with_filter_registry(filters::registry())
            .with_max_chunk_bytes(CHUNK_MAX)
            .with_max_read_bytes(READ_MAX);
        let file = Hdf5File::from_storage_with_options(storage, options).map_err(refuse)?;
        Ok(Self {
            file,
            size_bytes,
            place: match episode {
                Some(episode) => format!("{shown}, {episode}"),
                None => shown.clone(),
            },
            prefix: episode.map_or(String::new(), |episode| format!("{episode}/")),
        })
    }

    /// The names of what is in the group `name` of the episode, sorted; `None` if there is no such group.
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
        Ok(dataset)
    }

    /// The dataset `name`, (steps, numbers) and finite.
    pub(super) fn numbers(&self, name: &str) -> Result<Numbers, ImportError> {
        let dataset = self.dataset(name)?;
        let width = match dataset.shape() {
            &[steps, width] if steps > 0 && width > 0 => usize::try_from(width).ok(),
            _ => None,
        };
        let Some(width) = width else {
            let found = format!("has the shape {:?}", dataset.shape());
            return Err(self.mismatch(name, found, "(steps, numbers)"));
        };
        let values = self
            .widened(&dataset)
            .map_err(|error| self.unreadable(name, error))?;
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

    /// All numbers of `dataset` in double precision; `None` if they are of no type that fits into it.
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
