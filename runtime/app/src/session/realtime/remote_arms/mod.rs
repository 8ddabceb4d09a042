//! A real-time run of arms outside of this process: the same controller, with drives on CAN or
//! whoever is on the topics as its arms.
//!
//! ```text
//!  arms <── set-points, measurements ──> control thread (1 kHz, SCHED_FIFO) ── ticks ──> log thread
//!                                            ▲ chunks       │ measured, faults
//!                                            │              ▼
//!  topics ── frames; scene, verdict ──> observing thread ── arm ──> policy process ── chunks ──> first thread
//!      └── frames ────────────────────────────────────────────────────▲
//! ```
//!
//! Of a task, the world is in another process (`trocar drives`, `trocar simulator`), which shows
//! its scene and its verdict: [`run_on_can`], [`run_on_topics`]. A robot has none:
//! [`run_robot_on_can`] and [`run_robot_on_topics`] need limits, arms and, if its policy looks at
//! some, cameras on topics, whoever publishes them. The observing thread also hands what comes to
//! the pages of a console.
//!
//! What is waited for before the arms get torque is named on the terminal, and not for ever. How
//! they are reached is an [`ArmLink`]: [`can`] or [`topics`]. A fault of any ends the run; nothing
//! enables them again but a new run.

mod awaited;
mod bring_up;
mod bus_log;
mod can;
mod conclude;
mod happened;
mod options;
mod scene_thread;
mod summary;
mod topics;

use std::sync::Arc;

use hal::{ARM_NAMES, ArmState, PerArm, Rig};
use trocar_topics::{ArmReport, Publisher, SceneReport, SceneTopic, Subscriber, TopicNode};

use super::by_hand::ByHand;
use super::channels::{Local, ObserverChannels, ThreadChannels};
use super::child::Outside;
use super::control_thread::{ControlEnd, ControlThread};
use super::opened::Opened;
use super::robot::{RobotOptions, RobotThread, check_faults};
use super::scene_topics::WorldTopics;
use super::shown::{RigPages, show_rig, show_world};
use super::signals::{Moving, Signals, StopsAll};
use super::threads::{self, wired};
use crate::mailbox::MailboxWriter;
use crate::rig::ObservedRig;
use crate::rig::can::Noticed;
use crate::rt::{self, MonotonicClock};
use crate::session::plan::Arms;
use crate::session::run::RunResult;
use crate::session::summary::CanSummary;
use crate::session::{Plan, Robot, SessionError};
use awaited::uninterrupted;
use bring_up::check_world;
use conclude::{Seen, conclude};
use scene_thread::{SceneThread, frames};

pub use awaited::PrintLine;
pub(super) use awaited::{AHEAD_NS_MAX, Camera, FRAME_NS_MAX, PATIENCE_NS, cameras};
pub(super) use bus_log::BusLog;
pub(super) use happened::CanEventLog;
pub use options::CanOptions;
pub(super) use scene_thread::{arm_reports, logged, seen_at};
pub use topics::TopicArms;

/// How far a frame may be from the instant of an observation where cameras have clocks of their
/// own, ms: a policy step.
pub(super) const FRAMES_WITHIN_MS: u64 = 40;

/// How a run reaches arms outside of its process.
pub(super) trait ArmLink: Sync {
    /// The way to the arms, before their first measurement.
    type Opened;
    /// The arms, of which it is known where they are, without torque.
    type Ready: Send;
    /// The arms as the control thread has them.
    type Rig: Rig + Send;

    /// Names the topics of the world, or of the cameras.
    fn topics(&self) -> &str;

    /// The program that leads simulated arms which are reached so.
    fn host(&self) -> &'static str;

    /// Opens the way to the arms of `robot`, after what can be known to be wrong without it.
    ///
    /// # Errors
    /// [`SessionError`].
    fn open(&self, robot: &Robot, clock: MonotonicClock) -> Result<Self::Opened, SessionError>;

    /// What a person should know before the arms of `robot` are enabled, a line each.
    fn warnings(&self, _robot: &Robot) -> Vec<String> {
        Vec::new()
    }

    /// The interfaces of the first `arms` arms, each once, and their bit rate, bit/s.
    fn buses(&self, _arms: usize) -> (Vec<String>, u32) {
        (Vec::new(), 0)
    }

