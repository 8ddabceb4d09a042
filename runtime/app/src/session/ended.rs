//! How a run ended, in its log and in its result.
//!
//! One value that both are made from, so that they cannot differ.

use hal::TimeNs;
use trocar_log::{Level, LogCounts, LogError, Recorder, RunNote, RunOutcome};
use trocar_tasks::task::Outcome;

use super::episode::EpisodeEnd;
use super::summary::TissueSummary;
use super::tally::Tally;

/// How a run ended.
pub(super) struct Ended {
    /// Whether the task was done, if there was one.
    pub(super) success: Option<bool>,
    /// Whether the program did its job.
    ///
    /// Of a task, whether it was done; of a robot, whether its run ended as it was asked to,
    /// without a fault.
    pub(super) ok: bool,
    /// For a person, one line: `success`, the failure, the fault, or what ended the run.
    pub(super) reason: String,
    /// What a soft tissue went through, if the task has one.
    pub(super) tissue: Option<TissueSummary>,
}

impl Ended {
    /// Of a run of a task that was done or not.
    pub(super) const fn task(success: bool, reason: String, tissue: Option<TissueSummary>) -> Self {
        Self {
            success: Some(success),
            ok: success,
            reason,
            tissue,
        }
    }

    /// Success is the judge's alone; the reason may be a controller's fault.
    pub(super) fn episode(end: &EpisodeEnd) -> Self {
        let success = matches!(end.outcome, Outcome::Success);
        Self::task(success, end.reason(), end.tissue)
    }

    /// What the log says of it.
    ///
    /// Without marks and hands: whoever has them adds them.
    pub(super) fn outcome(&self, tally: &Tally) -> RunOutcome {
        RunOutcome {
            success: self.success,
            reason: self.reason.clone(),
            command_hash: tally.command_hash(),
            said: RunNote::default(),
            teleop: None,
        }
    }

    /// Closes the log of an episode in lockstep.
    pub(super) fn close(
        &self,
        mut recorder: Recorder,
        tally: &Tally,
    ) -> Result<LogCounts, LogError> {
        if let Some(tissue) = &self.tissue {
            let last = TimeNs::from_tick(tally.ticks());
            recorder.event(last, Level::Info, &tissue.to_string());
        }
        recorder.finish(Some(&self.outcome(tally)))
    }
}
