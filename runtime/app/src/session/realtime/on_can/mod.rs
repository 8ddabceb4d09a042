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
use std::thread;

use hal::config::Source;
use hal::{ARM_NAMES, Chunk, TICK_NS};
use rtrb::Producer;
use tch::Device;
use trocar_canopen::master::{CanConfig, enable_together};
use trocar_canopen::socket::SocketBus;
use trocar_nets::loaded_policy::LoadedPolicy;
use trocar_topics::{SceneTopic, TopicNode};

use super::child::{Outside, PolicyChild, check_cameras};
use super::control_thread::{ControlEnd, ControlThread};
use super::robot::{RobotOptions, RobotThread};
use super::shown::show_rig;
use super::signals::{Moving, StopsAll};
use super::watch::{Watched, watch};
use super::wires::{ControlWires, Local, Wires};
use super::{joined, labels};
use crate::rig::Observed;
use crate::rig::can::CanRig;
use crate::rig::can_clock::CanClock;
use crate::rt::{self, MonotonicClock, Periodic};
use crate::session::can_interfaces;
use crate::session::external::{About, ExternalChoice, ExternalLink, check_wanted};
use crate::session::operator::Listener;
use crate::session::run::{RunOptions, RunResult, open_log, open_log_with};
use crate::session::source::{ChunkSource, camera_names};
use crate::session::tally::RunLabels;
use crate::session::{PolicyChoice, Robot, SessionError, Setup};
use bring_up::{ReadyArm, bring_up, check, check_world, failed, uninterrupted};
use conclude::conclude;
use hal::PerArm;
use scene_thread::{SceneThread, arm_reports, frames};
use trocar_control::AnyController;
use trocar_log::LogFile;

pub use awaited::Say;
pub(super) use awaited::{AHEAD_NS_MAX, Camera, FRAME_NS_MAX, PATIENCE_NS};
pub(super) use happened::News;
pub(super) use scene_thread::{logged, seen_at};

/// How far a frame may be from the instant of an observation where cameras have clocks of their own, ms: a policy step.
const FRAMES_WITHIN_MS: u64 = 40;

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
}

/// Opens the buses of the first `count` arms.
fn open_buses(
    can: &CanOptions,
    count: usize,
    clock: MonotonicClock,
) -> Result<Vec<SocketBus<CanClock>>, SessionError> {
    rt::catch_interrupts_in_motion()
        .map_err(|error| SessionError::RealTime(format!("catching signals failed: {error}")))?;
    let arms = can.config.arms.iter().take(count);
    let buses = arms.map(|arm| can_interfaces::open(&arm.interfaces, clock));
    buses.collect()
}

/// Runs one episode with the task's arms on CAN.
///
/// SIGINT, SIGTERM and SIGHUP bring the arms to rest and end the run as failed, with the reason `interrupted`.
///
/// # Errors
/// From the configuration, the buses and their drives, the world's topics, the policy or the log.
pub fn run_on_can(
    setup: &Setup,
    options: &RunOptions,
    can: &CanOptions,
    say: Say<'_>,
) -> Result<RunResult, SessionError> {
    let count = setup.task.arms.len();
    check(&format!("task {}", setup.task_name), count, &can.config)?;
    let clock = MonotonicClock::new();
    let buses = open_buses(can, count, clock)?;
    let node = TopicNode::join(&can.topics)?;
    let scene = SceneTopic::subscriber(&node, ARM_NAMES[0])?;
    let waiting = awaited::world(&scene, &can.topics, say)?;
    check_world(&waiting, setup, options, &can.topics)?;
    let mut cameras = Vec::new();
    let (mut child, mut local) = match &options.policy {
        PolicyChoice::Checkpoint(path) => {
            let network = setup.network(path, Device::Cpu)?;
            check_cameras(setup, &network)?;
            cameras = awaited::cameras(&node, &looked_at(&network), clock, &can.topics, say)?;
            let outside = Outside {
                topics: &can.topics,
                clock,
                frames_within_ms: 0,
            };
            let child = PolicyChild::start(&network, path, options, Some(outside), say)?;
            (Some(child), None)
        }
        PolicyChoice::External(choice) => {
            let link = external(choice, can, &setup.task_name, count, 0)?;
            check_wanted(setup, &link.cameras)?;
            cameras = awaited::cameras(&node, &unsized_of(&link), clock, &can.topics, say)?;
            let child = external_child(link, count, options, (can, clock), say)?;
            (Some(child), None)
        }
        PolicyChoice::Expert | PolicyChoice::Noop | PolicyChoice::Random | PolicyChoice::Own(_) => {
            let source = setup.source(&options.policy, options.seed, options.compute)?;
            (None, Some(source))
        }
    };
    let ready = bring_up(can, buses, say)?;
    awaited::still_there(&mut cameras, clock, &can.topics, say)?;
    drop(cameras);
    let recorder = open_log(setup, options, false)?;
    let mut wires = Wires::new(recorder, clock);
    let port = (wires.listener.as_ref(), &mut wires.control.operator);
    show_rig(&setup.task_name, &setup.control, options, port);
    let reports = arm_reports(&node, count, child.is_some())?;
    let (local, remote) = wired(local.take(), child.as_mut(), wires.chunk_in);
    let seen = wires.seen;
    let kept = match &seen.log {
        Some(_) => frames(&node, setup.cameras_with(Vec::new()))?,
        None => Vec::new(),
    };
    let scene_thread = SceneThread {
        say,
        scene,
        seen,
        local,
        reports,
        frames: kept,
    };
    let enabling = Enabling {
        can,
        ready,
        controller: setup.controller()?,
        wires: wires.control,
    };
    let outer = (wires.log, wires.listener);
    let ends = run_threads(enabling, remote, outer, || scene_thread.run());
    let policy = options.policy.name();
    conclude(ends, labels(setup, options, &policy), can)
}