    /// Leads the arms to where they may be enabled, and says what it is at if that takes long.
    ///
    /// # Errors
    /// [`SessionError`], if one of them is not there or reports a fault.
    fn bring_up(
        &self,
        opened: Self::Opened,
        clock: MonotonicClock,
        say: PrintLine<'_>,
    ) -> Result<Self::Ready, SessionError>;

    /// Waits, if it has to, until the world on `scene` has seen that its arms are ours.
    ///
    /// # Errors
    /// [`SessionError::RealTime`] if they are another's.
    fn await_world(
        &self,
        _scene: &Subscriber<SceneReport>,
        _clock: MonotonicClock,
        _say: PrintLine<'_>,
    ) -> Result<(), SessionError> {
        Ok(())
    }

    /// Gives the arms torque, where that is not the controller's to give, as soon as `signals`
    /// allow it: the rig of the control thread, which calls this.
    ///
    /// # Errors
    /// [`SessionError`]; [`SessionError::Interrupted`] if the run is over before.
    fn enable(
        &self,
        ready: Self::Ready,
        noticed: MailboxWriter<Noticed>,
        signals: &Signals,
        clock: MonotonicClock,
    ) -> Result<Self::Rig, SessionError>;

    /// Leaves the arms, which rest, without torque.
    fn take_down(rig: &mut Self::Rig, clock: MonotonicClock);

    /// What the arms or the way to them report, if something ended the run that the controller does
    /// not know.
    fn fault(rig: &Self::Rig) -> Option<String>;

    /// What the result says of drives and buses.
    fn summary(&self, _rig: &Self::Rig) -> Option<CanSummary> {
        None
    }
}

/// What there is before anything is waited for.
struct Begun<'a, L: ArmLink> {
    link: &'a L,
    opened: L::Opened,
    clock: MonotonicClock,
    node: TopicNode,
    say: PrintLine<'a>,
}

/// Opens the way to the arms, says what a person should know of them, and joins the topics of their
/// world, or of their cameras.
fn begin<'a, L: ArmLink>(
    robot: &Robot,
    link: &'a L,
    say: PrintLine<'a>,
) -> Result<Begun<'a, L>, SessionError> {
    check_faults(robot)?;
    rt::catch_interrupts_in_motion().map_err(SessionError::signals)?;
    let clock = MonotonicClock::new();
    let opened = link.open(robot, clock)?;
    for warning in link.warnings(robot) {
        say(&format!("trocar: warning: {warning}"));
    }
    Ok(Begun {
        link,
        opened,
        clock,
        node: TopicNode::join(link.topics())?,
        say,
    })
}

/// Runs one episode with the task's arms on CAN.
///
/// SIGINT, SIGTERM and SIGHUP bring the arms to rest and end the run as failed, with the reason
/// `interrupted`.
///
/// # Errors
/// From the configuration, the buses and their drives, the world's topics, the policy or the log.
pub fn run_on_can(
    plan: &Plan,
    can: &CanOptions,
    say: PrintLine<'_>,
) -> Result<RunResult, SessionError> {
    run_task(plan, can, say)
}

/// The same with arms that another process commands, over topics.
///
/// # Errors
/// From the configuration, the topics of arms and world, the policy or the log.
pub fn run_on_topics(
    plan: &Plan,
    arms: &TopicArms,
    say: PrintLine<'_>,
) -> Result<RunResult, SessionError> {
    run_task(plan, arms, say)
}

