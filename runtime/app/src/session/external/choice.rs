//! Which external policy a session waits for, and what it tells it.

use trocar_topics::{LINE_BYTES_MAX, check_run_id};

use crate::session::SessionError;

/// The name of the topics if none is given.
pub const DEFAULT_NAME: &str = "external";

/// How long an external policy may take to appear, to reset and to answer if nothing else is said,
/// s.
pub const DEFAULT_WITHIN_S: u64 = 30;

/// The longest instruction, bytes of UTF-8.
pub const INSTRUCTION_BYTES_MAX: usize = LINE_BYTES_MAX;

/// Which external policy.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ExternalChoice {
    /// The name of its topics, if it was given.
    pub name: Option<String>,
    /// How long it may take to appear, to reset and to answer, s.
    pub within_s: u64,
    /// What is to be done, in words; the task's name if not given.
    pub instruction: Option<String>,
}

impl ExternalChoice {
    /// The one on the topics `name`, or on the default ones.
    #[must_use]
    pub fn new(name: Option<&str>) -> Self {
        Self {
            name: name.map(str::to_owned),
            within_s: DEFAULT_WITHIN_S,
            instruction: None,
        }
    }

    /// The name of its topics.
    #[must_use]
    pub fn topics(&self) -> &str {
        self.name.as_deref().unwrap_or(DEFAULT_NAME)
    }

    /// The one of the job `index` of `jobs`: of several each has a policy of its own, `NAME-1` and
    /// so on.
    #[must_use]
    pub fn of_job(&self, index: usize, jobs: usize) -> Self {
        let name = match jobs {
            0 | 1 => self.name.clone(),
            _ => Some(format!("{}-{}", self.topics(), index + 1)),
        };
        Self {
            name,
            within_s: self.within_s,
            instruction: self.instruction.clone(),
        }
    }

    /// What it is told that is to be done: the instruction, or else the task's name, as a dataset's
    /// `task` has it.
    pub(in crate::session) fn instruction_or<'a>(&'a self, task: &'a str) -> &'a str {
        self.instruction.as_deref().unwrap_or(task)
    }

    /// Checks that it can name topics, and that there is room for the instruction.
    ///
    /// # Errors
    /// [`SessionError::Topic`], [`SessionError::BadArgument`].
    pub fn check(&self) -> Result<(), SessionError> {
        check_run_id(self.topics())?;
        match self.instruction.as_ref().map_or(1, String::len) {
            1..=INSTRUCTION_BYTES_MAX => Ok(()),
            length => Err(SessionError::BadArgument(format!(
                "--instruction: {length} bytes of text: allowed are 1 to {INSTRUCTION_BYTES_MAX}"
            ))),
        }
    }
}
