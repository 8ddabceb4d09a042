//! A real-time run of one arm or two: the control thread on its own, its neighbours on theirs, the
//! network and the cameras in processes of their own.
//!
//! ```text
//!  simulation thread (1 kHz) ── measured ──> control thread (1 kHz, SCHED_FIFO) ── commands ──> simulation thread
//!     │ arms, scene                                          ▲ chunks      │ ticks
//!     ▼                                                      │             ▼
//!  states thread ── arms ──> policy process ── chunks ─> first thread   log thread
//!     │ scene                     ▲ frames                                 ▲ frames
//!     └────────────────> cameras' process ── frames ──────────────────> frames thread
//! ```
//!
//! Both processes are started by the run, load side by side, and are supervised alike
//! ([`Supervision`](trocar_control::Supervision)): one that dies or hangs is started again, and the
//! arms hold meanwhile if their policy needs it. Between processes there are topics alone. Where
//! nobody looks, no policy, no log, no console, there is no cameras' process. What pages of the
//! console look at is drawn there too, on topics of its own. With [`Plan::cameras_on`] nothing is
//! drawn here: frames are others', the arms are shown as they were when these were taken, and
//! cameras are watched as a robot's are. Instants on topics are the system's `CLOCK_MONOTONIC`.
//!
//! Everything that reaches the control thread comes through wait-free mailboxes and queues. What is
//! of one instant travels together: all arms' measurements, commands and chunks; only on the topics
//! has each arm its own. A command travels with its tail, which the arm plays while the control
//! thread is late; an arm that was late itself makes up for it with the commands of then. The run
//! ends with the task's verdict, with a fault of any arm, with a signal, with the policy process,
//! or with any thread: all arms then come to rest, the control thread stops, and everybody follows.

mod arm_chunks;
mod arm_states;
mod by_hand;
mod cameras;
mod cameras_child;
mod cameras_process;
mod channels;
mod checkpoint_files;
mod child;
mod child_process;
mod control_thread;
mod drivers;
mod ended;
mod frames_thread;
mod hold;
pub(super) mod observed;
mod observers;
mod opened;
mod policy_process;
mod remote_arms;
mod robot;
mod scene_topics;
mod shown;
mod signals;
mod simulation_thread;
mod supervised;
mod supervisor;
mod threads;
mod timing;
mod wall_log;
mod watch;

use std::sync::Arc;

use hal::{ArmState, Chunk, TICK_NS};
use rtrb::RingBuffer;
use trocar_tasks::simulation::{Rendering, Simulation};
use trocar_tasks::task::Outcome;

pub use cameras_process::{CamerasOptions, serve_cameras};
pub use policy_process::{PolicyProcessOptions, serve_policy};
pub use remote_arms::{
    CanOptions, PrintLine, TopicArms, run_on_can, run_on_topics, run_robot_on_can,
    run_robot_on_topics,
};
pub use robot::{RigCameras, RobotOptions, run_rig, run_rig_seeing};
pub(super) use simulation_thread::is_due;

use super::ended::Ended;
use super::operator::{Listener, OperatorPort};
use super::run::RunResult;
use super::source::ChunkSource;
use super::summary::TissueSummary;
use super::teleop::{Demonstrating, EpisodeCommand};
use super::{Plan, SessionError, episode};
use crate::mailbox::mailbox;
use crate::rig::threads::ThreadsRig;
use crate::rt::{self, MonotonicClock, Periodic};
use cameras::Stage;
use channels::ControlChannels;
use child::{Outside, PolicyChild};
use control_thread::ControlThread;
use ended::closed;
use frames_thread::FramesEnd;
use hal::PerArm;
use observers::Observers;
use opened::Opened;
use remote_arms::FRAMES_WITHIN_MS;
use shown::show_task;
use signals::{Moving, Signals};
use simulation_thread::{SimulationEnd, SimulationThread};
use threads::{Ends, wired};
use trocar_log::{LogFile, Recorder, SceneLog, SideLog, TickLog, pre_faulted_queue};

/// Chunks that may wait for the control thread.
const CHUNK_QUEUE: usize = 8;

/// Commands that may wait for the simulated arms: a second of them.
const COMMANDS: usize = 1000;

/// Time for every thread to be up before the first period, ns.
const START_NS: u64 = 20_000_000;

/// Runs one episode in real time against the simulated arms; `say` tells what is waited for. The
/// processes of policy and cameras are verbs of the program that calls this, which is to be
/// `trocar`.
///
/// SIGINT, SIGTERM and SIGHUP bring the arms to rest and end the run as failed, with the reason
/// `interrupted`; until they rest it takes three to end the process at once.
///
/// # Errors
/// From the configuration, the policy, the simulation, the topics or the log.
pub fn run_realtime(plan: &Plan, say: PrintLine<'_>) -> Result<RunResult, SessionError> {
    rt::catch_interrupts_in_motion().map_err(SessionError::signals)?;
    plan.real_time.check()?;
    let others = plan.cameras_on.as_deref().map(|topics| Outside {
        topics,
        frames_within_ms: FRAMES_WITHIN_MS,
    });
    let policy = Opened::open(plan, others.as_ref())?;
    // Each loads while the others do.
    let mut stage = Stage::open(plan, &policy)?;
    let simulation = plan.simulation(Rendering::Off)?;
    let (mut child, source) = policy.start(plan, stage.outside(plan), say)?;
    stage.wait(plan, &simulation.snapshot(), say)?;
    let (ends, log) = run_threads(plan, (simulation, stage), source, child.as_mut())?;
    conclude(plan, ends, log)
}

