//! A robot in real time: limits and a policy, neither task nor verdict. Its arms are behind
//! anyone's rig ([`run_rig`], [`run_rig_seeing`]), on CAN
//! ([`run_robot_on_can`](super::run_robot_on_can)) or in another process
//! ([`run_robot_on_topics`](super::run_robot_on_topics)).

mod own_rig;
mod queries;
mod scene;
mod sight;
mod thread;

#[cfg(test)]
mod tests;

pub use own_rig::{RigCameras, run_rig, run_rig_seeing};
pub(super) use scene::ArmsScene;
pub(super) use thread::{RobotEnd, RobotThread};

use super::watch::Watched;
use crate::session::ended::Ended;
use crate::session::run::{INTERRUPTED, STOPPED};
use crate::session::{Robot, SessionError};

/// What a run without a task is asked.
#[derive(Clone, Debug, Default)]
pub struct RobotOptions {
    /// After how long it ends, s; never by itself if not given.
    pub seconds: Option<f64>,
    /// Cameras whose frames the log keeps besides those that the policy sees.
    pub cameras: Vec<String>,
}

/// A robot's drives fault in states of their own, which end the run.
pub(super) fn check_faults(robot: &Robot) -> Result<(), SessionError> {
    if robot.control.fault_ends_run {
        return Ok(());
    }
    let reason =
        "control.toml: fault.ends_run = false is for simulated arms: a robot's fault ends its run";
    Err(SessionError::BadArgument(reason.to_owned()))
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
        tissue: None,
    }
}
