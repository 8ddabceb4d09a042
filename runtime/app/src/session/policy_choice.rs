//! Which policy the user asked for: by word, by folder or by topics.

use std::path::{Path, PathBuf};

use trocar_nets::checkpoint::{Recipe, WEIGHTS, load_recipe};

use super::external::{self, ExternalChoice};
use super::teleop::{OperatorFigures, TIME_FACTOR};
use super::{SessionError, policies};
use crate::digest::hash_file;

/// The name of the simulated operator.
pub(super) const OPERATOR: &str = "simulated-operator";

/// Which policy the user asked for.
#[derive(Clone, Debug, PartialEq)]
pub enum PolicyChoice {
    /// The task's scripted expert, which sees the scene's state.
    Expert,
    /// Holds still.
    Noop,
    /// Moves at random.
    Random,
    /// An operator's hands, through the console.
    Teleop,
    /// A simulated operator's hands, in lockstep.
    Operator(OperatorFigures),
    /// A trained checkpoint.
    Checkpoint(PathBuf),
    /// One that the caller hands in, as
    /// [`ChunkSource::policy`](super::source::ChunkSource::policy), by this name: to
    /// [`run_lockstep_with`](super::run::run_lockstep_with),
    /// [`evaluate_with`](super::eval::evaluate_with), [`record_with`](super::record::record_with)
    /// or [`run_rig`](super::realtime::run_rig).
    Own(String),
    /// One in another process, over topics.
    External(ExternalChoice),
}

impl PolicyChoice {
    /// Reads `expert`, `noop`, `random`, `teleop`, `simulated-operator`, `external`,
    /// `external:NAME`, or else a directory, or the name of a committed policy such as
    /// `needle-lift/act-compact`.
    #[must_use]
    pub fn parse(text: &str) -> Self {
        match text {
            "expert" => Self::Expert,
            "noop" => Self::Noop,
            "random" => Self::Random,
            "teleop" => Self::Teleop,
            OPERATOR => Self::Operator(OperatorFigures::default()),
            external::DEFAULT_NAME => Self::External(ExternalChoice::new(None)),
            directory if Path::new(directory).is_dir() => Self::Checkpoint(directory.into()),
            name => match name.strip_prefix("external:") {
                Some(topics) => Self::External(ExternalChoice::new(Some(topics))),
                None => Self::Checkpoint(policies::named(name).unwrap_or_else(|| name.into())),
            },
        }
    }

    /// The same, in which an external policy may take `within_s` seconds to appear, to reset and to
    /// answer.
    #[must_use]
    pub fn within_s(mut self, within_s: u64) -> Self {
        if let Self::External(choice) = &mut self {
            choice.within_s = within_s;
        }
        self
    }

    /// The same, told to do `instruction`, if it is one.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] for a policy that reads none: any but an external one.
    pub fn instructed(mut self, instruction: Option<&str>) -> Result<Self, SessionError> {
        match (&mut self, instruction) {
            (_, None) => {}
            (Self::External(choice), Some(text)) => choice.instruction = Some(text.to_owned()),
            (other, Some(_)) => {
                let policy = other.name();
                return Err(SessionError::BadArgument(format!(
                    "--instruction: only external policies read one, and the policy is {policy}"
                )));
            }
        }
        Ok(self)
    }

    /// The same, if it is a simulated operator with another delay and another tremor, where they
    /// are given.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] for another policy.
    pub fn operated(
        self,
        delay_ms: Option<u64>,
        tremor_mm: Option<f64>,
    ) -> Result<Self, SessionError> {
        match (self, delay_ms, tremor_mm) {
            (Self::Operator(figures), ..) => Ok(Self::Operator(OperatorFigures {
                delay_ms: delay_ms.unwrap_or(figures.delay_ms),
                tremor_mm: tremor_mm.unwrap_or(figures.tremor_mm),
                ..figures
            })),
            (other, None, None) => Ok(other),
            (other, ..) => Err(SessionError::BadArgument(format!(
                "--operator-delay-ms and --operator-tremor-mm are of {OPERATOR}, and {} is another",
                other.name()
            ))),
        }
    }

    /// By how much longer than the task allows an episode may take.
    #[must_use]
    pub const fn time_factor(&self) -> f64 {
        match self {
            Self::Teleop | Self::Operator(_) => TIME_FACTOR,
            Self::Expert
            | Self::Noop
            | Self::Random
            | Self::Checkpoint(_)
            | Self::Own(_)
            | Self::External(_) => 1.0,
        }
    }

    /// The same for the job `index` of `jobs`: of external policies each has its own.
    #[must_use]
    pub fn of_job(&self, index: usize, jobs: usize) -> Self {
        if let Self::External(choice) = self {
            return Self::External(choice.of_job(index, jobs));
        }
        self.clone()
    }

    /// Checks that a checkpoint's folder is there, that an external policy's name can be one of
    /// topics, and its instruction told.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`], which says what a policy can be; [`SessionError::Topic`].
    pub fn check_exists(&self) -> Result<(), SessionError> {
        match self {
            Self::Checkpoint(path) if !path.is_dir() => Err(SessionError::BadArgument(format!(
                "policy {}: there is no such folder; a policy is expert, noop, random, teleop, simulated-operator, external or a checkpoint's folder",
                path.display()
            ))),
            Self::External(choice) => choice.check(),
            Self::Checkpoint(_)
            | Self::Expert
            | Self::Noop
            | Self::Random
            | Self::Teleop
            | Self::Operator(_)
            | Self::Own(_) => Ok(()),
        }
    }

    /// What a checkpoint says of itself; none of another policy.
    ///
    /// # Errors
    /// [`SessionError::Checkpoint`].
    pub(super) fn recipe(&self) -> Result<Option<Recipe>, SessionError> {
        let Self::Checkpoint(folder) = self else {
            return Ok(None);
        };
        Ok(load_recipe(folder)?)
    }

    /// SHA-256 of a checkpoint's weights, hexadecimal; none of another policy, and none if there is
    /// no such file.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] if the file can't be read.
    pub fn weights_sha256(&self) -> Result<Option<String>, SessionError> {
        let Self::Checkpoint(folder) = self else {
            return Ok(None);
        };
        let file = folder.join(WEIGHTS);
        match hash_file(&file) {
            Ok(hash) => Ok(Some(hash)),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(SessionError::BadArgument(format!(
                "policy {}: {error}",
                file.display()
            ))),
        }
    }

    /// The name used in results.
    #[must_use]
    pub fn name(&self) -> String {
        match self {
            Self::Expert => "expert".to_owned(),
            Self::Noop => "noop".to_owned(),
            Self::Random => "random".to_owned(),
            Self::Teleop => "teleop".to_owned(),
            Self::Operator(figures) if *figures == OperatorFigures::default() => {
                OPERATOR.to_owned()
            }
            Self::Operator(figures) => format!(
                "{OPERATOR} (delay {} ms, tremor {} mm)",
                figures.delay_ms, figures.tremor_mm
            ),
            Self::Checkpoint(path) => path.display().to_string(),
            Self::Own(name) => name.clone(),
            Self::External(choice) => match &choice.name {
                Some(name) => format!("external:{name}"),
                None => external::DEFAULT_NAME.to_owned(),
            },
        }
    }
}
