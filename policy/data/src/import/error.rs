//! Why demonstrations can't be imported.

use std::path::PathBuf;

use hal::config::ConfigError;

use crate::dataset::DatasetError;

/// What is wrong, and where. A `place` is a file, or a file and the episode within it.
#[derive(Debug, thiserror::Error)]
pub enum ImportError {
    /// Options that contradict each other, or say too little.
    #[error("{0}")]
    Options(String),
    /// The system refused.
    #[error("{path}: cannot be read")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: std::io::Error,
    },
    /// There is no episode.
    #[error("{path}: has no {expected}")]
    Empty {
        /// The file or folder.
        path: PathBuf,
        /// What an episode is called.
        expected: &'static str,
    },
    /// Not HDF5, damaged, or of a kind of HDF5 that is not read.
    #[error("{place}: {what} cannot be read as HDF5")]
    Hdf5 {
        /// Where.
        place: String,
        /// The dataset, or the whole file.
        what: String,
        /// The reader's reason.
        #[source]
        source: Box<hdf5_reader::error::Error>,
    },
    /// A dataset that is needed is not there.
    #[error("{place}: {name} is missing")]
    Missing {
        /// Where.
        place: String,
        /// The dataset's name.
        name: String,
    },
    /// Something is there, but not as it has to be.
    #[error("{place}: {name} {found}, expected {expected}")]
    Mismatch {
        /// Where.
        place: String,
        /// The dataset's name.
        name: String,
        /// What it has or is.
        found: String,
        /// What would be right.
        expected: String,
    },
    /// NaN or infinity.
    #[error("{place}: {name} has a number that is not finite in step {step}")]
    NotFinite {
        /// Where.
        place: String,
        /// The dataset's name.
        name: String,
        /// The step, from 0.
        step: usize,
    },
    /// A joint where the arm can't be.
    #[error(
        "{place}: {name} of arm {arm}: {joint} = {value:.4} in step {step} is outside [{min:.3}, {max:.3}]; six joints (rad, insertion m) and the jaw (rad) are expected"
    )]
    Outside {
        /// Where.
        place: String,
        /// The dataset's name.
        name: String,
        /// The arm, from 1.
        arm: usize,
        /// The joint's name.
        joint: &'static str,
        /// Its value, rad (m).
        value: f64,
        /// The step, from 0.
        step: usize,
        /// The joint's lower limit.
        min: f64,
        /// The joint's upper limit.
        max: f64,
    },
    /// A pose that is none.
    #[error(
        "{place}: {name} of arm {arm} has a quaternion of length {length:.4} in step {step}, expected 1: are these deltas?"
    )]
    Quaternion {
        /// Where.
        place: String,
        /// The dataset's name.
        name: String,
        /// The arm, from 1.
        arm: usize,
        /// The quaternion's length.
        length: f64,
        /// The step, from 0.
        step: usize,
    },
    /// A pose that the arm can't take.
    #[error("{place}: the tip pose of arm {arm} in step {step} is out of reach: {reason}")]
    Reach {
        /// Where.
        place: String,
        /// The arm, from 1.
        arm: usize,
        /// The step, from 0.
        step: usize,
        /// The joint that would be beyond its limits.
        reason: String,
    },
    /// A frame is no JPEG.
    #[error("{place}: {name}, step {step}: cannot be decoded as JPEG")]
    Jpeg {
        /// Where.
        place: String,
        /// The dataset's name.
        name: String,
        /// The step, from 0.
        step: usize,
        /// The codec's reason.
        #[source]
        source: image::ImageError,
    },
    /// The file with another arm's chain is wrong.
    #[error("{path}: {reason}")]
    Chain {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
    },
    /// The table of names is wrong.
    #[error(transparent)]
    Mapping(#[from] ConfigError),
    /// The new dataset can't be written.
    #[error(transparent)]
    Dataset(#[from] DatasetError),
}
