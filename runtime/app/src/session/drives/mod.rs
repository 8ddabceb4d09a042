//! Emulated drives on real buses: seven an arm, which move the simulated arms of a task, or nothing
//! but their motors.
//!
//! ```text
//!  buses <──> bus thread (SCHED_FIFO): drives and the time that frames take, and the world every millisecond
//!                  │ snapshots, what happened
//!                  ▼
//!             first thread: scene, verdict and camera frames on topics; a line for whatever stopped a drive; the console's page
//! ```
//!
//! To whoever leads them they are nodes on a bus and nothing else. The topics are for those who
//! look at the world: scripted experts, cameras, and whoever wants to know how the task went. The
//! episode begins when all drives of all arms are enabled for the first time; before that nothing
//! is judged.
//!
//! This is the side of the drives alone. The master that leads them, in another process, is
//! `realtime::remote_arms::can` with `trocar_canopen`; the drives themselves, their state machines
//! and wires are the crate `trocar_drives`.

mod bench;
pub(super) mod bus_thread;
mod coupling;
mod inject;
mod page;
mod seen;
pub(super) mod show;
mod stalls;
mod stops;
mod summary;

use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use hal::TimeNs;
use hal::count::count_u8;
use rtrb::{Consumer, RingBuffer};
use trocar_canopen::master::CanConfig;
use trocar_tasks::simulation::{Rendering, Simulation};
use trocar_tasks::task::Outcome;

pub use inject::{BadFault, FaultKind, InjectedFault};
pub use stops::{Stop, StopCause};
pub use summary::{BusSummary, DrivesSummary, StopSummary};

use super::can_interfaces::{BusOffInjector, open};
use super::summary::PercentilesUs;
use super::{Plan, SessionError};
use crate::console::{Console, Facts};
use crate::mailbox::{MailboxReader, mailbox};
use crate::rt::{self, MonotonicClock};
use bus_thread::{BusEnd, BusThread, Notice, Shown};
use page::DrivesPage;
use seen::Seen;
use show::{Show, ShowOptions};

/// Polling period of the first thread, ns; the world is shown every 40 ms.
const POLL_NS: u64 = 5_000_000;

/// Notices that may wait to be reported.
const NOTICES_MAX: usize = 256;

/// Stops that belong together are reported together, so long after the first, ns.
const GATHER_NS: u64 = 100_000_000;

/// The topics' name unless another one is asked for.
pub const DEFAULT_TOPICS: &str = "drives";

/// What the drives move.
#[derive(Clone, Copy, Debug)]
pub enum Moved<'a> {
    /// The arms of a task, in its world.
    Task(&'a Plan),
    /// So many arms, each motor by itself: they stand in for real drives, without a scene.
    ///
    /// Without a judge, cameras or verdict.
    Arms(usize),
}

impl Moved<'_> {
    const fn arms(&self) -> usize {
        match self {
            Self::Task(plan) => plan.setup.task.arms.len(),
            Self::Arms(count) => *count,
        }
    }

    /// For errors: the task, or the option that asked for no world.
    fn name(&self) -> String {
        match self {
            Self::Task(plan) => plan.setup.robot.name.clone(),
            Self::Arms(_) => "--no-world".to_owned(),
        }
    }

    /// 0 without a world, which has nothing random.
    const fn seed(&self) -> u64 {
        match self {
            Self::Task(plan) => plan.seed,
            Self::Arms(_) => 0,
        }
    }
}

/// How to run drives.
#[derive(Clone, Debug)]
pub struct DrivesOptions {
    /// Names the topics.
    ///
    /// Other processes join under the same name; one world a name. Without a world nothing is
    /// published.
    pub topics: String,
    /// Whether the cameras that the setup keeps are drawn and published.
    ///
    /// Drawing costs the first thread time; the bus thread is not held up by it.
    pub cameras: bool,
    /// What goes wrong on purpose.
    ///
    /// Each node must be among those of the arms that run.
    pub faults: Vec<InjectedFault>,
    /// Where a page sees the drives, and their world if they have one.
    pub console: Option<Console>,
}

/// The world of `plan` and where it shows itself.
///
/// The world itself draws nothing: cameras are the show's.
///
/// # Errors
/// If the task cannot be built, the topics are taken, or there is no renderer.
fn open_world(
    plan: &Plan,
    options: &DrivesOptions,
    shown: MailboxReader<Shown>,
) -> Result<(Simulation, Show), SessionError> {
    let world = Simulation::new(&plan.setup.task, plan.seed, Rendering::Off)?;
    let to = ShowOptions {
        topics: &options.topics,
        cameras: options.cameras,
        console: options.console.as_ref(),
    };
    let show = Show::open(plan, &to, shown, &world.snapshot())?;
    Ok((world, show))
}

