//! What comes before the first SYNC: what is wrong without any bus, the world, and the way of the
//! drives to where they may be enabled.
//!
//! Arms come up one after another; those that are ready are listened to meanwhile, so that a drive
//! that is lost is known. All are enabled together later, on the control thread.

use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel};
use std::thread;
use std::time::Duration;

use hal::{ARM_NAMES, TICK_NS, TimeNs};
use trocar_canopen::master::{ArmPlan, BringUpError, CanConfig, Homed, Offline, Step};
use trocar_canopen::socket::SocketBus;
use trocar_topics::{SceneReport, Verdict};

use super::awaited::{PATIENCE_NS, PrintLine, uninterrupted};
use super::options::CanOptions;
use crate::rig::can_clock::CanClock;
use crate::rt::{self, MonotonicClock};
use crate::session::{Plan, SessionError};

/// Polling period, ns.
const POLL_NS: u64 = 1_000_000;

/// An arm that has its references and no torque yet.
pub(super) type ReadyArm = Homed<SocketBus<CanClock>>;

/// What can be known to be wrong before anything is opened: `whose` (a task, a file) has `count`
/// arms.
///
/// The cycle must be a whole multiple of the control period, and the frames of a cycle must fit on
/// each bus.
///
/// # Errors
/// [`SessionError::BadArgument`] and [`SessionError::Overload`].
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
///
/// Task, seed and hash of the scene must be those of `plan`, and its episode must not have begun:
/// one world is one episode.
///
/// # Errors
/// [`SessionError::BadArgument`] for another world, [`SessionError::RealTime`] for one that is used
/// up.
pub(super) fn check_world(
    world: &SceneReport,
    plan: &Plan,
    (topics, host): (&str, &str),
) -> Result<(), SessionError> {
    let (task, seed) = (world.task.text(), world.seed);
    let ours = plan.world_name();
    if task != ours.task || seed != ours.seed {
        return Err(SessionError::BadArgument(format!(
            "the world on topics {topics:?} is {task}, seed {seed}; this run is {}, seed {}",
            ours.task, ours.seed
        )));
    }
    if world.scene_hash != ours.scene_hash {
        return Err(SessionError::BadArgument(format!(
            "the world on topics {topics:?} has another scene than this run: --scene, --needle, --view and --set scene.KEY must be the \
             same for `{host}` and `trocar run`"
        )));
    }
    match world.verdict() {
        Verdict::Waiting | Verdict::Operational => Ok(()),
        Verdict::Running | Verdict::Success | Verdict::Failure | Verdict::Invalid => {
            Err(SessionError::RealTime(format!(
                "the episode of the world on topics {topics:?} has begun already: start `{host}` anew"
            )))
        }
    }
}

/// Time between two lines about the same arm, ns.
const LINES_NS: u64 = 1_000_000_000;

/// Leads the drives of all arms to where they may be enabled, one arm after the other, and says
/// what it is at if that takes long.
///
/// Blocks for as long as homing takes; an interrupt cancels it.
///
/// # Errors
/// [`SessionError::BringUp`] with arm, interfaces and the step's reason, also if an arm that was
/// ready is lost meanwhile.
pub(super) fn bring_up(
    can: &CanOptions,
    buses: Vec<SocketBus<CanClock>>,
    say: PrintLine<'_>,
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
    /// A signal came before this arm was homed.
    Interrupted(SessionError),
    /// A drive or its bus did not do what was asked.
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
///
/// The typestates of `trocar_canopen` in order: offline, scanned, identified, mapped, homed. Every
/// step goes to `steps`.
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
///
/// The narrator is a thread of its own, which ends when `work` drops its sender.
fn narrated<T>(name: &str, say: PrintLine<'_>, work: impl FnOnce(Sender<Step>) -> T) -> T {
    let (steps, told) = channel();
    thread::scope(|scope| {
        scope.spawn(move || narrate(name, &told, say));
        work(steps)
    })
}

/// Says, at first after a little and then once a second, what bring-up is at, until that is over.
///
/// The first line after half a second: a bring-up that is quick says nothing.
fn narrate(name: &str, told: &Receiver<Step>, say: PrintLine<'_>) {
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
///
/// An error of `work` is reported before one of the listener. Without ready arms no thread is
/// started.
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
///
/// Polls each millisecond.
fn listen(can: &CanOptions, ready: &mut [ReadyArm], done: &AtomicBool) -> Result<(), SessionError> {
    while !done.load(Ordering::Relaxed) {
        for (index, arm) in ready.iter_mut().enumerate() {
            arm.listen().map_err(|error| failed(can, index, &error))?;
        }
        rt::sleep_ns(POLL_NS);
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::changes::{Change, Changes};
    use crate::session::scene_options::SceneOptions;
    use crate::session::{PolicyChoice, Setup};

    fn plan(seed: u64, set: &[&str], options: &SceneOptions) -> Plan {
        let changes = Changes(
            set.iter()
                .map(|set| set.parse::<Change>().unwrap())
                .collect(),
        );
        let policy = PolicyChoice::Noop;
        let setup = Setup::load_with("needle-lift", None, &policy, options, changes).unwrap();
        Plan {
            seed,
            ..Plan::new(setup, policy)
        }
    }

    /// What the two processes of a run over CAN were told differently is refused before any drive
    /// has torque.
    #[test]
    fn a_world_that_was_configured_otherwise_is_refused() {
        let as_shipped = SceneOptions::default();
        let name = plan(3, &[], &as_shipped).world_name();
        let world = SceneReport {
            task: trocar_topics::Line::new(&name.task),
            scene_hash: name.scene_hash,
            seed: 3,
            code: SceneReport::code_of(Verdict::Waiting),
            ..SceneReport::default()
        };
        let refused = |plan: &Plan| {
            check_world(&world, plan, ("lab", "trocar drives")).map_err(|it| it.to_string())
        };
        assert_eq!(refused(&plan(3, &[], &as_shipped)), Ok(()));
        let limits = plan(3, &["control.policy.restarts=1"], &as_shipped);
        assert_eq!(refused(&limits), Ok(()), "the controller is the run's own");
        let another = refused(&plan(4, &[], &as_shipped)).unwrap_err();
        assert!(
            another.contains("seed 3; this run is needle-lift, seed 4"),
            "{another}"
        );
        let needle = SceneOptions {
            needle: Some("N3".to_owned()),
            ..SceneOptions::default()
        };
        for other in [
            plan(3, &["scene.episode.time_limit_s=5"], &as_shipped),
            plan(3, &[], &needle),
        ] {
            let error = refused(&other).unwrap_err();
            assert!(error.contains("another scene than this run"), "{error}");
        }
    }
}