/// Runs a robot on CAN: no task, no scene and no verdict, until the time is up, a signal comes, or a fault.
///
/// SIGINT, SIGTERM and SIGHUP bring the arms to rest.
///
/// # Errors
/// From the configuration, the buses and their drives, the cameras' topics, the policy or the log.
pub fn run_robot_on_can(
    robot: &Robot,
    options: &RunOptions,
    asked: &RobotOptions,
    can: &CanOptions,
    say: Say<'_>,
) -> Result<RunResult, SessionError> {
    let count = robot.arms();
    check(&robot.safety_file, count, &can.config)?;
    let clock = MonotonicClock::new();
    let buses = open_buses(can, count, clock)?;
    let node = TopicNode::join(&can.topics)?;
    let mut link = None;
    let (network, mut local) = match &options.policy {
        PolicyChoice::Checkpoint(path) => (Some((robot.network(path, Device::Cpu)?, path)), None),
        PolicyChoice::External(choice) => {
            link = Some(external(choice, can, "", count, FRAMES_WITHIN_MS)?);
            (None, None)
        }
        PolicyChoice::Expert | PolicyChoice::Noop | PolicyChoice::Random | PolicyChoice::Own(_) => {
            (None, Some(Robot::source(&options.policy, options.seed)?))
        }
    };
    let mut wanted: Vec<_> = network
        .iter()
        .flat_map(|(network, _)| looked_at(network))
        .chain(link.iter().flat_map(unsized_of))
        .collect();
    let seen_by_policy = wanted.len();
    for name in &asked.cameras {
        if wanted.iter().all(|(known, _)| known != name) {
            wanted.push((name.clone(), None));
        }
    }
    let mut cameras = awaited::cameras(&node, &wanted, clock, &can.topics, say)?;
    let mut child = match &network {
        Some((network, path)) => {
            let outside = Outside {
                topics: &can.topics,
                clock,
                frames_within_ms: FRAMES_WITHIN_MS,
            };
            let outside = Some(outside);
            Some(PolicyChild::start(network, path, options, outside, say)?)
        }
        None => link
            .map(|link| external_child(link, count, options, (can, clock), say))
            .transpose()?,
    };
    drop(network);
    let ready = bring_up(can, buses, say)?;
    awaited::still_there(&mut cameras, clock, &can.topics, say)?;
    let recorder = open_log_with(&robot.header(options), options)?;
    let mut wires = Wires::new(recorder, clock);
    let port = (wires.listener.as_ref(), &mut wires.control.operator);
    show_rig("robot", &robot.control, options, port);
    let reports = arm_reports(&node, count, child.is_some())?;
    let (local, remote) = wired(local.take(), child.as_mut(), wires.chunk_in);
    let cameras = (cameras, seen_by_policy);
    let robot_thread = RobotThread::new(wires.seen, local, reports, cameras, asked);
    let enabling = Enabling {
        can,
        ready,
        controller: robot.controller()?,
        wires: wires.control,
    };
    let outer = (wires.log, wires.listener);
    let ends = run_threads(enabling, remote, outer, || robot_thread.run());
    let policy = options.policy.name();
    let labels = RunLabels {
        policy: &policy,
        trained_on: robot.trained_on.as_deref(),
        weights_sha256: robot.weights_sha256.as_deref(),
        seed: options.seed,
        ..RunLabels::default()
    };
    conclude(ends, labels, can)
}

/// What the threads give back; `T` is that of the observing one.
struct Ends<T> {
    control: Result<ControlEnd<CanRig>, SessionError>,
    watched: Result<Watched, SessionError>,
    seen: Result<T, SessionError>,
    log: Option<LogFile>,
}

