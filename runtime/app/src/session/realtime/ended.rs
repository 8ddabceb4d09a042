//! A run that has come to its end: its log is closed, and it is summed up.

use trocar_log::{LogFile, RunOutcome};

use super::control_thread::ControlEnd;
use crate::session::Plan;
use crate::session::ended::Ended;
use crate::session::pictures::Thumbnails;
use crate::session::plan::Arms;
use crate::session::run::RunResult;
use crate::session::summary::{RealTimeCounts, RunSummary};
use crate::session::teleop::Hands;

/// Closes the log of a run of `plan` that `ended` so and was marked at these hands, if it was, and
/// sums up.
pub(super) fn closed<R, S: Arms>(
    plan: &Plan<S>,
    control: &ControlEnd<R>,
    ended: &Ended,
    (log, marked_by): (Option<LogFile>, Option<&Hands>),
) -> RunResult {
    // The log and the result say the same of it, and nobody marks a run that has ended.
    let said = marked_by.and_then(Hands::take_said).unwrap_or_default();
    let teleop = plan.by_hand();
    let mut log_dropped = control.log_dropped;
    let mut log_failure = None;
    if let Some(log) = log {
        let outcome = RunOutcome {
            said: said.clone(),
            teleop: teleop.and_then(|it| serde_json::to_string(&it).ok()),
            ..ended.outcome(&control.tally)
        };
        match log.finish(Some(&outcome)) {
            Ok(counts) => log_dropped += counts.frames_dropped + counts.events_dropped,
            Err(error) => log_failure = Some(error),
        }
    }
    let real_time = RealTimeCounts {
        log_dropped,
        ..control.timing.counts()
    };
    RunResult {
        ok: ended.ok,
        summary: RunSummary {
            said,
            teleop,
            ..control.tally.summary(plan, ended, Some(real_time))
        },
        pictures: Thumbnails::default(),
        log_failure,
        demonstration: None,
    }
}
