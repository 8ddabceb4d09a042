//! A real-time run of one arm or two: the control thread on its own, its neighbours on theirs, the network in its own process.
//!
//! ```text
//!  simulation thread (1 kHz) ── measured ──> control thread (1 kHz, SCHED_FIFO) ── commands ──> simulation thread
//!         │ snapshots                              ▲ chunks            │ ticks
//!         ▼                                        │                   ▼
//!   camera thread ── frames, arm ──> policy process ── chunks ──> first thread      log thread
//! ```
//!
//! Everything that reaches the control thread comes through wait-free mailboxes and queues. What is of one instant travels
//! together: all arms' measurements, commands and chunks; only on the topics has each arm its own. A command travels with its
//! tail, which the arm plays while the control thread is late; an arm that was late itself makes up for it with the commands
//! of then. The run ends with the task's verdict, with a fault of any arm, with a signal, with the policy process, or with any
//! thread: all arms then come to rest, the control thread stops, and everybody follows.

mod arm_chunks;
mod camera_thread;
mod child;
mod control_thread;
mod ended;
mod on_can;
mod policy_process;
mod robot;
mod shown;
mod signals;
mod simulation_thread;
mod watch;
mod wires;

use std::sync::Arc;
use std::thread;

use hal::{ArmState, Chunk, TICK_NS};
use rtrb::RingBuffer;
use tch::Device;
use trocar_tasks::simulation::Rendering;
use trocar_tasks::task::Outcome;

pub use on_can::{CanOptions, Say, run_on_can, run_robot_on_can};
pub use policy_process::{PolicyProcessOptions, serve_policy};
pub use robot::{RobotOptions, run_rig};

use super::external::{About, ExternalLink, check_wanted};
use super::operator::{Listener, OperatorPort};
use super::run::{RunOptions, RunResult, open_log, simulation};
use super::source::{ChunkSource, PolicyChoice};
use super::summary::{RealTimeCounts, TissueSummary};
use super::tally::{RunLabels, Tally};
use super::{SessionError, Setup};
use crate::mailbox::mailbox;
use crate::rig::threads::ThreadsRig;
use crate::rt::{self, MonotonicClock, Periodic};
use camera_thread::{CameraEnd, CameraThread, Snapshot};
use child::{PolicyChild, check_cameras};
use control_thread::{ControlEnd, ControlThread};
use hal::PerArm;
use on_can::wired;
use shown::show_task;
use signals::{Moving, Signals};
use simulation_thread::{SimulationEnd, SimulationThread, Snapshots};
use trocar_log::{LogFile, Recorder, RunOutcome, SideLog, TickLog};
use watch::{Watched, watch};

/// Chunks that may wait for the control thread.
const CHUNK_QUEUE: usize = 8;

/// Commands that may wait for the simulated arms: a second of them.
const COMMANDS: usize = 1000;

/// Time for every thread to be up before the first period, ns.
const START_NS: u64 = 20_000_000;

/// Runs one episode in real time against the simulated arms.
///
/// SIGINT, SIGTERM and SIGHUP bring the arms to rest and end the run as failed, with the reason `interrupted`; until they rest it takes three
/// to end the process at once.
///
/// # Errors
/// From the configuration, the policy, the simulation, the topics or the log.
pub fn run_realtime(setup: &Setup, options: &RunOptions) -> Result<RunResult, SessionError> {
    rt::catch_interrupts_in_motion()
        .map_err(|error| SessionError::RealTime(format!("catching signals failed: {error}")))?;
    let mut child = match &options.policy {
        PolicyChoice::Checkpoint(path) => {
            let network = setup.network(path, Device::Cpu)?;
            check_cameras(setup, &network)?;
            Some(PolicyChild::start(&network, path, options, None, &|_| ())?)
        }
        PolicyChoice::External(choice) => {
            let about = About {
                task: &setup.task_name,
                arms: setup.task.arms.len(),
                lockstep: false,
                frames_within_ms: 0,
            };
            let link = ExternalLink::open(choice.topics(), choice.within_s, &about)?;
            check_wanted(setup, &link.cameras)?;
            let (arms, seed) = (about.arms, options.seed);
            Some(PolicyChild::external(link, arms, seed, None, &|_| ())?)
        }
        PolicyChoice::Expert | PolicyChoice::Noop | PolicyChoice::Random | PolicyChoice::Own(_) => {
            None
        }
    };
    let source = match child {
        Some(_) => None,
        None => Some(setup.source(&options.policy, options.seed, options.compute)?),
    };
    let ends = run_threads(setup, options, source, child.as_mut())?;
    conclude(setup, options, ends)
}

