//! A robot behind anyone's rig, in real time: limits, a policy of this process and a log; no bus, no task and no verdict.

use std::sync::Arc;
use std::thread;

use hal::Rig;

use super::super::control_thread::ControlThread;
use super::super::ended::closed;
use super::super::joined;
use super::super::shown::show_rig;
use super::super::signals::Moving;
use super::super::watch::watch;
use super::super::wires::{ControlWires, Wires};
use super::{RobotOptions, RobotThread, robot_ended};
use crate::rig::Observed;
use crate::rt::{self, MonotonicClock};
use crate::session::run::{RunOptions, RunResult, open_log_with};
use crate::session::source::ChunkSource;
use crate::session::tally::RunLabels;
use crate::session::{Robot, SessionError};

/// Runs a robot behind `rig`, whose periods are 1 ms each on `clock`, with the policy `source`, until the time of `asked` is up, a signal comes,
/// or a fault. The policy runs in a thread of its own, which also looks at the time, and sees the arms and no camera; `options` name it and
/// give its seed. It has to return: while it does not, its last chunk ends and the arms rest, but the run does not end by time.
///
/// SIGINT, SIGTERM and SIGHUP bring the arms to rest. As soon as they rest the rig is dropped, and takes its drives down.
///
/// # Errors
/// [`SessionError::BadArgument`] for a policy that looks through cameras or wants a history, and if the rig has another number of arms
/// than `robot`; those of the policy and the log.
pub fn run_rig<R: Rig + Send>(
    robot: &Robot,
    (rig, clock): (R, MonotonicClock),
    mut source: ChunkSource,
    options: &RunOptions,
    asked: &RobotOptions,
) -> Result<RunResult, SessionError> {
    let policy = options.policy.name();
    check_policy(&policy, &source)?;
    source.reset(options.seed);
    rt::catch_interrupts_in_motion()
        .map_err(|error| SessionError::RealTime(format!("catching signals failed: {error}")))?;
    let recorder = open_log_with(&robot.header(options), options)?;
    let mut wires = Wires::new(recorder, clock);
    let port = (wires.listener.as_ref(), &mut wires.control.operator);
    show_rig("robot", &robot.control, options, port);
    let ControlWires {
        measured,
        chunks,
        log,
        signals,
        operator,
        ..
    } = wires.control;
    let listener = wires.listener;
    let control_thread = ControlThread {
        controller: robot.controller()?,
        rig: Observed::new(rig, measured),
        chunks,
        log,
        signals: Arc::clone(&signals),
        operator,
    };
    let local = Some((source, wires.chunk_in));
    let robot_thread = RobotThread::new(wires.seen, local, Vec::new(), (Vec::new(), 0), asked);
    let (control, seen, watched) = thread::scope(|scope| {
        if let Some(listener) = &listener {
            scope.spawn(|| listener.serve(scope, &*signals));
        }
        let control = scope.spawn(move || {
            // Until the drives are taken down.
            let _moving = Moving;
            let end = control_thread.run(clock);
            let arms = end.rig.arms;
            (end.with_rig(drop), arms)
        });
        let seen = scope.spawn(|| robot_thread.run());
        let watched = watch(None, &signals);
        (joined(control), joined(seen).and_then(|end| end), watched)
    });
    let ends = control.and_then(|(control, arms)| {
        if arms > 0 && arms != robot.arms() {
            return Err(SessionError::BadArgument(format!(
                "the rig has {arms} arms, {} is for {}",
                robot.safety_file,
                robot.arms()
            )));
        }
        Ok((control, seen?, watched?))
    });
    let (mut control, seen, watched) = match ends {
        Ok(ends) => ends,
        Err(error) => {
            wires.log.map(|log| log.finish(None)).transpose()?;
            return Err(error);
        }
    };
    let ended = robot_ended(&seen, &watched, control.tally.faults());
    control.tally.inferences(&seen.inference);
    let labels = RunLabels {
        policy: &policy,
        trained_on: robot.trained_on.as_deref(),
        weights_sha256: robot.weights_sha256.as_deref(),
        seed: options.seed,
        ..RunLabels::default()
    };
    Ok(closed(&control, &ended, labels, wires.log))
}

/// What a policy can't have behind a rig of one's own.
fn check_policy(policy: &str, source: &ChunkSource) -> Result<(), SessionError> {
    if let Some(camera) = source.cameras().first() {
        return Err(SessionError::BadArgument(format!(
            "policy {policy} looks through camera {camera}: behind a rig of one's own there is none"
        )));
    }
    if source.history_steps() > 0 {
        return Err(SessionError::BadArgument(format!(
            "policy {policy} wants to observe steps before its queries: behind a rig of one's own it is not shown them"
        )));
    }
    Ok(())
}
