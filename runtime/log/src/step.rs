//! What reading a log gives: step by step a tick with all that belongs to it, then what is known at
//! the end.

use hal::{Chunk, PerArm};

use super::header::RunOutcome;
use super::record::LoggedTick;
use super::snapshot::LoggedSnapshot;
use trocar_control::TickInput;

/// One tick of a log with all that belongs to it.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// What the controller was given and answered.
    pub tick: &'a LoggedTick,
    /// The chunk that each arm was given.
    pub chunks: PerArm<Option<&'a Chunk>>,
    /// Each arm's safety report, the JSON of its message.
    pub reports: PerArm<Option<&'a [u8]>>,
    /// Ticks just before it that the logger dropped.
    pub dropped_before: u64,
    /// Whether the logger dropped a chunk that it was given.
    pub chunk_dropped: bool,
    /// The controller's state just before it, where a log with a bound holds it.
    pub snapshot: Option<&'a LoggedSnapshot>,
}

impl<'a> Step<'a> {
    /// What the controller was given for each arm. A log may hold another number of arms than the
    /// configuration in it, so whoever gives this to a controller compares the numbers first.
    #[must_use]
    pub fn inputs(&self) -> PerArm<TickInput<'a>> {
        let now = self.tick.now;
        let arms = self.tick.arms.zip(self.chunks);
        arms.map(|(arm, chunk)| TickInput {
            now,
            measured: arm.measured,
            chunk,
            operator: arm.operator,
        })
    }
}

/// What is known at the end of a log.
#[derive(Clone, Debug, Default)]
pub struct LogEnd {
    /// How the run ended; `None` if the log was not closed properly.
    pub outcome: Option<RunOutcome>,
    /// The mark in the log, if there is one that is no [`RunMark`](crate::RunMark); the outcome has
    /// none then.
    pub unknown_mark: Option<String>,
    /// Hash over everything that the controller was given, taken while it ran; `None` if the file
    /// was cut or the run goes on in another.
    pub input_hash: Option<u64>,
    /// Ticks that the logger dropped after the last one that it wrote.
    pub dropped_at_end: u64,
    /// Why the file ends before its end, if it does.
    pub cut: Option<String>,
    /// Whether that is its own bound alone: all that the bound kept is there.
    pub bounded: bool,
    /// Whether the log is not what the run wrote: something was changed, put in or taken away.
    pub altered: bool,
    /// The controller's state after the last tick, if the log goes on in another file.
    pub snapshot: Option<LoggedSnapshot>,
}
