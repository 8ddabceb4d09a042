//! A robot behind anyone's rig, in real time: limits, a policy of this process and a log; no bus, no task and no verdict.

use std::sync::Arc;

use hal::Rig;

use super::super::by_hand::ByHand;
use super::super::channels::ThreadChannels;
use super::super::control_thread::ControlThread;
use super::super::ended::closed;
use super::super::remote_arms::Camera;
use super::super::shown::show_rig;
use super::super::signals::Moving;
use super::super::threads;
use super::{RobotOptions, RobotThread, check_faults, robot_ended};
use crate::rig::ObservedRig;
use crate::rt::{self, MonotonicClock};
use crate::session::run::RunResult;
use crate::session::source::ChunkSource;
use crate::session::{Plan, Robot, SessionError};

/// Runs a robot behind `rig`, whose periods are 1 ms each on `clock`, with the policy `source`, which that of `plan` only names, until the time of `asked` is up, a signal comes,
/// or a fault. The policy runs in a thread of its own, which also looks at the time, and sees the arms and no camera. It has to return: while it does not, its last chunk ends and the arms rest, but the run does not end by time.
///
/// SIGINT, SIGTERM and SIGHUP bring the arms to rest. As soon as they rest the rig is dropped, and takes its drives down.
///
/// # Errors
/// [`SessionError::BadArgument`] for a policy that looks through cameras or wants a history, and if the rig has another number of arms
/// than `robot`; those of the policy and the log.
pub fn run_rig<R: Rig + Send>(
    plan: &Plan<Robot>,
    rig: (R, MonotonicClock),
    source: ChunkSource,
    asked: &RobotOptions,
) -> Result<RunResult, SessionError> {
    check_policy(&plan.policy.name(), &source)?;
    run_seeing(plan, rig, source, asked, Vec::new())
}

/// The same while these cameras are looked through, without which the run does not go on; the policy is asked at the first one's frames.
pub(super) fn run_seeing<R: Rig + Send>(
    plan: &Plan<Robot>,
    (rig, clock): (R, MonotonicClock),
    mut source: ChunkSource,
    asked: &RobotOptions,
    cameras: Vec<Camera>,
) -> Result<RunResult, SessionError> {
    plan.real_time.check()?;
    let robot = &plan.setup;
    check_faults(robot)?;
    source.reset(plan.seed);
    rt::catch_interrupts_in_motion().map_err(SessionError::signals)?;
    let mut channels = ThreadChannels::new((plan.open_log(false)?, plan.console.as_ref()), clock);
    let port = (channels.listener.as_ref(), &mut channels.control.operator);
    let names = cameras.iter().map(|(name, _)| name.clone()).collect();
    let pages = show_rig(plan, (Vec::new(), 0), (names, None), port);
    let local = Some((source, channels.chunk_in));
    let (by_hand, local, hands) = ByHand::of(plan, local);
    let control_thread = ControlThread::new(plan, channels.control, hands)?;
    let signals = Arc::clone(control_thread.signals());
    let rig = ObservedRig::new(rig, channels.measured);
    let looked_at = cameras.len();
    let robot_thread = RobotThread::new(
        channels.seen,
        local,
        Vec::new(),
        (cameras, looked_at),
        (asked, (robot.control.supervision, plan.warn)),
    );
    let robot_thread = robot_thread.moved_by(by_hand);
    let robot_thread = robot_thread.shown_on(pages.cameras).shown_in(pages.arms);
    let robot_thread = robot_thread.marked_by(pages.marked_by.clone());
    let control = move || {
        // Until the drives are taken down.
        let _moving = Moving;
        Ok(control_thread.run(rig).with_rig(|rig| rig.arms))
    };
    let served = (&*signals, channels.listener.as_ref(), clock);
    let ends = threads::run(None, served, control, || robot_thread.run());
    let all = ends.control.and_then(|control| {
        let arms = control.rig;
        if arms > 0 && arms != robot.arms() {
            return Err(SessionError::BadArgument(format!(
                "the rig has {arms} arms, {} is for {}",
                robot.name,
                robot.arms()
            )));
        }
        Ok((control, ends.seen?, ends.watched?))
    });
    let (mut control, seen, watched) = match all {
        Ok(all) => all,
        Err(error) => {
            channels.log.map(|log| log.finish(None)).transpose()?;
            return Err(error);
        }
    };
    let ended = robot_ended(&seen, &watched, control.tally.faults());
    control.tally.inferences(&seen.inference);
    let log = (channels.log, pages.marked_by.as_deref());
    Ok(closed(plan, &control, &ended, log))
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
