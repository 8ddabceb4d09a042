//! Why a session could not begin or go on.

use std::fmt::Display;
use std::path::Path;

use hal::config::ConfigError;
use hal::{ArmError, PolicyError};

/// Everything that ends a session early.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// A configuration is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The checkpoint can't be used.
    #[error(transparent)]
    Checkpoint(#[from] policy::checkpoint::CheckpointError),
    /// The dataset can't be used.
    #[error(transparent)]
    Dataset(#[from] policy::dataset::DatasetError),
    /// Training failed.
    #[error(transparent)]
    Train(#[from] policy::train::TrainError),
    /// The log can't be used.
    #[error(transparent)]
    Log(#[from] crate::log::LogError),
    /// The log can't be replayed.
    #[error(transparent)]
    Replay(#[from] crate::replay::ReplayError),
    /// The log can't be verified.
    #[error(transparent)]
    Verify(#[from] crate::verify::VerifyError),
    /// The log ends in the middle; what is there was used.
    #[error("{path}: the log is cut off ({reason}); the result is for what is there")]
    CutLog {
        /// The log.
        path: String,
        /// Where and how.
        reason: String,
    },
    /// The simulator failed.
    #[error(transparent)]
    Simulation(#[from] sim_backend::simulation::SimulationError),
    /// The policy failed.
    #[error(transparent)]
    Policy(#[from] PolicyError),
    /// The arm failed.
    #[error(transparent)]
    Arm(#[from] ArmError),
    /// The policy was trained with a camera that the task lacks.
    #[error("the policy needs camera {name:?}, the task has {available}")]
    UnknownCamera {
        /// What the policy wants.
        name: String,
        /// What there is.
        available: String,
    },
    /// An argument makes no sense.
    #[error("{0}")]
    BadArgument(String),
    /// A result could not be written.
    #[error("{path}: cannot be written: {reason}")]
    Output {
        /// The file.
        path: String,
        /// The system's reason.
        reason: String,
    },
    /// A topic failed.
    #[error(transparent)]
    Topic(#[from] hal::topic::TopicError),
    /// The real-time parts failed.
    #[error("{0}")]
    RealTime(String),
}

impl SessionError {
    /// An output error for `path`.
    #[must_use]
    pub fn output(path: &Path, reason: impl Display) -> Self {
        Self::Output {
            path: path.display().to_string(),
            reason: reason.to_string(),
        }
    }

    /// Whether the user's input is at fault, rather than the work itself.
    #[must_use]
    pub const fn is_bad_input(&self) -> bool {
        match self {
            Self::Config(_)
            | Self::Checkpoint(_)
            | Self::Dataset(_)
            | Self::Log(_)
            | Self::Replay(_)
            | Self::Verify(_)
            | Self::CutLog { .. }
            | Self::UnknownCamera { .. }
            | Self::BadArgument(_) => true,
            Self::Train(_)
            | Self::Simulation(_)
            | Self::Topic(_)
            | Self::Policy(_)
            | Self::Arm(_)
            | Self::Output { .. }
            | Self::RealTime(_) => false,
        }
    }
}
