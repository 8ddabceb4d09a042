//! A real-time run of one arm or two: the control thread on its own, its neighbours on theirs, the network in its own process.
//!
//! ```text
//!  simulation thread (1 kHz) ── measured ──> control thread (1 kHz, SCHED_FIFO) ── commands ──> simulation thread
//!     │ scene         │ arms                                 ▲ chunks      │ ticks
//!     ▼               ▼                                      │             ▼
//!  camera thread   states thread                       first thread     log thread
//!     └─ frames ──────┴─ arms ──> policy process ── chunks ──┘
//! ```
//!
//! Everything that reaches the control thread comes through wait-free mailboxes and queues. What is of one instant travels
//! together: all arms' measurements, commands and chunks; only on the topics has each arm its own. A command travels with its
//! tail, which the arm plays while the control thread is late; an arm that was late itself makes up for it with the commands
//! of then. The run ends with the task's verdict, with a fault of any arm, with a signal, with the policy process, or with any
//! thread: all arms then come to rest, the control thread stops, and everybody follows.

mod arm_chunks;
mod arm_states;
mod camera_thread;
mod child;
mod control_thread;
mod drivers;
mod ended;
mod hold;
pub(super) mod observed;
mod observers;
mod on_can;
mod opened;
mod own_process;
mod policy_process;
mod robot;
mod shown;
mod signals;
mod simulation_thread;
mod supervised;
mod threads;
mod timing;
mod watch;
mod wires;

use std::sync::Arc;

use hal::{ArmState, Chunk, TICK_NS};
use rtrb::{Consumer, RingBuffer};
use trocar_tasks::simulation::Rendering;
use trocar_tasks::task::Outcome;

pub use on_can::{CanOptions, Say, run_on_can, run_robot_on_can};
pub use policy_process::{PolicyProcessOptions, serve_policy};
pub use robot::{RobotOptions, run_rig};

use super::PolicyChoice;
use super::ended::Ended;
use super::operator::{Listener, OperatorPort};
use super::run::RunResult;
use super::source::ChunkSource;
use super::summary::TissueSummary;
use super::teleop::{Demonstrating, FromHands, Intervention, Wish};
use super::{Plan, SessionError, episode};
use crate::mailbox::mailbox;
use crate::rig::threads::ThreadsRig;
use crate::rt::{self, MonotonicClock, Periodic};
use camera_thread::CameraEnd;
use child::PolicyChild;
use control_thread::ControlThread;
use drivers::Drivers;
use ended::closed;
use hal::PerArm;
use observers::Observers;
use opened::Opened;
use shown::show_task;
use signals::{Moving, Signals};
use simulation_thread::{SimulationEnd, SimulationThread};
use threads::{Ends, wired};
use trocar_log::{LogFile, Recorder, SideLog, TickLog, pre_faulted_queue};

/// Chunks that may wait for the control thread.
const CHUNK_QUEUE: usize = 8;

/// Commands that may wait for the simulated arms: a second of them.
const COMMANDS: usize = 1000;

/// Time for every thread to be up before the first period, ns.
const START_NS: u64 = 20_000_000;

/// Runs one episode in real time against the simulated arms; `say` tells what is waited for.
///
/// SIGINT, SIGTERM and SIGHUP bring the arms to rest and end the run as failed, with the reason `interrupted`; until they rest it takes three
/// to end the process at once.
///
/// # Errors
/// From the configuration, the policy, the simulation, the topics or the log.
pub fn run_realtime(plan: &Plan, say: Say<'_>) -> Result<RunResult, SessionError> {
    rt::catch_interrupts_in_motion().map_err(SessionError::signals)?;
    plan.real_time.check()?;
    let (mut child, source) = Opened::open(plan, None)?.start(plan, None, say)?;
    let (ends, log) = run_threads(plan, source, child.as_mut())?;
    conclude(plan, ends, log)
}

/// The simulation and, if there are any, the cameras.
type Simulated = (SimulationEnd, Option<CameraEnd>);

fn run_threads(
    plan: &Plan,
    source: Option<ChunkSource>,
    child: Option<&mut PolicyChild>,
) -> Result<(Ends<ThreadsRig, Simulated>, Option<LogFile>), SessionError> {
    let simulation = plan.simulation(Rendering::Off)?;
    let controller = plan.setup.controller()?;
    let (measured_in, measured) = mailbox::<PerArm<ArmState>>();
    let (commands, commands_out) = pre_faulted_queue(COMMANDS);
    let (chunk_in, chunks) = RingBuffer::<PerArm<Chunk>>::new(CHUNK_QUEUE);
    let (listener, mut operator) = listen(true);
    let port = (listener.as_ref(), &mut operator);
    let console = show_task(plan, &simulation.snapshot(), port)?.unzip();
    let (intervention, hands) = intervention(plan).unzip();
    let signals = Arc::new(Signals::of(plan.console.as_ref()));
    // Slow things first: opening a device takes longer than an episode's first second.
    let start = simulation.snapshot();
    let (observers, shown) = Observers::open(plan, child.as_deref(), console, &start)?;
    let (tick_log, side_log, log) = split(plan.open_log(false)?);
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
    let held = plan.real_time.hold()?;
    let first = clock.now().plus_ns(START_NS);
    // Half a period after the simulation, to see this period's measurement.
    let periodic = Periodic::new(clock, first.plus_ns(TICK_NS / 2), TICK_NS);
    let control_thread = ControlThread {
        controller,
        rig: ThreadsRig::new(measured, commands, periodic),
        drivers: Drivers::new(chunks, hands),
        log: tick_log,
        signals: Arc::clone(&signals),
        operator,
        profile: plan.real_time.control,
        fault_ends_run: plan.setup.robot.control.fault_ends_run,
        overruns_max: plan.real_time.overruns_per_s_max,
        held,
    };
    let control = move || {
        let _moving = Moving;
        Ok(control_thread.run(clock))
    };
    let simulate = || observers.run(simulation_thread, (clock, first), side_log, &signals);
    let ends = threads::run(remote, (&signals, listener.as_ref()), control, simulate);
    Ok((ends, log))
}

/// What is written down of a demonstration by hand, if that is what `plan` is of.
fn demonstrating(plan: &Plan) -> Option<Demonstrating> {
    let console = plan.console.as_ref().filter(|_| plan.demonstrates)?;
    Some(Demonstrating::new(console.hands()))
}

/// An operator who may take over from the policy of `plan`: on the console, if there is one. And the control thread's end.
fn intervention(plan: &Plan) -> Option<(Intervention, Consumer<FromHands>)> {
    let by_hand = plan.policy == PolicyChoice::Teleop;
    let console = plan.console.as_ref();
    let console = console.filter(|console| console.has_page() && !by_hand)?;
    let (to, from) = RingBuffer::new(CHUNK_QUEUE);
    let hands = console.hands();
    let intervention = Intervention::new(&plan.setup, &hands, plan.demonstrates, to);
    Some((intervention, from))
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
        Ok((watched, (simulation, _))) => {
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
                Some(wish) => wish == Wish::Keep,
                None => matches!(simulation.outcome, Outcome::Success),
            };
            Ended::task(
                success && watched.ended_by.is_none(),
                watched.ended_by.clone().unwrap_or_else(verdict),
                simulation.tissue.map(TissueSummary::from),
            )
        }
    };
    let result = closed(plan, &control, &ended, log);
    let (_, (simulation, camera)) = others?;
    let pictures = camera.and_then(|camera| camera.pictures);
    Ok(RunResult {
        pictures: pictures.unwrap_or_default(),
        demonstration: simulation.demonstration,
        ..result
    })
}