/// Runs the drives of the arms until a signal comes. `say` gets a line when they are there, when
/// the episode begins, for whatever stops a drive, and for the verdict.
///
/// Blocks until a signal, or until an error. The bus thread is spawned here and joined before it
/// returns; everything else happens on the calling thread.
///
/// # Errors
/// From the configuration, the buses, the simulation or the topics. [`SessionError::BadArgument`]
/// for too few arms in `can`, one node for two axes, or a fault of an unknown node;
/// [`SessionError::Interface`] for a bus that is not there or is down.
pub fn run_drives(
    moved: Moved<'_>,
    can: &CanConfig,
    options: &DrivesOptions,
    say: &mut dyn FnMut(&str),
) -> Result<DrivesSummary, SessionError> {
    let arms = moved.arms();
    if can.arms.len() < arms {
        return Err(SessionError::BadArgument(format!(
            "arm: {} arms are on CAN, {} has {arms}",
            can.arms.len(),
            moved.name()
        )));
    }
    bench::check_nodes(can, arms)?;
    check_faults(can, arms, &options.faults)?;
    rt::catch_interrupts().map_err(SessionError::signals)?;
    let names = bench::interfaces(can, arms);
    let bus = open(&names, MonotonicClock::new())?;
    let (shown_in, shown) = mailbox();
    let (notices_in, notices) = RingBuffer::new(NOTICES_MAX);
    let stop = AtomicBool::new(false);
    let world = match moved {
        Moved::Task(plan) => Some(open_world(plan, options, shown)?),
        Moved::Arms(_) => None,
    };
    let (simulation, show) = world.unzip();
    let (seen_in, seen) = mailbox();
    let page = show_page(moved, can, (options, seen), &names);
    let off = BusOffInjector::open(&names, &options.faults)?;
    let bus_thread = BusThread {
        simulation,
        can,
        arms,
        faults: &options.faults,
        bus,
        lines: count_u8(names.len()),
        shown: shown_in,
        notices: notices_in,
        seen: page.is_some().then_some(seen_in),
        stop: &stop,
    };
    let places = format!("{} on {}", nodes(can, arms), names.join(" "));
    say(&match moved {
        Moved::Task(plan) => format!(
            "{}, seed {}: {places}; scene on topics {:?}",
            plan.setup.task_name, plan.seed, options.topics
        ),
        Moved::Arms(_) => format!("no world: {places}"),
    });
    let mut teller = Teller {
        notices,
        has_world: matches!(moved, Moved::Task(_)),
        faults: &options.faults,
        off,
        stops: Vec::new(),
        fresh: Vec::new(),
        first: TimeNs(0),
        clock: MonotonicClock::new(),
    };
    let (end, shown) = thread::scope(|scope| {
        let bus = scope.spawn(move || bus_thread.run());
        let shown = attend((show, page), &mut teller, &stop, say);
        stop.store(true, Ordering::Release);
        let end = bus
            .join()
            .map_err(|_| SessionError::RealTime("the bus thread has panicked".to_owned()));
        (end.and_then(|end| end), shown)
    });
    let end = end?;
    shown?;
    teller.turn(true, say)?;
    Ok(sum_up(moved, &names, &end, &teller.stops))
}

/// What the first thread does until it is time to end.
///
/// Every 5 ms: show, notices, page. An error of the show ends the drives as well; an error of the
/// page does not.
fn attend(
    (mut show, mut page): (Option<Show>, Option<DrivesPage>),
    teller: &mut Teller<'_>,
    stop: &AtomicBool,
    say: &mut dyn FnMut(&str),
) -> Result<(), SessionError> {
    while !stop.load(Ordering::Acquire) && !rt::interrupted() {
        let mut say = |line: &str| {
            if let Some(page) = &mut page {
                page.note(line);
            }
            say(line);
        };
        if let Some(show) = &mut show {
            show.turn(&mut say)?;
        }
        teller.turn(false, &mut say)?;
        if let Some(page) = &mut page {
            page.turn();
        }
        rt::sleep_ns(POLL_NS);
    }
    Ok(())
}

/// Status of the drives for pages, if there is a console.
///
/// None without a console. Names of arms and cameras are told once; the states come with
/// [`DrivesPage::turn`].
fn show_page(
    moved: Moved<'_>,
    can: &CanConfig,
    (options, seen): (&DrivesOptions, MailboxReader<Seen>),
    interfaces: &[String],
) -> Option<DrivesPage> {
    let console = options.console.clone()?;
    let arms = moved.arms();
    let names = &hal::ARM_NAMES[..arms.min(hal::ARMS_MAX)];
    let facts = match moved {
        Moved::Task(plan) => {
            let cameras = plan.setup.camera_names();
            let title = &plan.setup.task_name;
            Facts::of_drives(title, plan.seed, names, cameras).with_scene()
        }
        Moved::Arms(_) => Facts::of_drives("drives", 0, names, Vec::new()),
    };
    console.show_drives(&facts);
    let spaces = can.arms.iter().take(arms).map(|arm| arm.plan.space);
    Some(DrivesPage::new(console, seen, spaces, interfaces.to_vec()))
}