fn run_task<L: ArmLink>(
    plan: &Plan,
    link: &L,
    say: PrintLine<'_>,
) -> Result<RunResult, SessionError> {
    let begun = begin(&plan.setup.robot, link, say)?;
    let scene = SceneTopic::subscriber(&begun.node, ARM_NAMES[0])?;
    let at = (link.topics(), link.host());
    let world = awaited::world(&scene, at, say)?;
    check_world(&world, plan, at)?;
    let is_told = plan.console.is_some() || plan.log.is_some();
    let open = || WorldTopics::open(&begun.node);
    let mut shown = match (is_told.then(open).transpose(), &plan.console) {
        (Err(error), None) => {
            say(&format!("the log has no scene: {error}"));
            None
        }
        (opened, _) => opened?,
    };
    if let Some(console) = &plan.console
        && let Some(world) = shown.take()
    {
        let start = awaited::start(&world, link.topics(), say)?;
        shown = Some(show_world((plan, console), world, start.as_ref())?);
    }
    let views = Views {
        within_ms: 0,
        asked: &[],
        world: shown,
    };
    begun.run(plan, views, |node, watching| {
        link.await_world(&scene, watching.seen.clock, say)?;
        let logged = match &watching.seen.log {
            Some(_) => plan.setup.cameras_with(Vec::new()),
            None => Vec::new(),
        };
        let RigPages {
            cameras: camera_pages,
            world: world_pages,
            arms: _,
            marked_by: _,
        } = watching.pages;
        let names = match &camera_pages {
            Some(_) => plan.setup.camera_names(),
            None => logged.clone(),
        };
        let scene_thread = SceneThread {
            say,
            scene,
            events: node.events()?,
            seen: watching.seen,
            local: watching.local,
            by_hand: watching.by_hand,
            reports: watching.reports,
            frames: frames(node, &names)?,
            logged,
            camera_pages,
            world_pages,
        };
        Ok(|| scene_thread.run())
    })
}

/// Runs a robot on CAN: no task, no scene and no verdict, until the time is up, a signal comes, or
/// a fault.
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
    run_robot(plan, asked, can, say)
}

/// The same of a robot that another process commands, over topics.
///
/// # Errors
/// From the configuration, the topics, the policy or the log.
pub fn run_robot_on_topics(
    plan: &Plan<Robot>,
    asked: &RobotOptions,
    arms: &TopicArms,
    say: PrintLine<'_>,
) -> Result<RunResult, SessionError> {
    run_robot(plan, asked, arms, say)
}

fn run_robot<L: ArmLink>(
    plan: &Plan<Robot>,
    asked: &RobotOptions,
    link: &L,
    say: PrintLine<'_>,
) -> Result<RunResult, SessionError> {
    let begun = begin(&plan.setup, link, say)?;
    let views = Views {
        within_ms: FRAMES_WITHIN_MS,
        asked: &asked.cameras,
        world: None,
    };
    begun.run(plan, views, |node, watching| {
        let Watching {
            seen,
            local,
            by_hand,
            reports,
            cameras,
            pages,
        } = watching;
        // Nobody else has to be there.
        seen.signals.allow_torque();
        let supervised = (plan.setup.robot().control.supervision, plan.warn);
        let robot_thread = RobotThread::new(seen, local, reports, cameras, (asked, supervised));
        let robot_thread = robot_thread.moved_by(by_hand);
        let robot_thread = robot_thread.shown_on(pages.cameras).shown_in(pages.arms);
        let robot_thread = robot_thread.marked_by(pages.marked_by);
        let robot_thread = robot_thread.woken_by(node.events()?);
        Ok(|| robot_thread.run())
    })
}

/// What the thread that observes the arms is made of.
struct Watching {
    seen: ObserverChannels,
    local: Local,
    /// An operator's hands that move the arms, or may.
    by_hand: Option<ByHand>,
    /// For a policy process, one an arm.
    reports: Vec<Publisher<ArmReport>>,
    /// Cameras that were waited for, and how many of them the policy, or an operator, looks
    /// through: the first.
    cameras: (Vec<Camera>, usize),
    /// What pages and log are told.
    pages: RigPages,
}

/// What is seen of the arms and what is around them.
struct Views<'a> {
    /// How far frames may be from the instant of an observation, ms.
    within_ms: u64,
    /// Cameras that are waited for besides the policy's.
    asked: &'a [String],
    /// Of a task what pages and log are told, if there are some.
    world: Option<WorldTopics>,
}

