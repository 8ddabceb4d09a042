//! What comes before the first SYNC: what is wrong without any bus, the world, and the way of the drives to where they may be
//! enabled.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::Duration;

use hal::{ARM_NAMES, TICK_NS, TimeNs};
use trocar_canopen::master::{ArmPlan, BringUpError, CanConfig, Homed, Offline, Step};
use trocar_canopen::socket::SocketBus;
use trocar_topics::{SceneReport, Verdict};

use super::CanOptions;
use super::awaited::{PATIENCE_NS, Say};
use crate::rig::can_clock::CanClock;
use crate::rt::{self, MonotonicClock};
use crate::session::{Plan, SessionError};

/// Time between two looks, ns.
const POLL_NS: u64 = 1_000_000;

/// An arm that has its references and no torque yet.
pub(super) type ReadyArm = Homed<SocketBus<CanClock>>;

/// What can be known to be wrong before anything is opened: `whose` (a task, a file) has `count` arms.
pub(super) fn check(whose: &str, count: usize, can: &CanConfig) -> Result<(), SessionError> {
    if can.arms.len() < count {
        return Err(SessionError::BadArgument(format!(
            "arm: {} arms are on CAN, {whose} has {count}",
            can.arms.len()
        )));
    }
    for arm in &can.arms[..count] {
        if !arm.plan.cycle_ns.is_multiple_of(TICK_NS) {
            return Err(SessionError::BadArgument(format!(
                "cycle_us = {}: the controller's period is {} us, and a cycle must be a whole number of those",
                arm.plan.cycle_ns / 1000,
                TICK_NS / 1000
            )));
        }
    }
    can.check_load(count).map_err(SessionError::Overload)
}

/// The world must be the one that is meant, and not be used up.
pub(super) fn check_world(
    world: &SceneReport,
    plan: &Plan,
    topics: &str,
) -> Result<(), SessionError> {
    let (task, seed) = (world.task.text(), world.seed);
    let name = &plan.setup.task_name;
    if task != *name || seed != plan.seed {
        return Err(SessionError::BadArgument(format!(
            "the world on topics {topics:?} is {task}, seed {seed}; this run is {name}, seed {}",
            plan.seed
        )));
    }
    match world.verdict() {
        Verdict::Waiting | Verdict::Operational => Ok(()),
        Verdict::Running | Verdict::Success | Verdict::Failure | Verdict::Invalid => {
            Err(SessionError::RealTime(format!(
                "the episode of the world on topics {topics:?} has begun already: start `trocar drives` anew"
            )))
        }
    }
}

/// Time between two lines about the same arm, ns.
const LINES_NS: u64 = 1_000_000_000;

/// Leads the drives of all arms to where they may be enabled, one arm after the other, and says what it is at if that takes long.
pub(super) fn bring_up(
    can: &CanOptions,
    buses: Vec<SocketBus<CanClock>>,
    say: Say<'_>,
) -> Result<Vec<ReadyArm>, SessionError> {
    let mut ready = Vec::new();
    for (index, (bus, arm)) in buses.into_iter().zip(&can.config.arms).enumerate() {
        uninterrupted()?;
        let home = |steps| home(bus, &arm.plan, steps).map_err(|error| error.in_arm(can, index));
        let name = ARM_NAMES[index];
        let homed = while_listening(can, &mut ready, || narrated(name, say, home))?;
        ready.push(homed);
    }
    Ok(ready)
}

/// Why an arm did not get its references.
enum NotHomed {
    Interrupted(SessionError),
    Failed(BringUpError),
}

impl NotHomed {
    fn in_arm(self, can: &CanOptions, index: usize) -> SessionError {
        match self {
            Self::Interrupted(error) => error,
            Self::Failed(error) => failed(can, index, &error),
        }
    }
}

/// Leads the drives of one arm to where they may be enabled.
fn home(
    bus: SocketBus<CanClock>,
    plan: &ArmPlan,
    steps: Sender<Step>,
) -> Result<ReadyArm, NotHomed> {
    let mapped = Offline::new(bus, plan)
        .map(|offline| offline.telling(steps).cancelled_by(rt::interrupted))
        .and_then(Offline::scan)
        .and_then(|scanned| scanned.check_identity())
        .and_then(|identified| identified.map())
        .map_err(NotHomed::Failed)?;
    uninterrupted().map_err(NotHomed::Interrupted)?;
    mapped.home().map_err(NotHomed::Failed)
}

/// Does `work`, and meanwhile says of the arm `name` what it is at.
fn narrated<T>(name: &str, say: Say<'_>, work: impl FnOnce(Sender<Step>) -> T) -> T {
    let (steps, told) = channel();
    thread::scope(|scope| {
        scope.spawn(move || narrate(name, &told, say));
        work(steps)
    })
}

/// Says, at first after a little and then once a second, what bring-up is at, until that is over.
fn narrate(name: &str, told: &Receiver<Step>, say: Say<'_>) {
    let clock = MonotonicClock::new();
    let (mut step, mut next) = (Step::Finding, TimeNs(PATIENCE_NS));
    loop {
        let wait = Duration::from_nanos(next.since(clock.now()));
        match told.recv_timeout(wait) {
            Ok(newest) => step = newest,
            Err(RecvTimeoutError::Timeout) => {
                say(&format!("{name}: bringing up its drives, {}", step.doing()));
                next = next.plus_ns(LINES_NS);
            }
            Err(RecvTimeoutError::Disconnected) => return,
        }
    }
}

/// Does `work`, and meanwhile hears what comes for the arms that are `ready`.
fn while_listening<T>(
    can: &CanOptions,
    ready: &mut [ReadyArm],
    work: impl FnOnce() -> Result<T, SessionError>,
) -> Result<T, SessionError> {
    if ready.is_empty() {
        return work();
    }
    let done = AtomicBool::new(false);
    thread::scope(|scope| {
        let listener = scope.spawn(|| listen(can, ready, &done));
        let result = work();
        done.store(true, Ordering::Relaxed);
        let heard = listener.join();
        let value = result?;
        heard.unwrap_or_else(|_| Err(SessionError::RealTime("a listener panicked".to_owned())))?;
        Ok(value)
    })
}

/// Hears what comes for the arms that are `ready` until the work is `done`.
fn listen(can: &CanOptions, ready: &mut [ReadyArm], done: &AtomicBool) -> Result<(), SessionError> {
    while !done.load(Ordering::Relaxed) {
        for (index, arm) in ready.iter_mut().enumerate() {
            arm.listen().map_err(|error| failed(can, index, &error))?;
        }
        rt::sleep_ns(POLL_NS);
    }
    Ok(())
}

/// Whoever interrupts a run before its drives have torque does not want them to get it.
pub(super) fn uninterrupted() -> Result<(), SessionError> {
    if rt::interrupted() {
        let what = "interrupted before the drives were enabled";
        return Err(SessionError::RealTime(what.to_owned()));
    }
    Ok(())
}

/// The arm in this place did not come up.
pub(super) fn failed(
    can: &CanOptions,
    arm: usize,
    error: &impl core::fmt::Display,
) -> SessionError {
    let interfaces = can.config.arms.get(arm).map(|arm| arm.interfaces.join(" "));
    SessionError::BringUp {
        arm: ARM_NAMES[arm],
        interfaces: interfaces.unwrap_or_default(),
        reason: error.to_string(),
    }
}
