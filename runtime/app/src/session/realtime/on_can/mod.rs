//! A real-time run of arms on CAN: the same controller, with drives on buses as its arms.
//!
//! ```text
//!  buses <── SYNC, set-points, answers ──> control thread (1 kHz, SCHED_FIFO) ── ticks ──> log thread
//!                                            ▲ chunks       │ measured, faults
//!                                            │              ▼
//!  topics ── frames; scene, verdict ──> observing thread ── arm ──> policy process ── chunks ──> first thread
//!      └── frames ────────────────────────────────────────────────────▲
//! ```
//!
//! Of a task, the world is in another process (`trocar drives`), which shows its scene and its verdict: [`run_on_can`]. A robot has
//! none: [`run_robot_on_can`] needs limits, drives and, if its policy looks at some, cameras on topics, whoever publishes them.
//!
//! What is waited for before the drives get torque is named on the terminal, and not for ever. The bring-up ends in the control
//! thread, which must not let the SYNC stop from then on. A fault of any drive or bus stops all drives of its arm and ends the run;
//! nothing enables them again but a new run.

mod awaited;
mod bring_up;
mod conclude;
mod happened;
mod scene_thread;
mod summary;

use std::sync::Arc;

use hal::config::Source;
use hal::{ARM_NAMES, TICK_NS};
use trocar_canopen::master::{BringUpError, CanConfig, Permission, enable_together};
use trocar_canopen::socket::SocketBus;
use trocar_topics::{ArmReport, Publisher, SceneTopic, TopicNode};

use super::channels::{ControlChannels, Local, ObserverChannels, ThreadChannels};
use super::child::Outside;
use super::control_thread::{ControlEnd, ControlThread};
use super::drivers::Drivers;
use super::opened::Opened;
use super::robot::{RobotOptions, RobotThread, check_faults};
use super::shown::show_rig;
use super::signals::{Moving, StopsAll};
use super::threads::{self, wired};
use crate::rig::ObservedRig;
use crate::rig::can::CanRig;
use crate::rig::can_clock::CanClock;
use crate::rt::{self, Held, MonotonicClock, Periodic, RtOptions};
use crate::session::can_interfaces;
use crate::session::plan::Arms;
use crate::session::run::RunResult;
use crate::session::{Plan, Robot, SessionError};
use bring_up::{ReadyArm, bring_up, check, check_world, failed, uninterrupted};
use conclude::{Seen, conclude};
use hal::PerArm;
use scene_thread::{SceneThread, frames};
use trocar_control::AnyController;

pub use awaited::PrintLine;
pub(super) use awaited::{AHEAD_NS_MAX, Camera, FRAME_NS_MAX, PATIENCE_NS, Wanted, cameras};
pub(super) use happened::CanEventLog;
pub(super) use scene_thread::{arm_reports, logged, seen_at};

/// How far a frame may be from the instant of an observation where cameras have clocks of their own, ms: a policy step.
pub(super) const FRAMES_WITHIN_MS: u64 = 40;

/// Where the arms are and where their world, or their cameras, show themselves.
#[derive(Clone, Debug)]
pub struct CanOptions {
    /// Nodes and buses.
    pub config: CanConfig,
    /// The name of the topics of the world, or of the cameras.
    pub topics: String,
}

impl CanOptions {
    /// Reads nodes and buses from `source`; also gives their text, for the log.
    ///
    /// # Errors
    /// [`SessionError::Config`].
    pub fn load(source: &Source, topics: &str) -> Result<(Self, String), SessionError> {
        let options = Self {
            config: CanConfig::load(source)?,
            topics: topics.to_owned(),
        };
        Ok((options, source.text().to_owned()))
    }

    /// The interfaces of the first `arms` arms, each once, and their bit rate, bit/s.
    fn buses(&self, arms: usize) -> (Vec<String>, u32) {
        let arms = self.config.arms.iter().take(arms);
        let rate = arms.clone().map(|arm| arm.plan.bit_rate).max();
        let mut interfaces: Vec<String> = arms.flat_map(|arm| arm.interfaces.clone()).collect();
        interfaces.sort_unstable();
        interfaces.dedup();
        (interfaces, rate.unwrap_or(0))
    }
}

