//! How a run ended, in its log and in its result.

use trocar_log::{LogFile, RunOutcome};

use super::control_thread::ControlEnd;
use crate::session::pictures::Pictures;
use crate::session::run::RunResult;
use crate::session::summary::RealTimeCounts;
use crate::session::tally::RunLabels;

/// How a run ended.
pub(super) struct Ended {
    /// Whether the task was done, if there was one.
    pub(super) success: Option<bool>,
    /// Whether the program did its job.
    pub(super) ok: bool,
    pub(super) reason: String,
}

/// Closes the log of a run that has come to its end, and sums up.
pub(super) fn closed<R>(
    control: &ControlEnd<R>,
    ended: &Ended,
    labels: RunLabels<'_>,
    log: Option<LogFile>,
) -> RunResult {
    let mut log_dropped = control.log_dropped;
    let mut log_failure = None;
    if let Some(log) = log {
        let outcome = RunOutcome {
            success: ended.success,
            reason: ended.reason.clone(),
            command_hash: control.tally.command_hash(),
        };
        match log.finish(Some(&outcome)) {
            Ok(counts) => log_dropped += counts.frames_dropped + counts.events_dropped,
            Err(error) => log_failure = Some(error),
        }
    }
    let labels = RunLabels {
        success: ended.success,
        reason: &ended.reason,
        ..labels
    };
    let real_time = RealTimeCounts {
        log_dropped,
        ..control.counts.clone()
    };
    RunResult {
        ok: ended.ok,
        summary: control.tally.summary(&labels, Some(real_time)),
        pictures: Pictures::default(),
        log_failure,
    }
}
