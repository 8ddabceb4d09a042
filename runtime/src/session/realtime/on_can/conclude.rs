//! The end of a run over CAN: why it ended, and what it adds up to.

use trocar_topics::Verdict;

use super::super::control_thread::ControlEnd;
use super::super::labels;
use super::super::watch::Watched;
use super::link::CanLink;
use super::scene_thread::SceneEnd;
use super::{CanOptions, Ends};
use crate::log::RunOutcome;
use crate::rt;
use crate::session::pictures::Pictures;
use crate::session::run::{RunOptions, RunResult};
use crate::session::summary::RealTimeCounts;
use crate::session::tally::RunLabels;
use crate::session::{SessionError, Setup};

/// Why the run ended, and whether that is a success.
fn verdict(watched: &Watched, scene: &SceneEnd, control: &ControlEnd<CanLink>) -> (bool, String) {
    let faults = control.link.fault_texts();
    if scene.verdict == Verdict::Success {
        (true, "success".to_owned())
    } else if let Some(reason) = &watched.ended_by {
        (false, reason.clone())
    } else if !faults.is_empty() {
        (false, format!("fault: {}", faults.join("; ")))
    } else {
        let reason = control.tally.faults();
        (false, reason.unwrap_or_else(|| scene.reason.clone()))
    }
}

/// Closes the log, whatever happened, and sums up.
pub(super) fn conclude(
    setup: &Setup,
    options: &RunOptions,
    can: &CanOptions,
    ends: Ends,
) -> Result<RunResult, SessionError> {
    let Ends {
        control,
        watched,
        scene,
        log,
    } = ends;
    let all = control.and_then(|control| Ok((control, watched?, scene?)));
    let (mut control, watched, scene) = match all {
        Ok(all) => all,
        Err(error) => {
            log.map(|log| log.finish(None)).transpose()?;
            return Err(error);
        }
    };
    let (success, reason) = verdict(&watched, &scene, &control);
    let mut log_dropped = control.log_dropped;
    if let Some(log) = log {
        let outcome = RunOutcome {
            success,
            reason: reason.clone(),
            command_hash: control.tally.command_hash(),
        };
        let counts = log.finish(Some(&outcome))?;
        log_dropped += counts.frames_dropped + counts.events_dropped;
    }
    control.tally.inferences(&watched.inference);
    control.tally.inferences(&scene.inference);
    let policy = options.policy.name();
    let labels = RunLabels {
        success,
        reason: &reason,
        tissue: scene.tissue,
        ..labels(setup, options, &policy)
    };
    let real_time = RealTimeCounts {
        overruns: control.skipped,
        wake_p99_us: control.wake_p99_us,
        log_dropped,
        slow_motion: rt::slow_motion(),
    };
    let mut summary = control.tally.summary(&labels, Some(real_time));
    summary.can = Some(control.link.summary(can));
    Ok(RunResult {
        summary,
        pictures: Pictures::default(),
    })
}