/// What there is before anything is waited for.
struct Begun<'a> {
    can: &'a CanOptions,
    clock: MonotonicClock,
    buses: Vec<SocketBus<CanClock>>,
    node: TopicNode,
    say: PrintLine<'a>,
}

/// Opens the buses of the arms and joins the topics of their world, or of their cameras.
fn begin<'a>(
    robot: &Robot,
    can: &'a CanOptions,
    say: PrintLine<'a>,
) -> Result<Begun<'a>, SessionError> {
    check(&robot.name, robot.arms(), &can.config)?;
    check_faults(robot)?;
    let clock = MonotonicClock::new();
    rt::catch_interrupts_in_motion().map_err(SessionError::signals)?;
    let arms = can.config.arms.iter().take(robot.arms());
    let buses = arms.map(|arm| can_interfaces::open(&arm.interfaces, clock));
    Ok(Begun {
        can,
        clock,
        buses: buses.collect::<Result<_, _>>()?,
        node: TopicNode::join(&can.topics)?,
        say,
    })
}

/// Runs one episode with the task's arms on CAN.
///
/// SIGINT, SIGTERM and SIGHUP bring the arms to rest and end the run as failed, with the reason `interrupted`.
///
/// # Errors
/// From the configuration, the buses and their drives, the world's topics, the policy or the log.
pub fn run_on_can(
    plan: &Plan,
    can: &CanOptions,
    say: PrintLine<'_>,
) -> Result<RunResult, SessionError> {
    let begun = begin(&plan.setup.robot, can, say)?;
    let scene = SceneTopic::subscriber(&begun.node, ARM_NAMES[0])?;
    let world = awaited::world(&scene, &can.topics, say)?;
    check_world(&world, plan, &can.topics)?;
    begun.run(plan, 0, &[], |node, watching| {
        awaited::stopped(&scene, watching.seen.clock, &can.topics, say)?;
        let names = plan.setup.cameras_with(Vec::new());
        let logged = if watching.seen.log.is_some() {
            names
        } else {
            Vec::new()
        };
        let scene_thread = SceneThread {
            say,
            scene,
            events: node.events()?,
            seen: watching.seen,
            local: watching.local,
            reports: watching.reports,
            frames: frames(node, logged)?,
        };
        Ok(|| scene_thread.run())
    })
}

/// Runs a robot on CAN: no task, no scene and no verdict, until the time is up, a signal comes, or a fault.
///
/// SIGINT, SIGTERM and SIGHUP bring the arms to rest.
///
/// # Errors
/// From the configuration, the buses and their drives, the cameras' topics, the policy or the log.
pub fn run_robot_on_can(
    plan: &Plan<Robot>,
    asked: &RobotOptions,
    can: &CanOptions,
    say: PrintLine<'_>,
) -> Result<RunResult, SessionError> {
    let begun = begin(&plan.setup, can, say)?;
    begun.run(plan, FRAMES_WITHIN_MS, &asked.cameras, |node, watching| {
        let Watching {
            seen,
            local,
            reports,
            cameras,
        } = watching;
        // Nobody else has to be there.
        seen.signals.allow_torque();
        let supervised = (plan.setup.robot().control.supervision, plan.warn);
        let robot_thread = RobotThread::new(seen, local, reports, cameras, (asked, supervised));
        let robot_thread = robot_thread.woken_by(node.events()?);
        Ok(|| robot_thread.run())
    })
}

/// What the thread that observes the arms is made of.
struct Watching {
    seen: ObserverChannels,
    local: Local,
    /// For a policy process, one an arm.
    reports: Vec<Publisher<ArmReport>>,
    /// Cameras that were waited for, and how many of them the policy looks through: the first.
    cameras: (Vec<Camera>, usize),
}