/// The simulation, and whoever takes the frames.
type Simulated = (SimulationEnd, FramesEnd);

fn run_threads(
    plan: &Plan,
    (simulation, stage): (Simulation, Stage),
    source: Option<ChunkSource>,
    child: Option<&mut PolicyChild>,
) -> Result<(Ends<ThreadsRig, Simulated>, Option<LogFile>), SessionError> {
    let (measured_in, measured) = mailbox::<PerArm<ArmState>>();
    let (commands, commands_out) = pre_faulted_queue(COMMANDS);
    let (chunk_in, chunks) = RingBuffer::<PerArm<Chunk>>::new(CHUNK_QUEUE);
    let (listener, mut operator) = listen(true);
    let port = (listener.as_ref(), &mut operator);
    let console = show_task(plan, &simulation.snapshot(), port)?;
    let (intervention, hands) = by_hand::intervention(plan).unzip();
    let signals = Arc::new(Signals::of(plan.console.as_ref()));
    let (observers, mut shown) = Observers::open(plan, stage, child.as_deref(), console)?;
    let (tick_log, side_log, scenes, log) = split(plan.open_log(false)?);
    shown.log = scenes;
    let clock = MonotonicClock::new();
    if let Some(console) = &plan.console {
        console.follow(clock);
    }
    let (local, remote) = wired(plan, source, child, chunk_in, clock);
    let simulation_thread = SimulationThread {
        simulation,
        measured: measured_in,
        commands: commands_out,
        shown,
        local,
        intervention,
        demonstrating: demonstrating(plan),
        signals: Arc::clone(&signals),
        profile: plan.real_time.simulation,
    };
    let control = ControlChannels {
        chunks,
        log: tick_log,
        signals: Arc::clone(&signals),
        operator,
        clock,
    };
    let control_thread = ControlThread::new(plan, control, hands)?;
    let first = clock.now().plus_ns(START_NS);
    // Half a period after the simulation, to see this period's measurement.
    let periodic = Periodic::new(clock, first.plus_ns(TICK_NS / 2), TICK_NS);
    let rig = ThreadsRig::new(measured, commands, periodic);
    let control = move || {
        let _moving = Moving;
        Ok(control_thread.run(rig))
    };
    let simulate = || observers.run(plan, simulation_thread, (clock, first), side_log, &signals);
    let ends = threads::run(
        remote,
        (&signals, listener.as_ref(), clock),
        control,
        simulate,
    );
    Ok((ends, log))
}

/// What is written down of a demonstration by hand, if that is what `plan` is of.
fn demonstrating(plan: &Plan) -> Option<Demonstrating> {
    let console = plan.console.as_ref().filter(|_| plan.demonstrates)?;
    Some(Demonstrating::new(console.hands()))
}

/// What the control thread, whoever observes and the simulation have of a log, and the log itself.
type LogEnds = (
    Option<TickLog>,
    Option<SideLog>,
    Option<SceneLog>,
    Option<LogFile>,
);

/// The ends of a log, if there is one.
fn split(recorder: Option<Recorder>) -> LogEnds {
    match recorder.map(Recorder::split) {
        Some((ticks, side, scenes, file)) => (Some(ticks), Some(side), Some(scenes), Some(file)),
        None => (None, None, None, None),
    }
}

/// The operator's socket, and the control thread's end of it;
/// [`operator::check`](super::operator::check) says beforehand why there is none.
fn listen(enables: bool) -> (Option<Listener>, OperatorPort) {
    match Listener::open(enables) {
        Ok((listener, port)) => (Some(listener), port),
        Err(_) => (None, OperatorPort::unreachable()),
    }
}

/// Closes the log, whatever happened, and sums up.
fn conclude(
    plan: &Plan,
    ends: Ends<ThreadsRig, Simulated>,
    log: Option<LogFile>,
) -> Result<RunResult, SessionError> {
    let mut control = match ends.control {
        Ok(control) => control,
        Err(error) => {
            log.map(|log| log.finish(None)).transpose()?;
            return Err(error);
        }
    };
    let (watched, seen) = (ends.watched, ends.seen);
    let others = seen.and_then(|seen| Ok((watched?, seen)));
    let ended = match &others {
        Err(error) => Ended::task(false, error.to_string(), None),
        Ok((watched, (simulation, frames))) => {
            control.tally.inferences(&watched.inference);
            control.tally.restarts(watched.restarts);
            control.tally.inferences(&simulation.inference);
            let demonstration = simulation.demonstration.as_ref();
            let wish = demonstration.and_then(|it| it.ended);
            let by_person = wish.map(|wish| wish.reason().to_owned());
            let verdict = || {
                by_person.unwrap_or_else(|| episode::reason(&simulation.outcome, &control.tally))
            };
            let success = match wish {
                Some(wish) => wish == EpisodeCommand::Keep,
                None => matches!(simulation.outcome, Outcome::Success),
            };
            let ended_by = watched.ended_by.clone().or_else(|| frames.ended_by.clone());
            Ended::task(
                success && ended_by.is_none(),
                ended_by.unwrap_or_else(verdict),
                simulation.tissue.map(TissueSummary::from),
            )
        }
    };
    let result = closed(plan, &control, &ended, (log, None));
    let (_, (simulation, frames)) = others?;
    Ok(RunResult {
        pictures: frames.pictures.unwrap_or_default(),
        demonstration: simulation.demonstration,
        ..result
    })
}
