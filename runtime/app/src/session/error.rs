//! Why a session could not begin or go on.

use std::fmt::Display;
use std::path::Path;

use hal::config::ConfigError;
use hal::{ArmError, PolicyError};
use trocar_anatomy::nifti::NiftiError;
use trocar_nets::segmenter::SegmentError;
use trocar_topics::TopicError;
use trocar_train::TrainError;

use super::import_log::LogImportError;

/// Everything that ends a session early.
#[derive(Debug, thiserror::Error)]
pub enum SessionError {
    /// A configuration is wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The checkpoint can't be used.
    #[error(transparent)]
    Checkpoint(#[from] trocar_nets::checkpoint::CheckpointError),
    /// The dataset can't be used.
    #[error(transparent)]
    Dataset(#[from] trocar_data::dataset::DatasetError),
    /// The demonstrations can't be imported.
    #[error(transparent)]
    Import(#[from] trocar_data::import::ImportError),
    /// Run logs can't be imported.
    #[error(transparent)]
    ImportLog(Box<LogImportError>),
    /// Training failed.
    #[error(transparent)]
    Train(#[from] TrainError),
    /// The log can't be used.
    #[error(transparent)]
    Log(#[from] trocar_log::LogError),
    /// The log can't be replayed.
    #[error(transparent)]
    Replay(#[from] trocar_log::replay::ReplayError),
    /// The log can't be verified.
    #[error(transparent)]
    Verify(#[from] trocar_log::verify::VerifyError),
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
    Simulation(#[from] trocar_tasks::SimulationError),
    /// The policy failed.
    #[error(transparent)]
    Policy(PolicyError),
    /// The control thread does not get what `config/realtime.toml` insists on.
    #[error(transparent)]
    Refused(#[from] crate::rt::RtRefused),
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
    /// Too few of the demonstrator's attempts succeeded.
    #[error("only {kept} of {attempts} attempts succeeded")]
    Unproductive {
        /// Successful attempts.
        kept: usize,
        /// All attempts.
        attempts: u64,
    },
    /// A patient can't be made of a scan.
    #[error(transparent)]
    Anatomy(#[from] trocar_anatomy::build::BuildError),
    /// A CT can't be read.
    #[error(transparent)]
    Ct(#[from] trocar_anatomy::ct::CtError),
    /// A CT can't be segmented.
    #[error(transparent)]
    Segment(#[from] SegmentError),
    /// A study can't be planned, run or reported.
    #[error(transparent)]
    Study(Box<crate::study::StudyError>),
    /// An argument makes no sense.
    #[error("{0}")]
    BadArgument(String),
    /// A signal asked for the end.
    #[error("interrupted")]
    Interrupted,
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
    Topic(#[from] trocar_topics::TopicError),
    /// A CAN interface cannot be used.
    #[error("{name}: {reason}; {remedy}")]
    Interface {
        /// The interface.
        name: String,
        /// Why.
        reason: String,
        /// What may help.
        remedy: String,
    },
    /// The plan is more than a CAN bus can carry.
    #[error("{0}")]
    Overload(trocar_canopen::bus_load::Overload),
    /// The drives of an arm did not come up.
    #[error("{arm} on {interfaces}: {reason}")]
    BringUp {
        /// The arm.
        arm: &'static str,
        /// Its interfaces.
        interfaces: String,
        /// Why, with the node.
        reason: String,
    },
    /// The real-time parts failed.
    #[error("{0}")]
    RealTime(String),
}

impl From<crate::study::StudyError> for SessionError {
    fn from(error: crate::study::StudyError) -> Self {
        Self::Study(Box::new(error))
    }
}

impl From<LogImportError> for SessionError {
    fn from(error: LogImportError) -> Self {
        Self::ImportLog(Box::new(error))
    }
}

impl From<NiftiError> for SessionError {
    fn from(error: NiftiError) -> Self {
        Self::Anatomy(error.into())
    }
}

impl From<PolicyError> for SessionError {
    fn from(error: PolicyError) -> Self {
        if matches!(error, PolicyError::Interrupted) {
            return Self::Interrupted;
        }
        Self::Policy(error)
    }
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

    /// The error that signals can't be caught.
    #[must_use]
    pub fn signals(error: std::io::Error) -> Self {
        Self::RealTime(format!("catching signals failed: {error}"))
    }

    /// Whether the user's input is at fault, rather than the work itself.
    #[must_use]
    pub const fn is_bad_input(&self) -> bool {
        match self {
            Self::Log(error) => error.is_bad_input(),
            Self::ImportLog(error) => error.is_bad_input(),
            Self::Study(error) => error.is_bad_input(),
            Self::Anatomy(error) => error.is_bad_input(),
            Self::Segment(error) => !matches!(error, SegmentError::Torch(_)),
            Self::Topic(error) => matches!(error, TopicError::BadName { .. }),
            Self::Config(_)
            | Self::Checkpoint(_)
            | Self::Dataset(_)
            | Self::Import(_)
            | Self::Replay(_)
            | Self::Verify(_)
            | Self::CutLog { .. }
            | Self::UnknownCamera { .. }
            | Self::Overload(_)
            | Self::Ct(_)
            | Self::BadArgument(_) => true,
            Self::Train(error) => match error {
                TrainError::Options(_)
                | TrainError::Empty
                | TrainError::Dataset(_)
                | TrainError::Read(_)
                | TrainError::Image(_)
                | TrainError::State(_) => true,
                TrainError::Diverged { .. }
                | TrainError::Stopped { .. }
                | TrainError::Watch(_)
                | TrainError::Parameter(_)
                | TrainError::Torch(_) => false,
            },
            Self::Unproductive { .. }
            | Self::Simulation(_)
            | Self::Policy(_)
            | Self::Arm(_)
            | Self::Interface { .. }
            | Self::BringUp { .. }
            | Self::Output { .. }
            | Self::Interrupted
            | Self::Refused(_)
            | Self::RealTime(_) => false,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn impossible_training_is_bad_input_and_divergence_is_not() {
        let options = TrainError::Options("batch = 0".to_owned());
        assert!(SessionError::from(options).is_bad_input());
        assert!(SessionError::from(TrainError::Empty).is_bad_input());
        let (step, term, value) = (3, "kl", f64::NAN);
        assert!(!SessionError::from(TrainError::Diverged { step, term, value }).is_bad_input());
    }

    #[test]
    fn a_cause_is_told_once() {
        let unreadable = hal::config::Source::read("no/such.toml").unwrap_err();
        let error = SessionError::from(unreadable);
        let mut told = error.to_string();
        let mut source = std::error::Error::source(&error);
        while let Some(cause) = source {
            told = format!("{told}: {cause}");
            source = cause.source();
        }
        assert_eq!(told.matches("No such file").count(), 1, "{told}");
    }
}
