//! What can go wrong with a log.

use std::path::PathBuf;

/// Why a log could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum LogError {
    /// The file or the thread that writes it could not be created.
    #[error("{path}: the log could not be created")]
    Create {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: std::io::Error,
    },
    /// The file could not be read.
    #[error("{path}: cannot be read")]
    Read {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: std::io::Error,
    },
    /// The container could not be written.
    #[error("{path}: the log could not be written")]
    Write {
        /// The file.
        path: PathBuf,
        /// The container's reason.
        #[source]
        source: mcap::McapError,
    },
    /// A camera image could not be encoded.
    #[error("camera {camera}: the image could not be encoded: {reason}")]
    Image {
        /// Camera name.
        camera: String,
        /// Why not.
        reason: String,
    },
    /// The writer thread died.
    #[error("{path}: the log's writer thread has died")]
    WriterDied {
        /// The file.
        path: PathBuf,
    },
    /// The file is something else.
    #[error("{path}: not an MCAP file: it starts with other bytes than MCAP's magic")]
    NotMcap {
        /// The file.
        path: PathBuf,
    },
    /// The file is an MCAP file, but not one of ours.
    #[error("{path}: an MCAP file, but no Trocar log: {missing} is missing")]
    NotOurs {
        /// The file.
        path: PathBuf,
        /// What a log of ours would have.
        missing: String,
    },
    /// Bytes inside the file are not what was written.
    #[error("{path}: damaged at byte {offset}: {reason}")]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Where the damaged record begins.
        offset: u64,
        /// What is wrong.
        reason: String,
    },
}

impl LogError {
    /// Whether a file that was to be read is at fault, rather than the writing of one.
    #[must_use]
    pub const fn is_bad_input(&self) -> bool {
        match self {
            Self::Read { .. }
            | Self::NotMcap { .. }
            | Self::NotOurs { .. }
            | Self::Damaged { .. } => true,
            Self::Create { .. }
            | Self::Write { .. }
            | Self::Image { .. }
            | Self::WriterDied { .. } => false,
        }
    }
}
