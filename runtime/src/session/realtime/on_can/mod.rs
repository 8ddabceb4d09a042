//! A real-time run of arms on CAN: the same controller, with drives on buses as its arms and the world in another process.
//!
//! ```text
//!  buses <── SYNC, set-points, answers ──> control thread (1 kHz, SCHED_FIFO) ── ticks ──> log thread
//!                                            ▲ chunks       │ measured, faults
//!                                            │              ▼
//!  world's topics ── scene, verdict ──> scene thread ── arm ──> policy process ── chunks ──> first thread
//!                └── frames ───────────────────────────────────────▲
//! ```
//!
//! The bring-up ends in the control thread, which must not let the beat stop from then on. A fault of any drive or bus stops
//! all drives of its arm and ends the run; nothing enables them again but a new run.

mod bring_up;
mod conclude;
mod happened;
mod link;
mod scene_thread;

use std::sync::Arc;
use std::thread;

use hal::config::Source;
use hal::{ARM_NAMES, ArmState, Chunk, TICK_NS};
use rtrb::{Consumer, Producer, RingBuffer};
use trocar_canopen::master::{CanConfig, enable_together};
use trocar_topics::{SceneReport, SceneTopic, Subscriber, TopicNode};

use super::child::PolicyChild;
use super::control_thread::{ControlEnd, ControlThread};
use super::signals::{Signals, StopsAll};
use super::watch::{Watched, watch};
use super::{CHUNK_QUEUE, joined};
use crate::control::AnyController;
use crate::log::{LogFile, TickLog};
use crate::mailbox::{MailboxWriter, mailbox};
use crate::per_arm::PerArm;
use crate::rt::{self, MonotonicClock};
use crate::session::can_interfaces;
use crate::session::run::{RunOptions, RunResult, open_log};
use crate::session::source::ChunkSource;
use crate::session::{PolicyChoice, SessionError, Setup};
use bring_up::{ReadyArm, await_world, bring_up, check, check_world, failed, uninterrupted};
use conclude::conclude;
use happened::Noticed;
use link::CanLink;
use scene_thread::{SceneEnd, SceneThread, arm_reports, frames};

/// Where the arms are and where their world shows itself.
#[derive(Clone, Debug)]
pub struct CanOptions {
    /// Nodes and buses.
    pub config: CanConfig,
    /// The name of the world's topics.
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
) -> Result<RunResult, SessionError> {
    check(setup, &can.config)?;
    rt::catch_interrupts()
        .map_err(|error| SessionError::RealTime(format!("catching signals failed: {error}")))?;
    let clock = MonotonicClock::new();
    let count = setup.task.arms.len();
    let arms = can.config.arms.iter().take(count);
    let buses = arms.map(|arm| can_interfaces::open(&arm.interfaces, clock));
    let buses: Vec<_> = buses.collect::<Result<_, _>>()?;
    let node = TopicNode::join(&can.topics)?;
    let scene = SceneTopic::subscriber(&node, ARM_NAMES[0])?;
    let waiting = await_world(&scene, &can.topics, clock)?;
    check_world(&waiting, setup, options, &can.topics)?;
    let mut child = match &options.policy {
        PolicyChoice::Checkpoint(path) => {
            let world = Some((can.topics.as_str(), clock));
            Some(PolicyChild::start(setup, path, options, world)?)
        }
        PolicyChoice::Expert | PolicyChoice::Noop | PolicyChoice::Random => None,
    };
    let ready = bring_up(can, buses)?;
    let parts = Parts {
        clock,
        node: &node,
        scene,
    };
    let ends = run_threads(setup, options, can, parts, child.as_mut(), ready)?;
    conclude(setup, options, can, ends)
}

struct Parts<'a> {
    clock: MonotonicClock,
    node: &'a TopicNode,
    scene: Subscriber<SceneReport>,
}

/// What the threads give back.
struct Ends {
    control: Result<ControlEnd<CanLink>, SessionError>,
    watched: Result<Watched, SessionError>,
    scene: Result<SceneEnd, SessionError>,
    log: Option<LogFile>,
}

