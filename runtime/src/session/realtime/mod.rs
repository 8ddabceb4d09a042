//! A real-time run: the control thread on its own, its neighbours on theirs, the network in its own process.
//!
//! ```text
//!  simulation thread (1 kHz) ── measured ──> control thread (1 kHz, SCHED_FIFO) ── commands ──> simulation thread
//!         │ snapshots                              ▲ chunks            │ ticks
//!         ▼                                        │                   ▼
//!   camera thread ── frames, arm ──> policy process ── chunks ──> chunk thread      log thread
//! ```
//!
//! Everything that reaches the control thread comes through wait-free mailboxes and queues.

mod camera_thread;
mod child;
mod control_thread;
mod policy_process;
mod simulation_thread;

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use hal::{ArmCommand, ArmState, Chunk};
use rtrb::RingBuffer;
use sim_backend::simulation::{Rendering, Simulation};
use sim_backend::task::Outcome;

pub use policy_process::{PolicyProcessOptions, serve_policy};

use super::run::{RunOptions, RunResult, open_log};
use super::source::{ChunkSource, PolicyChoice};
use super::summary::RealTimeCounts;
use super::tally::{RunLabels, Tally};
use super::{SessionError, Setup};
use crate::log::RunOutcome;
use crate::mailbox::mailbox;
use crate::rt::MonotonicClock;
use camera_thread::{CameraEnd, CameraThread, Snapshot};
use child::PolicyChild;
use control_thread::{ControlEnd, ControlThread};
use simulation_thread::{SimulationEnd, SimulationThread};

/// Chunks that may wait for the control thread.
const CHUNK_QUEUE: usize = 8;

/// Snapshots that may wait for the camera thread; a late camera skips.
const SNAPSHOT_QUEUE: usize = 1;

/// Time for every thread to be up before the first period, ns.
const START_NS: u64 = 20_000_000;

/// Flags between the threads of a run.
#[derive(Debug, Default)]
struct Signals {
    /// The task has its verdict: come to rest.
    done: AtomicBool,
    /// The control thread has ended: everybody else may.
    stopped: AtomicBool,
}

impl Signals {
    fn done(&self) -> bool {
        self.done.load(Ordering::Acquire)
    }

    fn stopped(&self) -> bool {
        self.stopped.load(Ordering::Acquire)
    }
}

/// Runs one episode in real time against the simulated arm.
///
/// # Errors
/// From the configuration, the policy, the simulation, the topics or the log.
pub fn run_realtime(setup: &Setup, options: &RunOptions) -> Result<RunResult, SessionError> {
    let child = match &options.policy {
        PolicyChoice::Checkpoint(path) => Some(PolicyChild::start(path, options)?),
        PolicyChoice::Expert | PolicyChoice::Noop | PolicyChoice::Random => None,
    };
    let source = match child {
        Some(_) => None,
        None => Some(setup.source(&options.policy, options.seed, options.device)?),
    };
    let ends = run_threads(setup, options, source, child.as_ref())?;
    if let Some(child) = child {
        child.finish()?;
    }
    conclude(setup, options, ends)
}

/// What the threads give back.
struct Ends {
    control: ControlEnd,
    simulation: SimulationEnd,
    camera: Option<CameraEnd>,
    log: Option<crate::log::LogFile>,
}

fn run_threads(
    setup: &Setup,
    options: &RunOptions,
    source: Option<ChunkSource>,
    child: Option<&PolicyChild>,
) -> Result<Ends, SessionError> {
    let simulation = Simulation::new(&setup.task, options.seed, Rendering::Off)?;
    let controller = Box::new(setup.controller()?);
    let (tick_log, side_log, log) = match open_log(setup, options, false)? {
        Some(recorder) => {
            let (ticks, side, file) = recorder.split();
            (Some(ticks), Some(side), Some(file))
        }
        None => (None, None, None),
    };
    let (measured_in, measured) = mailbox::<ArmState>();
    let (commands, commands_out) = mailbox::<ArmCommand>();
    let (chunk_in, chunks) = RingBuffer::<Chunk>::new(CHUNK_QUEUE);
    let (snapshot_in, snapshots) = RingBuffer::<Snapshot>::new(SNAPSHOT_QUEUE);
    let signals = Arc::new(Signals::default());
    let with_cameras = options.pictures || child.is_some();
    // Slow things first: opening a device takes longer than an episode's first second.
    let camera_thread = with_cameras
        .then(|| CameraThread::new(setup, child.map(PolicyChild::node), side_log, snapshots))
        .transpose()?;
    let clock = MonotonicClock::new();
    let first = clock.now().plus_ns(START_NS);
    let control_thread = ControlThread {
        controller,
        measured,
        chunks,
        commands,
        log: tick_log,
        signals: Arc::clone(&signals),
    };
    let (local, chunk_in) = match source {
        Some(source) => (Some((source, chunk_in)), None),
        None => (None, Some(chunk_in)),
    };
    let simulation_thread = SimulationThread {
        simulation,
        measured: measured_in,
        commands: commands_out,
        snapshots: with_cameras.then_some(snapshot_in),
        local,
        signals: Arc::clone(&signals),
    };
    thread::scope(|scope| {
        let control = scope.spawn(move || control_thread.run(clock, first));
        let simulated = scope.spawn(move || simulation_thread.run(clock, first));
        let camera = camera_thread.map(|camera| {
            let signals = Arc::clone(&signals);
            scope.spawn(move || camera.run(&signals))
        });
        if let (Some(child), Some(chunk_in)) = (child, chunk_in) {
            child.forward_chunks(chunk_in, &signals)?;
        }
        let simulation = joined(simulated)??;
        let control = joined(control)?;
        let camera = camera.map(joined).transpose()?.transpose()?;
        Ok(Ends {
            control,
            simulation,
            camera,
            log,
        })
    })
}

fn joined<T>(handle: thread::ScopedJoinHandle<'_, T>) -> Result<T, SessionError> {
    handle
        .join()
        .map_err(|_| SessionError::RealTime("a thread of the run has panicked".to_owned()))
}

fn conclude(setup: &Setup, options: &RunOptions, ends: Ends) -> Result<RunResult, SessionError> {
    let success = matches!(ends.simulation.outcome, Outcome::Success);
    let tally: &Tally = &ends.control.tally;
    let reason = super::episode::reason(&ends.simulation.outcome, tally.fault());
    let mut log_dropped = ends.control.log_dropped;
    if let Some(log) = ends.log {
        let outcome = RunOutcome {
            success,
            reason: reason.clone(),
            command_hash: tally.command_hash(),
        };
        let counts = log.finish(Some(&outcome))?;
        log_dropped += counts.frames_dropped + counts.events_dropped;
    }
    let labels = RunLabels {
        task: &setup.task_name,
        policy: &options.policy.name(),
        seed: options.seed,
        success,
        reason: &reason,
    };
    let real_time = RealTimeCounts {
        overruns: ends.control.skipped,
        wake_p99_us: ends.control.wake_p99_us,
        log_dropped,
    };
    let summary = tally.summary(&labels, Some(real_time));
    Ok(RunResult {
        summary,
        pictures: ends
            .camera
            .map(|camera| camera.pictures)
            .unwrap_or_default(),
    })
}
