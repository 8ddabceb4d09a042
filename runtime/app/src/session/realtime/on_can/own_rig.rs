//! A robot behind anyone's rig, in real time: limits, a policy of this process and a log; no bus, no task and no verdict.

use std::sync::Arc;
use std::thread;

use hal::{ArmState, PerArm, Period, Rig, Setpoint};

use super::super::control_thread::ControlThread;
use super::super::joined;
use super::super::signals::Moving;
use super::super::watch::watch;
use super::conclude::{closed, robot_ended};
use super::robot_thread::RobotThread;
use super::{ControlWires, RobotOptions, Wires};
use crate::mailbox::MailboxWriter;
use crate::rig::all_measured;
use crate::rt::{self, MonotonicClock};
use crate::session::run::{RunOptions, RunResult, open_log_with};
use crate::session::source::ChunkSource;
use crate::session::tally::RunLabels;
use crate::session::{Robot, SessionError};

/// A rig, and whoever else wants to know what its arms measure.
struct Observed<R> {
    rig: R,
    measured: MailboxWriter<PerArm<ArmState>>,
}

impl<R: Rig> Rig for Observed<R> {
    fn exchange(&mut self, setpoints: Option<&PerArm<Setpoint>>) -> Period {
        let period = self.rig.exchange(setpoints);
        if let Some(states) = period.measured.as_ref().and_then(all_measured) {
            self.measured.put(states);
        }
        period
    }
}

/// Runs a robot behind `rig`, whose periods are 1 ms each on `clock`, with the policy `source`, until the time of `asked` is up, a signal comes,
/// or a fault. The policy runs in a thread of its own and sees the arms and no camera; `options` name it.
///
/// SIGINT, SIGTERM and SIGHUP bring the arms to rest. The rig takes its drives down when it is dropped.
///
/// # Errors
/// [`SessionError::BadArgument`] for a policy that looks through cameras, and if the rig has another number of arms than `robot`; those
/// of the policy and the log.
pub fn run_rig<R: Rig + Send>(
    robot: &Robot,
    (rig, clock): (R, MonotonicClock),
    source: ChunkSource,
    options: &RunOptions,
    asked: &RobotOptions,
) -> Result<RunResult, SessionError> {
    let policy = options.policy.name();
    if let Some(camera) = source.cameras().first() {
        return Err(SessionError::BadArgument(format!(
            "policy {policy} looks through camera {camera}: behind a rig of one's own there is none"
        )));
    }
    rt::catch_interrupts_in_motion()
        .map_err(|error| SessionError::RealTime(format!("catching signals failed: {error}")))?;
    let recorder = open_log_with(&robot.header(options), options.log.as_deref())?;
    let wires = Wires::new(recorder, clock);
    let ControlWires {
        measured,
        chunks,
        log,
        signals,
        ..
    } = wires.control;
    let control_thread = ControlThread {
        controller: robot.controller()?,
        rig: Observed { rig, measured },
        chunks,
        log,
        signals: Arc::clone(&signals),
    };
    let local = Some((source, wires.chunk_in));
    let robot_thread = RobotThread::new(wires.seen, local, Vec::new(), (Vec::new(), 0), asked);
    let (control, seen, watched) = thread::scope(|scope| {
        let control = scope.spawn(move || {
            let _moving = Moving;
            control_thread.run(clock)
        });
        let seen = scope.spawn(|| robot_thread.run());
        let watched = watch(None, &signals);
        (joined(control), joined(seen).and_then(|end| end), watched)
    });
    let ends = control.and_then(|control| Ok((control, seen?, watched?)));
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
        seed: options.seed,
        ..RunLabels::default()
    };
    Ok(closed(&control, &ended, labels, wires.log))
}
