//! What can be wrong with a dataset, named by file.
//!
//! A message does not repeat the text of its source error: a caller prints the whole chain. Nothing
//! here is on a real-time path; strings are owned.

use std::{io, path::PathBuf};

/// Why a dataset can't be written or read.
///
/// Damage and disagreement are [`Self::Mismatch`] or one of the parser's variants, never a panic;
/// what a caller gives that can't be stored or opened is [`Self::Input`]. Only a frame or an arm
/// beyond the last panics.
#[derive(Debug, thiserror::Error)]
pub enum DatasetError {
    /// A file is missing, or the system refused.
    #[error("{path}: cannot be read or written")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: io::Error,
    },
    /// A recording would overwrite something.
    #[error("{path}: exists and is not an empty folder; a recording starts in a new one")]
    Exists {
        /// The folder.
        path: PathBuf,
    },
    /// There is no recording to go on with.
    #[error("{path}: is no dataset that a recording could go on with: it has no meta/info.json")]
    NoRecording {
        /// The folder.
        path: PathBuf,
    },
    /// A recording can't go on as another one.
    #[error("{path}: was recorded with {what} {recorded}, now {asked} is asked for")]
    Differs {
        /// The folder.
        path: PathBuf,
        /// The part of the specification.
        what: String,
        /// What it was.
        recorded: String,
        /// What it is to be.
        asked: String,
    },
    /// Datasets that are no parts of one.
    #[error("{first} and {other} do not go together: {difference}")]
    Apart {
        /// The folder of the first dataset.
        first: PathBuf,
        /// The folder of the other.
        other: PathBuf,
        /// What differs, and what it is in each.
        difference: String,
    },
    /// Two recordings at once would spoil each other.
    #[error("{path}: another recording is writing there")]
    Busy {
        /// The folder.
        path: PathBuf,
    },
    /// A JSON file that is damaged, or lacks a key.
    #[error("{path}: malformed")]
    Json {
        /// The file.
        path: PathBuf,
        /// The parser's reason, with line and column.
        #[source]
        source: serde_json::Error,
    },
    /// A parquet file that is damaged or cut off.
    #[error("{path}: not a whole parquet file")]
    Parquet {
        /// The file.
        path: PathBuf,
        /// The reader's reason.
        #[source]
        source: parquet::errors::ParquetError,
    },
    /// A video that is missing, damaged, or shows no frame when it should; or there is no program
    /// to read or write it.
    #[error("{path}: {what}")]
    Video {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        what: String,
    },
    /// Another generation of the format.
    #[error("{path}: codebase_version is \"{found}\", this program reads {expected}")]
    Version {
        /// The file.
        path: PathBuf,
        /// The version found.
        found: String,
        /// The versions that are read.
        expected: String,
    },
    /// A column or feature that has to be there is not.
    #[error("{path}: {name} is missing")]
    Missing {
        /// The file.
        path: PathBuf,
        /// Name of the column or feature.
        name: String,
    },
    /// Something is there, but not as it has to be.
    #[error("{path}: {what} is {found}, expected {expected}")]
    Mismatch {
        /// The file.
        path: PathBuf,
        /// The column, feature or count.
        what: String,
        /// What was found.
        found: String,
        /// What would be right.
        expected: String,
    },
    /// An image can't be encoded or decoded.
    #[error("image {what}: cannot be encoded or decoded")]
    Image {
        /// Which image.
        what: String,
        /// The codec's reason.
        #[source]
        source: image::ImageError,
    },
    /// A frame or specification given to the writer doesn't fit.
    #[error("{what} is {found}, expected {expected}")]
    Input {
        /// Which part.
        what: String,
        /// What was given.
        found: String,
        /// What would fit.
        expected: String,
    },
}

/// Something in `path` that is not as it must be.
pub(super) fn mismatch(
    path: PathBuf,
    what: &str,
    found: impl ToString,
    expected: impl ToString,
) -> DatasetError {
    DatasetError::Mismatch {
        path,
        what: what.to_owned(),
        found: found.to_string(),
        expected: expected.to_string(),
    }
}