fn run_threads(
    setup: &Setup,
    options: &RunOptions,
    can: &CanOptions,
    parts: Parts<'_>,
    child: Option<&mut PolicyChild>,
    ready: Vec<ReadyArm>,
) -> Result<Ends, SessionError> {
    let Parts { clock, node, scene } = parts;
    let (chunk_in, chunks) = RingBuffer::<PerArm<Chunk>>::new(CHUNK_QUEUE);
    let (measured_in, measured) = mailbox();
    let (noticed_in, noticed) = mailbox();
    let signals = Arc::new(Signals::default());
    let reports = match &child {
        Some(_) => arm_reports(node, setup)?,
        None => Vec::new(),
    };
    let (local, remote) = local_or_remote(setup, options, child, chunk_in)?;
    let (tick_log, side_log, log) = match open_log(setup, options, false)? {
        Some(recorder) => {
            let (ticks, side, file) = recorder.split();
            (Some(ticks), Some(side), Some(file))
        }
        None => (None, None, None),
    };
    let kept = match &side_log {
        Some(_) => frames(node, setup.cameras_with(Vec::new()))?,
        None => Vec::new(),
    };
    let scene_thread = SceneThread {
        scene,
        clock,
        measured,
        noticed,
        told: None,
        local,
        reports,
        frames: kept,
        log: side_log,
        signals: Arc::clone(&signals),
    };
    let enabling = Enabling {
        can,
        ready,
        controller: setup.controller()?,
        measured: measured_in,
        noticed: noticed_in,
        chunks,
        log: tick_log,
        signals: Arc::clone(&signals),
        clock,
    };
    Ok(thread::scope(|scope| {
        let control = scope.spawn(move || enabling.run());
        let scene = scope.spawn(move || scene_thread.run());
        let watched = watch(remote, &signals);
        Ends {
            control: joined(control).and_then(|end| end),
            scene: joined(scene).and_then(|end| end),
            watched,
            log,
        }
    }))
}

/// A policy of this process with the queue for its chunks, or of another process.
type Local = Option<(ChunkSource, Producer<PerArm<Chunk>>)>;
type Remote<'a> = Option<(&'a mut PolicyChild, Producer<PerArm<Chunk>>)>;

fn local_or_remote<'a>(
    setup: &Setup,
    options: &RunOptions,
    child: Option<&'a mut PolicyChild>,
    chunks: Producer<PerArm<Chunk>>,
) -> Result<(Local, Remote<'a>), SessionError> {
    match child {
        Some(child) => Ok((None, Some((child, chunks)))),
        None => {
            let source = setup.source(&options.policy, options.seed, options.compute)?;
            Ok((Some((source, chunks)), None))
        }
    }
}

/// The control thread before its arms have torque.
struct Enabling<'a> {
    can: &'a CanOptions,
    ready: Vec<ReadyArm>,
    controller: AnyController,
    measured: MailboxWriter<PerArm<ArmState>>,
    noticed: MailboxWriter<Noticed>,
    chunks: Consumer<PerArm<Chunk>>,
    log: Option<TickLog>,
    signals: Arc<Signals>,
    clock: MonotonicClock,
}

impl Enabling<'_> {
    /// Enables all drives and controls them until the run is over, which leaves them without torque.
    fn run(self) -> Result<ControlEnd<CanLink>, SessionError> {
        let _stops = StopsAll(&self.signals);
        uninterrupted()?;
        let arms =
            enable_together(self.ready).map_err(|(arm, error)| failed(self.can, arm, &error))?;
        let Some(arms) = PerArm::collect(arms) else {
            return Err(SessionError::BadArgument("there is no arm".to_owned()));
        };
        let control = ControlThread {
            controller: self.controller,
            link: CanLink::new(arms, self.measured, self.noticed),
            chunks: self.chunks,
            log: self.log,
            signals: Arc::clone(&self.signals),
        };
        // The beat goes on at once.
        let first = self.clock.now().plus_ns(TICK_NS);
        let mut end = control.run(self.clock, first);
        end.link.shut_down();
        Ok(end)
    }
}