impl Begun<'_> {
    /// Waits for the policy, its cameras and those called `asked`, brings up the drives, and runs all threads; `watch` makes the one
    /// that observes the arms. Frames may be `within_ms` from the instant of an observation.
    fn run<S: Arms, T: Seen + Send, F: FnOnce() -> Result<T, SessionError> + Send>(
        self,
        plan: &Plan<S>,
        within_ms: u64,
        asked: &[String],
        watch: impl FnOnce(&TopicNode, Watching) -> Result<F, SessionError>,
    ) -> Result<RunResult, SessionError> {
        plan.real_time.check()?;
        let (can, clock, node, say) = (self.can, self.clock, self.node, self.say);
        let outside = Outside {
            topics: &can.topics,
            frames_within_ms: within_ms,
        };
        let policy = Opened::open(plan, Some(&outside))?;
        let mut wanted = policy.cameras();
        let looked_at = wanted.len();
        for name in asked {
            if wanted.iter().all(|(known, _)| known != name) {
                wanted.push((name.clone(), None));
            }
        }
        let publisher = "`trocar drives --cameras NAME` of a simulated world";
        let topics = (can.topics.as_str(), publisher);
        let mut cameras = awaited::cameras(&node, &wanted, clock, topics, (say, &mut || Ok(())))?;
        let (mut child, source) = policy.start(plan, outside, say)?;
        let ready = bring_up(can, self.buses, say)?;
        awaited::still_there(&mut cameras, clock, &can.topics, say)?;
        let mut channels =
            ThreadChannels::new((plan.open_log(false)?, plan.console.as_ref()), clock);
        let robot = plan.setup.robot();
        let port = (channels.listener.as_ref(), &mut channels.control.operator);
        show_rig(plan, can.buses(robot.arms()), port);
        let reports = arm_reports(&node, robot.arms(), child.is_some())?;
        let (local, remote) = wired(plan, source, child.as_mut(), channels.chunk_in, clock);
        let watching = Watching {
            seen: channels.seen,
            local,
            reports,
            cameras: (cameras, looked_at),
        };
        let observe = watch(&node, watching)?;
        let enabling = Enabling {
            can,
            say,
            ready,
            controller: robot.controller()?,
            channels: channels.control,
            profile: plan.real_time.control,
            overruns_max: plan.real_time.overruns_per_s_max,
            held: plan.real_time.hold()?,
        };
        let signals = Arc::clone(&enabling.channels.signals);
        let served = (&*signals, channels.listener.as_ref());
        let ends = threads::run(remote, served, || enabling.run(), observe);
        conclude(plan, ends, channels.log, can)
    }
}

/// The control thread before its arms have torque.
struct Enabling<'a> {
    can: &'a CanOptions,
    say: PrintLine<'a>,
    ready: Vec<ReadyArm>,
    controller: AnyController,
    channels: ControlChannels,
    profile: RtOptions,
    overruns_max: Option<u64>,
    held: Held,
}

impl Enabling<'_> {
    /// Enables all drives and controls them until the run is over, which leaves them without torque.
    fn run(self) -> Result<ControlEnd<CanRig>, SessionError> {
        let ControlChannels {
            measured,
            noticed,
            chunks,
            log,
            signals,
            operator,
            clock,
        } = self.channels;
        // Until the drives are taken down.
        let _moving = Moving;
        let _stops = StopsAll(&signals);
        uninterrupted()?;
        if signals.done() {
            return Err(SessionError::Interrupted);
        }
        // From here on the drives want their SYNC in time; the loop reports what was granted.
        let _granted = rt::configure_thread(&self.profile);
        (self.say)("checking the drives once more; they are enabled when all answer");
        let arms = enable_together(self.ready, &mut || {
            if signals.done() || rt::interrupted() {
                Permission::Denied
            } else if signals.torque_allowed() {
                Permission::Granted
            } else {
                Permission::Pending
            }
        });
        let arms = arms.map_err(|(arm, error)| {
            if error == BringUpError::Denied {
                return SessionError::Interrupted;
            }
            failed(self.can, arm, &error)
        })?;
        let Some(arms) = PerArm::collect(arms) else {
            return Err(SessionError::BadArgument("there is no arm".to_owned()));
        };
        // The SYNC goes on at once.
        let periodic = Periodic::new(clock, clock.now().plus_ns(TICK_NS), TICK_NS);
        let control = ControlThread {
            controller: self.controller,
            rig: ObservedRig::new(CanRig::new(arms, noticed, periodic), measured),
            drivers: Drivers::new(chunks, None),
            log,
            signals: Arc::clone(&signals),
            operator,
            profile: self.profile,
            overruns_max: self.overruns_max,
            fault_ends_run: true,
            held: self.held,
        };
        let mut end = control.run(clock).with_rig(|observed| observed.rig);
        end.rig.take_down(clock);
        Ok(end)
    }
}
