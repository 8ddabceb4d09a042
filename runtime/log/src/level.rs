//! How bad an event is, and its line in the log.

use hal::TimeNs;

use super::messages::{Log, LogLevel, Timestamp};

/// How bad an event is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Level {
    /// Worth knowing.
    Info,
    /// Worth a look.
    Warning,
    /// Something failed.
    Error,
}

impl Level {
    /// The message of `/events` that says `text`.
    pub(super) fn line(self, at: TimeNs, text: String) -> Log {
        Log {
            timestamp: Some(Timestamp::new(at)),
            level: self.number(),
            message: text,
            name: "trocar".to_owned(),
            ..Log::default()
        }
    }

    /// The number of the level in `foxglove.Log`.
    const fn number(self) -> i32 {
        match self {
            Self::Info => LogLevel::Info as i32,
            Self::Warning => LogLevel::Warning as i32,
            Self::Error => LogLevel::Error as i32,
        }
    }
}
