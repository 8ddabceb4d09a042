//! The end of a run over CAN: why it ended, and what it adds up to.

use trocar_log::LogFile;
use trocar_topics::Verdict;

use super::super::control_thread::ControlEnd;
use super::super::ended::closed;
use super::super::robot::{RobotEnd, robot_ended};
use super::super::threads::Ends;
use super::super::watch::Watched;
use super::CanOptions;
use super::scene_thread::SceneEnd;
use super::summary::summary;
use crate::histogram::Histogram;
use crate::rig::can::CanRig;
use crate::session::ended::Ended;
use crate::session::plan::Arms;
use crate::session::run::RunResult;
use crate::session::{Plan, SessionError};

/// What an observing thread leaves behind.
pub(super) trait Seen {
    /// Why the run ended, if nothing else ended it before.
    fn ended(&self, watched: &Watched, control: &ControlEnd<CanRig>) -> Ended;

    /// How long the local policy took for its chunks.
    fn inference(&self) -> &Histogram;
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
        Ended::task(success, reason, self.tissue)
    }

    fn inference(&self) -> &Histogram {
        &self.inference
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

/// Closes the log, whatever happened, and sums up.
pub(super) fn conclude<S: Arms, T: Seen>(
    plan: &Plan<S>,
    ends: Ends<CanRig, T>,
    log: Option<LogFile>,
    can: &CanOptions,
) -> Result<RunResult, SessionError> {
    let Ends {
        control,
        watched,
        seen,
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
        (Err(SessionError::Interrupted), Err(error), _)
        | (Err(SessionError::Interrupted), _, Err(error)) => Err(error),
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
    control.tally.restarts(watched.restarts);
    control.tally.inferences(seen.inference());
    let mut result = closed(plan, &control, &ended, log);
    result.summary.can = Some(summary(&control.rig, can));
    Ok(result)
}
