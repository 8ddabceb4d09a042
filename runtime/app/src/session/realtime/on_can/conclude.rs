//! The end of a run over CAN: why it ended, and what it adds up to.

use trocar_topics::Verdict;

use super::super::control_thread::ControlEnd;
use super::super::watch::Watched;
use super::robot_thread::RobotEnd;
use super::scene_thread::SceneEnd;
use super::summary::summary;
use super::{CanOptions, Ends};
use crate::histogram::Histogram;
use crate::rig::can::CanRig;
use crate::rt;
use crate::session::SessionError;
use crate::session::pictures::Pictures;
use crate::session::run::{INTERRUPTED, RunResult, STOPPED};
use crate::session::summary::{RealTimeCounts, TissueSummary};
use crate::session::tally::RunLabels;
use trocar_log::{LogFile, RunOutcome};

/// How a run ended.
pub(super) struct Ended {
    /// Whether the task was done, if there was one.
    success: Option<bool>,
    /// Whether the program did its job.
    ok: bool,
    reason: String,
}

/// What an observing thread leaves behind.
pub(super) trait Seen {
    /// Why the run ended, if nothing else ended it before.
    fn ended(&self, watched: &Watched, control: &ControlEnd<CanRig>) -> Ended;

    /// How long the local policy took for its chunks.
    fn inference(&self) -> &Histogram;

    /// What a soft tissue went through.
    fn tissue(&self) -> Option<TissueSummary> {
        None
    }
}

/// What the drives or the controller report, if one of them ended the run.
fn fault(control: &ControlEnd<CanRig>) -> Option<String> {
    let faults = control.rig.fault_texts();
    if faults.is_empty() {
        control.tally.faults()
    } else {
        Some(format!("fault: {}", faults.join("; ")))
    }
}

impl Seen for SceneEnd {
    fn ended(&self, watched: &Watched, control: &ControlEnd<CanRig>) -> Ended {
        let success = self.verdict == Verdict::Success;
        let reason = if success {
            "success".to_owned()
        } else {
            let before = watched.ended_by.clone().or_else(|| fault(control));
            before.unwrap_or_else(|| self.reason.clone())
        };
        Ended {
            success: Some(success),
            ok: success,
            reason,
        }
    }

    fn inference(&self) -> &Histogram {
        &self.inference
    }

    fn tissue(&self) -> Option<TissueSummary> {
        self.tissue
    }
}

impl Seen for RobotEnd {
    fn ended(&self, watched: &Watched, control: &ControlEnd<CanRig>) -> Ended {
        robot_ended(self, watched, fault(control))
    }

    fn inference(&self) -> &Histogram {
        &self.inference
    }
}

/// Why a robot's run ended: a fault comes before what else ended it.
pub(super) fn robot_ended(end: &RobotEnd, watched: &Watched, fault: Option<String>) -> Ended {
    let by = watched.ended_by.as_deref();
    let by_a_person = by == Some(INTERRUPTED) || by == Some(STOPPED);
    Ended {
        success: None,
        ok: fault.is_none() && (end.as_asked || by_a_person),
        reason: fault
            .or_else(|| watched.ended_by.clone())
            .or_else(|| end.ended_by.clone())
            .unwrap_or_else(|| "the control thread has stopped".to_owned()),
    }
}

/// Closes the log, whatever happened, and sums up; `labels` say nothing of how it went yet.
pub(super) fn conclude<T: Seen>(
    ends: Ends<T>,
    labels: RunLabels<'_>,
    can: &CanOptions,
) -> Result<RunResult, SessionError> {
    let Ends {
        control,
        watched,
        seen,
        log,
    } = ends;
    // Why nothing was enabled is known to whoever ended the run before.
    let all = match (control, watched, seen) {
        (
            Err(SessionError::Interrupted),
            Ok(Watched {
                ended_by: Some(cause),
                ..
            }),
            _,
        ) => Err(SessionError::RealTime(cause)),
        (Err(SessionError::Interrupted), _, Err(error)) => Err(error),
        (control, watched, seen) => control.and_then(|control| Ok((control, watched?, seen?))),
    };
    let (mut control, watched, seen) = match all {
        Ok(all) => all,
        Err(error) => {
            log.map(|log| log.finish(None)).transpose()?;
            return Err(error);
        }
    };
    let ended = seen.ended(&watched, &control);
    control.tally.inferences(&watched.inference);
    control.tally.inferences(seen.inference());
    let labels = RunLabels {
        tissue: seen.tissue(),
        ..labels
    };
    let drives = summary(&control.rig, can);
    let mut result = closed(&control, &ended, labels, log);
    result.summary.can = Some(drives);
    Ok(result)
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
        overruns: control.skipped,
        wake_p99_us: control.wake_p99_us,
        log_dropped,
        slow_motion: rt::slow_motion(),
    };
    RunResult {
        ok: ended.ok,
        summary: control.tally.summary(&labels, Some(real_time)),
        pictures: Pictures::default(),
        log_failure,
    }
}
