//! Simulated arms with their world and its cameras in a process of their own, commanded over topics
//! (`trocar simulator`): what a run with [`Backend::Topics`](super::plan::Backend::Topics) has
//! behind its controller.
//!
//! ```text
//!  run ── set-points ──> arms thread (1 kHz): drives, world, judge ── feedback ──> run
//!                            │ snapshots
//!                            ▼
//!                        first thread: scene, verdict and camera frames on topics; the console's page
//! ```
//!
//! The episode begins with the first set-points that enable all arms; before that nothing is
//! judged. Arms that get no more set-points stop as the last ones said, and hold; the episode goes
//! on.

use std::collections::VecDeque;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;

use hal::{ARM_NAMES, Arm as _, TICK_NS, TimeNs};
use serde::Serialize;
use trocar_tasks::simulation::{Rendering, Simulation};
use trocar_tasks::task::Outcome;
use trocar_topics::{
    ArmFeedback, ArmFeedbackTopic, ArmSetpoint, ArmSetpointTopic, Message as _, Publisher,
    SETPOINT_AGE_NS_MAX, Subscriber, TopicError, TopicNode, arms_of,
};

use super::drives::bus_thread::{EndsAll, Shown};
use super::drives::show::{Show, ShowOptions};
use super::realtime::is_due;
use super::source::STEP_TICKS;
use super::summary::PercentilesUs;
use super::world_report::WorldState;
use super::{Plan, SessionError};
use crate::console::{Console, Facts};
use crate::histogram::Histogram;
use crate::mailbox::{MailboxWriter, mailbox};
use crate::rt::{self, MonotonicClock, Periodic, configure_thread};

/// Polling period of the first thread, ns; the world is shown every 40 ms.
const POLL_NS: u64 = 5_000_000;

/// How many missed periods are made up for.
const MADE_UP_MAX: u64 = 50;

/// Time for the thread to be up before its first period, ns.
const START_NS: u64 = 20_000_000;

/// Where the arms and their world show themselves.
#[derive(Clone, Debug)]
pub struct SimulatorOptions {
    /// Names the topics.
    pub topics: String,
    /// Whether the cameras that the setup keeps are drawn and published.
    pub cameras: bool,
    /// Where a page sees the world.
    pub console: Option<Console>,
}

/// What a simulator reports at its end, in the form that scripts rely on.
#[derive(Clone, Debug, Serialize)]
pub struct SimulatorSummary {
    /// The task.
    pub task: String,
    /// The seed of its scene.
    pub seed: u64,
    /// How many arms there are.
    pub arms: usize,
    /// How long it ran, s.
    pub seconds: f64,
    /// When the episode began, s; none if nobody enabled the arms.
    pub begun_s: Option<f64>,
    /// Whether the task was done.
    pub success: bool,
    /// How the episode ended, in words.
    pub outcome: String,
    /// Whole periods that the arms were late for.
    pub periods_late: u64,
    /// How long a period of arms and world took, us.
    pub period_us: PercentilesUs,
}

/// Runs the arms of `plan` until a signal comes. `say` gets a line when they are there, when the
/// episode begins, and for the verdict.
///
/// # Errors
/// From the configuration, the simulation or the topics.
pub fn run_simulator(
    plan: &Plan,
    options: &SimulatorOptions,
    say: &mut dyn FnMut(&str),
) -> Result<SimulatorSummary, SessionError> {
    rt::catch_interrupts().map_err(SessionError::signals)?;
    let simulation = plan.simulation(Rendering::Off)?;
    let (shown_in, shown) = mailbox();
    let to = ShowOptions {
        topics: &options.topics,
        cameras: options.cameras,
        console: options.console.as_ref(),
    };
    let mut show = Show::open(plan, &to, shown, &simulation.snapshot())?;
    let arms = simulation.arm_count();
    show_page(plan, options, arms);
    let (stop, begun) = (AtomicBool::new(false), AtomicBool::new(false));
    let arms_thread = ArmsThread::open(plan, &options.topics, simulation, shown_in)?;
    say(&format!(
        "{}, seed {}: {} on topics {:?}",
        plan.setup.task_name,
        plan.seed,
        ARM_NAMES[..arms.min(ARM_NAMES.len())].join(" "),
        options.topics
    ));
    let (end, attended) = thread::scope(|scope| {
        let running = scope.spawn(|| arms_thread.run(&stop, &begun));
        let attended = attend(&mut show, (&stop, &begun), say);
        stop.store(true, Ordering::Release);
        let end = running
            .join()
            .map_err(|_| SessionError::RealTime("the arms' thread has panicked".to_owned()));
        (end.and_then(|end| end), attended)
    });
    let end = end?;
    attended?;
    Ok(sum_up(plan, arms, &end))
}