/// What the threads give back.
struct Ends {
    control: Result<ControlEnd<ThreadsRig>, SessionError>,
    others: Result<Others, SessionError>,
    log: Option<LogFile>,
}

struct Others {
    watched: Watched,
    simulation: SimulationEnd,
    camera: Option<CameraEnd>,
}

fn run_threads(
    setup: &Setup,
    options: &RunOptions,
    source: Option<ChunkSource>,
    child: Option<&mut PolicyChild>,
) -> Result<Ends, SessionError> {
    let simulation = simulation(setup, options, Rendering::Off)?;
    let controller = setup.controller()?;
    let (measured_in, measured) = mailbox::<PerArm<ArmState>>();
    let (commands, commands_out) = RingBuffer::new(COMMANDS);
    let (chunk_in, chunks) = RingBuffer::<PerArm<Chunk>>::new(CHUNK_QUEUE);
    let (snapshot_in, snapshots) = mailbox::<Snapshot>();
    let (listener, mut operator) = listen(true);
    let port = (listener.as_ref(), &mut operator);
    let (console_view, console_cameras) = show_task(setup, options, port).unzip();
    let signals = Arc::new(Signals::default());
    // Slow things first: opening a device takes longer than an episode's first second.
    let camera_thread = (options.wants_frames() || child.is_some() || console_cameras.is_some())
        .then(|| {
            let node = child.as_deref().map(PolicyChild::node);
            let start = simulation.snapshot();
            let seen = child.as_deref().map_or_else(Vec::new, PolicyChild::cameras);
            let snapshots = (snapshots, console_cameras);
            CameraThread::new(setup, options, &seen, node, snapshots, &start)
        })
        .transpose()?;
    let (tick_log, side_log, log) = split(open_log(setup, options, false)?);
    let snapshots = camera_thread.as_ref().map(|_| Snapshots {
        to: snapshot_in,
        query_every_steps: child.as_deref().map(PolicyChild::query_every_steps),
        history_steps: child.as_deref().map_or(0, PolicyChild::history_steps),
        frames: options.wants_frames(),
        console: console_view,
    });
    let (local, remote) = wired(source, child, chunk_in);
    let simulation_thread = SimulationThread {
        simulation,
        measured: measured_in,
        commands: commands_out,
        snapshots,
        local,
        signals: Arc::clone(&signals),
    };
    let clock = MonotonicClock::new();
    let first = clock.now().plus_ns(START_NS);
    // Half a period after the simulation, to see this period's measurement.
    let periodic = Periodic::new(clock, first.plus_ns(TICK_NS / 2), TICK_NS);
    let control_thread = ControlThread {
        controller,
        rig: ThreadsRig::new(measured, commands, periodic),
        chunks,
        log: tick_log,
        signals: Arc::clone(&signals),
        operator,
    };
    thread::scope(|scope| {
        if let Some(listener) = &listener {
            scope.spawn(|| listener.serve(scope, &*signals));
        }
        let control = scope.spawn(move || {
            let _moving = Moving;
            control_thread.run(clock)
        });
        let simulated = scope.spawn(move || simulation_thread.run(clock, first));
        let camera = camera_thread.map(|camera| {
            let signals = Arc::clone(&signals);
            scope.spawn(move || camera.run(side_log, &signals))
        });
        let watched = watch(remote, &signals);
        let control = joined(control);
        let simulation = joined(simulated).and_then(|end| end);
        let camera = camera.map(|camera| joined(camera).and_then(|end| end));
        Ok(Ends {
            control,
            others: others(watched, simulation, camera),
            log,
        })
    })
}