impl<L: ArmLink> Begun<'_, L> {
    /// Waits for the policy, its cameras and the others of `views`, brings up the arms, and runs
    /// all threads; `watch` makes the one that observes the arms.
    fn run<S: Arms, T: Seen + Send, F: FnOnce() -> Result<T, SessionError> + Send>(
        self,
        plan: &Plan<S>,
        views: Views<'_>,
        watch: impl FnOnce(&TopicNode, Watching) -> Result<F, SessionError>,
    ) -> Result<RunResult, SessionError> {
        plan.real_time.check()?;
        let (link, clock, node, say) = (self.link, self.clock, self.node, self.say);
        let outside = Outside {
            topics: link.topics(),
            frames_within_ms: views.within_ms,
        };
        let policy = Opened::open(plan, Some(&outside))?;
        let mut wanted = policy.cameras();
        let policys = wanted.len();
        for name in views.asked {
            if wanted.iter().all(|(known, _)| known != name) {
                wanted.push((name.clone(), None));
            }
        }
        // An operator looks through all of them.
        let by_hand = plan.console.is_some() && !plan.setup.rcms_from_view().is_empty();
        let looked_at = if by_hand { wanted.len() } else { policys };
        let remedy = format!(
            "start whoever publishes it (`{} --cameras NAME` of a simulated world), or name its topics with --topics",
            link.host()
        );
        let topics = (link.topics(), remedy.as_str());
        let mut cameras = awaited::cameras(&node, &wanted, clock, topics, (say, &mut || Ok(())))?;
        let (mut child, source) = policy.start(plan, outside, say)?;
        let robot = plan.setup.robot();
        let ready = link.bring_up(self.opened, clock, say)?;
        awaited::still_there(&mut cameras, clock, link.topics(), say)?;
        let mut channels =
            ThreadChannels::new((plan.open_log(false)?, plan.console.as_ref()), clock);
        let port = (channels.listener.as_ref(), &mut channels.control.operator);
        // Of a task all its cameras, should its world show them.
        let names = match plan.setup.task() {
            Some(setup) => setup.camera_names(),
            None => cameras.iter().map(|(name, _)| name.clone()).collect(),
        };
        let buses = link.buses(robot.arms());
        channels.seen.buses = BusLog::of(&buses);
        let world = views.world;
        let world = world.map(|world| world.logged_in(channels.scenes));
        let pages = show_rig(plan, buses, (names, world), port);
        let marked_by = pages.marked_by.clone();
        let reports = arm_reports(&node, robot.arms(), child.is_some())?;
        let (local, remote) = wired(plan, source, child.as_mut(), channels.chunk_in, clock);
        let (by_hand, local, hands) = ByHand::of(plan, local);
        let watching = Watching {
            seen: channels.seen,
            local,
            by_hand,
            reports,
            cameras: (cameras, looked_at),
            pages,
        };
        let observe = watch(&node, watching)?;
        let enabling = Enabling {
            link,
            say,
            ready,
            control: ControlThread::new(plan, channels.control, hands)?,
            measured: channels.measured,
            noticed: channels.noticed,
            clock,
        };
        let signals = Arc::clone(enabling.control.signals());
        let served = (&*signals, channels.listener.as_ref(), clock);
        let ends = threads::run(remote, served, || enabling.run(), observe);
        conclude(plan, ends, (channels.log, marked_by.as_deref()), link)
    }
}

/// The control thread before its arms have torque.
struct Enabling<'a, L: ArmLink> {
    link: &'a L,
    say: PrintLine<'a>,
    ready: L::Ready,
    control: ControlThread,
    measured: MailboxWriter<PerArm<ArmState>>,
    noticed: MailboxWriter<Noticed>,
    clock: MonotonicClock,
}

impl<L: ArmLink> Enabling<'_, L> {
    /// Enables all arms and controls them until the run is over, which leaves them without torque.
    fn run(self) -> Result<ControlEnd<L::Rig>, SessionError> {
        let signals = Arc::clone(self.control.signals());
        // Until the arms are taken down.
        let _moving = Moving;
        let _stops = StopsAll(&signals);
        uninterrupted()?;
        if signals.done() {
            return Err(SessionError::Interrupted);
        }
        // From here on drives want their SYNC in time; the loop reports what was granted.
        let _granted = rt::configure_thread(self.control.profile());
        (self.say)("checking the arms once more; they are enabled when all answer");
        let rig = self
            .link
            .enable(self.ready, self.noticed, &signals, self.clock)?;
        let rig = ObservedRig::new(rig, self.measured);
        let mut end = self.control.run(rig).with_rig(|observed| observed.rig);
        L::take_down(&mut end.rig, self.clock);
        Ok(end)
    }
}