/// What the first thread does until it is time to end.
fn attend(
    show: &mut Show,
    (stop, begun): (&AtomicBool, &AtomicBool),
    say: &mut dyn FnMut(&str),
) -> Result<(), SessionError> {
    let mut said = false;
    while !stop.load(Ordering::Acquire) && !rt::interrupted() {
        if !said && begun.load(Ordering::Acquire) {
            said = true;
            say("the arms are enabled: the episode begins");
        }
        show.turn(say)?;
        rt::sleep_ns(POLL_NS);
    }
    Ok(())
}

/// Shows pages what they may look at, if there is a console.
fn show_page(plan: &Plan, options: &SimulatorOptions, arms: usize) {
    if let Some(console) = &options.console {
        let names = &ARM_NAMES[..arms.min(ARM_NAMES.len())];
        let cameras = plan.setup.camera_names();
        let facts = Facts::of_drives(&plan.setup.task_name, plan.seed, names, cameras);
        console.show_drives(&facts.with_scene());
    }
}

fn sum_up(plan: &Plan, arms: usize, end: &ArmsEnd) -> SimulatorSummary {
    let begun = end.begun.is_some();
    SimulatorSummary {
        task: plan.setup.task_name.clone(),
        seed: plan.seed,
        arms,
        seconds: end.seconds,
        begun_s: end.begun.map(TimeNs::seconds),
        success: begun && matches!(end.outcome, Outcome::Success),
        outcome: if begun {
            end.outcome.to_string()
        } else {
            "not begun".to_owned()
        },
        periods_late: end.late,
        period_us: PercentilesUs::of(&end.periods),
    }
}

/// One arm's topics, and what has come on them.
struct ArmPorts {
    feedback: Publisher<ArmFeedback>,
    setpoints: Subscriber<ArmSetpoint>,
    /// For periods that are still to come, oldest first.
    waiting: VecDeque<ArmSetpoint>,
    /// Whether it has ever been enabled.
    enabled: bool,
}

impl ArmPorts {
    fn open(node: &TopicNode, name: &str) -> Result<Self, SessionError> {
        let feedback = ArmFeedbackTopic::publisher(node, name).map_err(|error| {
            if matches!(error, TopicError::AlreadyPublished { .. }) {
                return SessionError::BadArgument(format!(
                    "--topics: another process leads {name} there ({error})"
                ));
            }
            SessionError::Topic(error)
        })?;
        Ok(Self {
            feedback,
            setpoints: ArmSetpointTopic::subscriber(node, name)?,
            waiting: VecDeque::with_capacity(ArmSetpoint::UNREAD),
            enabled: false,
        })
    }

    /// The newest set-point that is for the period at `now`, which is `late` periods behind: one
    /// that makes up for a missed period follows no set-point from after it, and none that a
    /// controller of the past has left.
    fn due(&mut self, late: u64, now: TimeNs) -> Result<Option<ArmSetpoint>, SessionError> {
        while let Some(setpoint) = self.setpoints.next_unread()? {
            self.waiting.push_back(setpoint);
        }
        let mut newest = None;
        while let Some(first) = self.waiting.front()
            && is_due(first.stamp, late, now)
        {
            newest = self.waiting.pop_front();
        }
        Ok(newest.filter(|it| now.since(it.stamp) <= SETPOINT_AGE_NS_MAX))
    }
}

/// The thread before it runs.
struct ArmsThread<'a> {
    plan: &'a Plan,
    /// The arms' place among the topics.
    _node: TopicNode,
    ports: Vec<ArmPorts>,
    simulation: Simulation,
    shown: MailboxWriter<Shown>,
    sequence: u64,
}