/// A policy of another process with the queue for its chunks.
pub(super) type Remote<'a> = Option<(&'a mut PolicyChild, Producer<PerArm<Chunk>>)>;

/// The cameras that `network` looks through, with their sizes in pixels.
fn looked_at(network: &LoadedPolicy) -> Vec<(String, Option<(u32, u32)>)> {
    let sizes = network.recipe().cameras.iter();
    let sizes = sizes.map(|camera| Some((camera.width, camera.height)));
    camera_names(network).into_iter().zip(sizes).collect()
}

/// Waits for an external policy, which is on the topics of the world, or of the cameras: it sees these as they are.
fn external(
    choice: &ExternalChoice,
    can: &CanOptions,
    task: &str,
    arms: usize,
    frames_within_ms: u64,
) -> Result<ExternalLink, SessionError> {
    if let Some(name) = choice.name.as_ref().filter(|name| **name != can.topics) {
        return Err(SessionError::BadArgument(format!(
            "--policy external:{name}: with --backend can it is on the topics of the cameras, --topics {}",
            can.topics
        )));
    }
    let about = About {
        task,
        arms,
        lockstep: false,
        frames_within_ms,
    };
    ExternalLink::open(&can.topics, choice.within_s, &about)
}

/// The cameras of an external policy, of any size.
fn unsized_of(link: &ExternalLink) -> Vec<(String, Option<(u32, u32)>)> {
    let names = link.cameras.iter();
    names.map(|name| (name.clone(), None)).collect()
}

fn external_child(
    link: ExternalLink,
    arms: usize,
    options: &RunOptions,
    (can, clock): (&CanOptions, MonotonicClock),
    say: Say<'_>,
) -> Result<PolicyChild, SessionError> {
    let outside = Outside {
        topics: &can.topics,
        clock,
        // The session has told it.
        frames_within_ms: 0,
    };
    PolicyChild::external(link, arms, options.seed, Some(outside), say)
}

/// Gives the queue for chunks to whoever answers: a source of this process, or the policy process.
pub(super) fn wired(
    source: Option<ChunkSource>,
    child: Option<&mut PolicyChild>,
    chunk_in: Producer<PerArm<Chunk>>,
) -> (Local, Remote<'_>) {
    match child {
        Some(child) => (None, Some((child, chunk_in))),
        None => (source.map(|source| (source, chunk_in)), None),
    }
}

/// Controls the arms in one thread, observes them in another, and looks after the policy process in this one.
fn run_threads<T: Send>(
    enabling: Enabling<'_>,
    remote: Remote<'_>,
    (log, listener): (Option<LogFile>, Option<Listener>),
    observe: impl FnOnce() -> Result<T, SessionError> + Send,
) -> Ends<T> {
    let signals = Arc::clone(&enabling.wires.signals);
    thread::scope(|scope| {
        if let Some(listener) = &listener {
            scope.spawn(|| listener.serve(scope, &*signals));
        }
        let control = scope.spawn(move || enabling.run());
        let seen = scope.spawn(observe);
        let watched = watch(remote, &signals);
        Ends {
            control: joined(control).and_then(|end| end),
            seen: joined(seen).and_then(|end| end),
            watched,
            log,
        }
    })
}

/// The control thread before its arms have torque.
struct Enabling<'a> {
    can: &'a CanOptions,
    ready: Vec<ReadyArm>,
    controller: AnyController,
    wires: ControlWires,
}

impl Enabling<'_> {
    /// Enables all drives and controls them until the run is over, which leaves them without torque.
    fn run(self) -> Result<ControlEnd<CanRig>, SessionError> {
        let ControlWires {
            measured,
            noticed,
            chunks,
            log,
            signals,
            operator,
            clock,
        } = self.wires;
        // Until the drives are taken down.
        let _moving = Moving;
        let _stops = StopsAll(&signals);
        uninterrupted()?;
        if signals.done() {
            return Err(SessionError::Interrupted);
        }
        let arms =
            enable_together(self.ready).map_err(|(arm, error)| failed(self.can, arm, &error))?;
        let Some(arms) = PerArm::collect(arms) else {
            return Err(SessionError::BadArgument("there is no arm".to_owned()));
        };
        // The SYNC goes on at once.
        let periodic = Periodic::new(clock, clock.now().plus_ns(TICK_NS), TICK_NS);
        let control = ControlThread {
            controller: self.controller,
            rig: Observed::new(CanRig::new(arms, noticed, periodic), measured),
            chunks,
            log,
            signals: Arc::clone(&signals),
            operator,
        };
        let mut end = control.run(clock).with_rig(|observed| observed.rig);
        end.rig.take_down(clock);
        Ok(end)
    }
}
