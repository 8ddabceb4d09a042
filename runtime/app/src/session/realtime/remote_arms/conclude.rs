//! The end of a run of arms outside of this process: why it ended, and what it adds up to.
//!
//! Several threads may each have a reason. Success is the world's word alone. Otherwise the order
//! is, of a task: what the first thread saw end the run (a signal, the operator, the policy
//! process), a fault of the arms or the controller, what the observing thread says. Of a robot a
//! fault comes first.

use trocar_log::LogFile;
use trocar_topics::Verdict;

use super::super::ended::closed;
use super::super::robot::{RobotEnd, robot_ended};
use super::super::threads::Ends;
use super::super::watch::Watched;
use super::ArmLink;
use super::scene_thread::SceneEnd;
use crate::histogram::Histogram;
use crate::session::ended::Ended;
use crate::session::plan::Arms;
use crate::session::run::RunResult;
use crate::session::teleop::Hands;
use crate::session::{Plan, SessionError};

/// What an observing thread leaves behind.
pub(super) trait Seen {
    /// Why the run ended, if nothing else ended it before.
    ///
    /// `fault` is of the arms or else of the controller; `watched` is the first thread's.
    fn ended(&self, watched: &Watched, fault: Option<String>) -> Ended;

    /// How long the local policy took for its chunks.
    ///
    /// Empty if the policy is in another process.
    fn inference(&self) -> &Histogram;
}

impl Seen for SceneEnd {
    fn ended(&self, watched: &Watched, fault: Option<String>) -> Ended {
        let success = self.verdict == Verdict::Success;
        let reason = if success {
            "success".to_owned()
        } else {
            let before = watched.ended_by.clone().or(fault);
            before.unwrap_or_else(|| self.reason.clone())
        };
        Ended::task(success, reason, self.tissue)
    }

    fn inference(&self) -> &Histogram {
        &self.inference
    }
}

impl Seen for RobotEnd {
    fn ended(&self, watched: &Watched, fault: Option<String>) -> Ended {
        robot_ended(self, watched, fault)
    }

    fn inference(&self) -> &Histogram {
        &self.inference
    }
}

/// Closes the log of a run that was marked at these hands, if it was, whatever happened, and sums
/// up.
///
/// # Errors
/// Of the thread that failed first in the order of control, first thread and observer; where
/// nothing was enabled, what prevented that. The log is closed without an outcome then.
pub(super) fn conclude<S: Arms, T: Seen, L: ArmLink>(
    plan: &Plan<S>,
    ends: Ends<L::Rig, T>,
    (log, marked_by): (Option<LogFile>, Option<&Hands>),
    link: &L,
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
    // What the arms or the controller report, if one of them ended the run.
    let fault = L::fault(&control.rig).or_else(|| control.tally.faults());
    let ended = seen.ended(&watched, fault);
    control.tally.inferences(&watched.inference);
    control.tally.restarts(watched.restarts);
    control.tally.inferences(seen.inference());
    let mut result = closed(plan, &control, &ended, (log, marked_by));
    result.summary.can = link.summary(&control.rig);
    Ok(result)
}
