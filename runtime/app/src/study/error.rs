//! Why a study could not be planned, run or reported.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use hal::config::ConfigError;

/// What is wrong with a study.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// Its file is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// One of its cells can't be: a task, a needle, an option that there is not.
    #[error("{path}: {cell}: {reason}")]
    BadCell {
        /// The study's file.
        path: String,
        /// The cell.
        cell: String,
        /// What is wrong with it.
        reason: String,
    },
    /// A training seed's demonstrations and the trials share seeds.
    #[error(
        "{path}: grid {grid}: trials have seeds {trials}, and recording {recording} may use {recorded}: nothing may be evaluated on what it was trained on"
    )]
    Overlap {
        /// The study's file.
        path: String,
        /// The grid.
        grid: String,
        /// The recording.
        recording: String,
        /// Seeds of the trials.
        trials: String,
        /// Seeds of the recording.
        recorded: String,
    },
    /// The folder holds another grid.
    #[error(
        "{folder}: holds grid {there} ({title}), and this is a shard of grid {here}: shards of one grid belong together; take another --out"
    )]
    OtherGrid {
        /// The folder.
        folder: PathBuf,
        /// The grid that is there.
        there: String,
        /// Its title.
        title: String,
        /// The grid that was asked for.
        here: String,
    },
    /// A result is not what was written.
    #[error("{path}: {reason}; {remedy}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        reason: String,
        /// What helps.
        remedy: &'static str,
    },
    /// Something is asked for that can't be.
    #[error("{0}")]
    BadArgument(String),
    /// The file system failed.
    #[error("{path}: {reason}")]
    Io {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        reason: String,
    },
}

impl StudyError {
    /// The file system failed at `path`.
    #[must_use]
    pub fn io(path: &Path, reason: impl Display) -> Self {
        Self::Io {
            path: path.to_owned(),
            reason: reason.to_string(),
        }
    }

    /// Whether the user's input is at fault.
    #[must_use]
    pub const fn is_bad_input(&self) -> bool {
        !matches!(self, Self::Io { .. })
    }
}