/// What it leaves behind.
struct ArmsEnd {
    seconds: f64,
    begun: Option<TimeNs>,
    outcome: Outcome,
    late: u64,
    periods: Histogram,
}

impl<'a> ArmsThread<'a> {
    fn open(
        plan: &'a Plan,
        topics: &str,
        simulation: Simulation,
        shown: MailboxWriter<Shown>,
    ) -> Result<Self, SessionError> {
        let node = TopicNode::join(&arms_of(topics))?;
        let names = ARM_NAMES.iter().take(simulation.arm_count());
        let ports = names.map(|name| ArmPorts::open(&node, name));
        Ok(Self {
            plan,
            ports: ports.collect::<Result<_, _>>()?,
            _node: node,
            simulation,
            shown,
            sequence: 0,
        })
    }

    /// Runs until it is told to stop; its own end stops the others.
    fn run(mut self, stop: &AtomicBool, begun: &AtomicBool) -> Result<ArmsEnd, SessionError> {
        let _ends = EndsAll(stop);
        // Never strict: without it the arms are only less punctual.
        let _granted = configure_thread(&self.plan.real_time.simulation);
        let clock = MonotonicClock::new();
        let mut periodic = Periodic::new(clock, clock.now().plus_ns(START_NS), TICK_NS);
        let (mut late_periods, mut periods, mut began) = (0, Histogram::new(), None);
        while !stop.load(Ordering::Acquire) {
            let wake = periodic.wait();
            let work = MonotonicClock::new();
            // What it was kept from for longer does not pass for the arms: their controller has
            // given them up.
            for late in (0..=wake.skipped.min(MADE_UP_MAX)).rev() {
                if stop.load(Ordering::Acquire) || rt::interrupted() {
                    break;
                }
                let now = TimeNs(wake.due.0.saturating_sub(late * TICK_NS));
                self.period((now, clock), late, began.is_some())?;
                if began.is_none() && self.ports.iter().all(|arm| arm.enabled) {
                    began = Some(now);
                    begun.store(true, Ordering::Release);
                }
                let tick = wake.index.saturating_sub(late);
                if tick.is_multiple_of(STEP_TICKS) {
                    self.show(clock.to_system(now), tick / STEP_TICKS, began.is_some());
                }
            }
            late_periods += wake.skipped;
            periods.record(work.now().0);
        }
        Ok(ArmsEnd {
            seconds: clock.now().seconds(),
            begun: began,
            outcome: self.simulation.outcome(),
            late: late_periods,
            periods,
        })
    }

    /// A period of arms and world, which is `late` periods behind, in an episode that has `begun`.
    fn period(
        &mut self,
        (now, clock): (TimeNs, MonotonicClock),
        late: u64,
        begun: bool,
    ) -> Result<(), SessionError> {
        let now = clock.to_system(now);
        for (index, ports) in self.ports.iter_mut().enumerate() {
            if let Some(setpoint) = ports.due(late, now)?
                && let Some(mut arm) = self.simulation.arm(index)
            {
                let (command, tail) = (setpoint.command(), setpoint.tail());
                ports.enabled |= command.enabled && command.is_finite() && tail.is_finite();
                arm.write(&command, &tail)?;
            }
        }
        if begun {
            self.simulation.step();
        } else {
            self.simulation.wait();
        }
        self.sequence += 1;
        for (index, ports) in self.ports.iter().enumerate() {
            if let Some(mut arm) = self.simulation.arm(index) {
                let state = arm.read(now)?;
                ports
                    .feedback
                    .publish(&ArmFeedback::new(self.sequence, &state))?;
            }
        }
        Ok(())
    }

    /// Hands the instant to whoever shows the world.
    fn show(&mut self, stamp: TimeNs, sequence: u64, begun: bool) {
        let simulation = &self.simulation;
        self.shown.put(Shown {
            stamp,
            sequence,
            // Whoever sends set-points leads these arms: there is nothing to wait for.
            world: WorldState::of(simulation, true, begun),
            snapshot: simulation.snapshot(),
        });
    }
}