/// A fault must be of a drive that is there.
///
/// Lists the nodes that there are.
fn check_faults(
    can: &CanConfig,
    arms: usize,
    faults: &[InjectedFault],
) -> Result<(), SessionError> {
    let all = || can.arms.iter().take(arms).flat_map(|arm| &arm.plan.axes);
    for fault in faults {
        if !all().any(|axis| axis.node == fault.node) {
            let nodes: Vec<String> = all().map(|axis| axis.node.to_string()).collect();
            return Err(SessionError::BadArgument(format!(
                "--fault {fault}: there is no such node; there are {}",
                nodes.join(" ")
            )));
        }
    }
    Ok(())
}

/// The nodes of each arm in words.
fn nodes(can: &CanConfig, arms: usize) -> String {
    let arms = can.arms.iter().take(arms).zip(hal::ARM_NAMES);
    let arms = arms.map(|(arm, name)| {
        let nodes: Vec<String> = arm.plan.axes.iter().map(|a| a.node.to_string()).collect();
        format!("{name} is nodes {}", nodes.join(" "))
    });
    arms.collect::<Vec<_>>().join(", ")
}

/// Says what the bus thread reports.
struct Teller<'a> {
    /// From the bus thread, oldest first.
    notices: Consumer<Notice>,
    has_world: bool,
    /// For the text of a fault that has begun.
    faults: &'a [InjectedFault],
    off: BusOffInjector,
    /// All that have been said, for the summary.
    stops: Vec<Stop>,
    /// Stops that have not been said yet.
    fresh: Vec<Stop>,
    /// When the first of `fresh` came; of no meaning while there is none.
    first: TimeNs,
    clock: MonotonicClock,
}

impl Teller<'_> {
    /// Says what is said at once; keeps a stop for the others of its kind.
    fn take(&mut self, notice: Notice, say: &mut dyn FnMut(&str)) -> Result<(), SessionError> {
        match notice {
            Notice::Begun(at) => {
                let begins = if self.has_world {
                    ": the episode begins"
                } else {
                    ""
                };
                let seconds = at.seconds();
                say(&format!("all drives are enabled at {seconds:.3} s{begins}"));
            }
            Notice::Injected(place) => {
                if let Some(fault) = self.faults.get(place) {
                    say(&format!("fault: {fault}"));
                }
            }
            Notice::BusOff(line) => self.off.send(line)?,
            Notice::Stopped(stop) => self.gather(stop),
        }
        Ok(())
    }

    /// All drives of an arm stop within some milliseconds: they are one line instead of seven.
    fn gather(&mut self, stop: Stop) {
        if self.fresh.is_empty() {
            self.first = self.clock.now();
        }
        self.fresh.push(stop);
    }

    /// Says what is to be said now, or all of it if this is the end.
    fn turn(&mut self, end: bool, say: &mut dyn FnMut(&str)) -> Result<(), SessionError> {
        while let Ok(notice) = self.notices.pop() {
            self.take(notice, say)?;
        }
        let due = self.clock.now().since(self.first) > GATHER_NS;
        if due || end {
            for line in stops::lines(&self.fresh) {
                say(&line);
            }
            self.stops.append(&mut self.fresh);
        }
        Ok(())
    }
}

/// `busy_share` is the mean over the whole run, 0 to 1, at the bus's bit rate.
fn bus_summaries(names: &[String], end: &BusEnd) -> Vec<BusSummary> {
    let elapsed_ns = end.now.0.max(1);
    let buses = names.iter().zip(&end.busy);
    #[expect(clippy::cast_precision_loss, reason = "a share of a run's time")]
    let buses = buses.map(|(interface, (busy_ns, frames))| BusSummary {
        interface: interface.clone(),
        frames: *frames,
        busy_share: *busy_ns as f64 / elapsed_ns as f64,
    });
    buses.collect()
}

/// Success is none without a world, and false for an episode that never began.
fn sum_up(moved: Moved<'_>, names: &[String], end: &BusEnd, stops: &[Stop]) -> DrivesSummary {
    let outcome = end.world.as_ref().map(|world| world.outcome);
    let task = match moved {
        Moved::Task(plan) => Some(plan.setup.task_name.clone()),
        Moved::Arms(_) => None,
    };
    DrivesSummary {
        task,
        seed: moved.seed(),
        arms: moved.arms(),
        seconds: end.now.seconds(),
        stalled_s: TimeNs(end.stalled_ns).seconds(),
        turn_us: PercentilesUs::of(&end.turns),
        begun_s: end.begun.map(TimeNs::seconds),
        success: outcome.map(|outcome| matches!(outcome, Some(Outcome::Success))),
        outcome: outcome.map(|outcome| match outcome {
            None => "not begun".to_owned(),
            Some(outcome) => outcome.to_string(),
        }),
        buses: bus_summaries(names, end),
        frames_lost: end.lost,
        stops: stops.iter().map(StopSummary::from).collect(),
    }
}

#[cfg(test)]
mod tests;