/// The ends of a log, if there is one.
fn split(recorder: Option<Recorder>) -> (Option<TickLog>, Option<SideLog>, Option<LogFile>) {
    match recorder.map(Recorder::split) {
        Some((ticks, side, file)) => (Some(ticks), Some(side), Some(file)),
        None => (None, None, None),
    }
}

/// The operator's socket, and the control thread's end of it; [`operator::check`](super::operator::check) says beforehand why there is none.
fn listen(enables: bool) -> (Option<Listener>, OperatorPort) {
    match Listener::open(enables) {
        Ok((listener, port)) => (Some(listener), port),
        Err(_) => (None, OperatorPort::unreachable()),
    }
}

fn others(
    watched: Result<Watched, SessionError>,
    simulation: Result<SimulationEnd, SessionError>,
    camera: Option<Result<CameraEnd, SessionError>>,
) -> Result<Others, SessionError> {
    Ok(Others {
        simulation: simulation?,
        camera: camera.transpose()?,
        watched: watched?,
    })
}

fn joined<T>(handle: thread::ScopedJoinHandle<'_, T>) -> Result<T, SessionError> {
    handle
        .join()
        .map_err(|_| SessionError::RealTime("a thread of the run has panicked".to_owned()))
}

/// Why the run ended, and whether that is a success.
fn verdict(others: &Result<Others, SessionError>, tally: &Tally) -> (bool, String) {
    match others {
        Err(error) => (false, error.to_string()),
        Ok(Others {
            watched,
            simulation,
            ..
        }) => match &watched.ended_by {
            Some(reason) => (false, reason.clone()),
            None => (
                matches!(simulation.outcome, Outcome::Success),
                super::episode::reason(&simulation.outcome, tally),
            ),
        },
    }
}

/// Closes the log, whatever happened, and sums up.
fn conclude(setup: &Setup, options: &RunOptions, ends: Ends) -> Result<RunResult, SessionError> {
    let control = match ends.control {
        Ok(control) => control,
        Err(error) => {
            ends.log.map(|log| log.finish(None)).transpose()?;
            return Err(error);
        }
    };
    let mut tally = control.tally;
    let (success, reason) = verdict(&ends.others, &tally);
    let mut log_dropped = control.log_dropped;
    let mut log_failure = None;
    if let Some(log) = ends.log {
        let outcome = RunOutcome {
            success: Some(success),
            reason: reason.clone(),
            command_hash: tally.command_hash(),
        };
        match log.finish(Some(&outcome)) {
            Ok(counts) => log_dropped += counts.frames_dropped + counts.events_dropped,
            Err(error) => log_failure = Some(error),
        }
    }
    let others = ends.others?;
    tally.inferences(&others.watched.inference);
    tally.inferences(&others.simulation.inference);
    let policy = options.policy.name();
    let labels = RunLabels {
        success: Some(success),
        reason: &reason,
        tissue: others.simulation.tissue.map(TissueSummary::from),
        ..labels(setup, options, &policy)
    };
    let real_time = RealTimeCounts {
        overruns: control.skipped,
        wake_p99_us: control.wake_p99_us,
        log_dropped,
        slow_motion: rt::slow_motion(),
    };
    Ok(RunResult {
        ok: success,
        summary: tally.summary(&labels, Some(real_time)),
        pictures: others
            .camera
            .and_then(|camera| camera.pictures)
            .unwrap_or_default(),
        log_failure,
    })
}

/// What a run is called, before anything is known of how it went.
fn labels<'a>(setup: &'a Setup, options: &RunOptions, policy: &'a str) -> RunLabels<'a> {
    RunLabels {
        task: &setup.task_name,
        view: setup.task.view.name(),
        needle: setup.task.needle(),
        scene: setup.scene_file.as_deref(),
        policy,
        trained_on: setup.trained_on.as_deref(),
        weights_sha256: setup.weights_sha256.as_deref(),
        seed: options.seed,
        ..RunLabels::default()
    }
}
