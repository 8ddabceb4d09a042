//! Who is shown simulated arms beside the controller: the threads between the simulation and the
//! topics, which shows them to other processes, and takes the frames of these.
//!
//! None of these threads is on the control path: they read mailboxes and queues that the simulation
//! thread writes without waiting. One thread takes frames, whose kind depends on whose cameras they
//! are; one publishes states and scenes.

use std::sync::Arc;
use std::thread;

use hal::{ArmState, PerArm, TimeNs};
use trocar_log::SideLog;

use super::Simulated;
use super::arm_states::StatesThread;
use super::cameras::{Cameras, Stage};
use super::channels::ObserverChannels;
use super::child::PolicyChild;
use super::frames_thread::{FramesEnd, FramesThread};
use super::remote_arms::{Camera, CanEventLog, arm_reports};
use super::robot::{RobotOptions, RobotThread};
use super::scene_topics::{SceneForPages, Snapshot};
use super::shown::CameraPages;
use super::signals::Signals;
use super::simulation_thread::{ConsoleView, Shown, SimulationThread};
use super::threads::joined;
use crate::mailbox::{MailboxReader, mailbox};
use crate::rt::{self, MonotonicClock};
use crate::session::{Plan, SessionError};
use trocar_topics::{ArmReport, Events, Publisher};

/// Polling period for what a log without frames is to say, ns.
const TOLD_NS: u64 = 20_000_000;

/// The threads before they run.
pub(super) struct Observers {
    frames: Frames,
    states: Option<StatesThread>,
}

/// Where frames come from.
enum Frames {
    /// There are none.
    None,
    /// Our cameras' process.
    Own(Box<FramesThread>),
    /// Others' cameras.
    Others(Box<Others>),
}

/// What the thread that watches others' cameras is made of.
struct Others {
    /// With how many of them, the first, the policy looks through.
    cameras: (Vec<Camera>, usize),
    /// For a policy process, one an arm.
    reports: Vec<Publisher<ArmReport>>,
    /// Each period's, so that the arms of a frame's instant can be found.
    measured: MailboxReader<PerArm<ArmState>>,
    events: Events,
}

impl Observers {
    /// Opens what `stage` needs for a run of `plan` with the policy `child`, if it has one; also
    /// gives the simulation's end.
    ///
    /// # Errors
    /// From the topics; nothing runs yet.
    pub(super) fn open(
        plan: &Plan,
        stage: Stage,
        child: Option<&PolicyChild>,
        console: Option<(ConsoleView, SceneForPages)>,
    ) -> Result<(Self, Shown), SessionError> {
        let (names, looked_at) = (stage.names(), stage.is_looked_at());
        let arms = plan.setup.task.arms.len();
        let (console, mut pages) = console.unzip();
        let node = stage.node.as_ref();
        let others = matches!(stage.cameras, Cameras::Others(..));
        if let (Cameras::Own(_), Some(node)) = (&stage.cameras, node) {
            pages = pages.map(|pages| pages.drawn_on(plan, node)).transpose()?;
        }
        let mut seen = None;
        let frames = match (stage.cameras, node) {
            (Cameras::Own(child), Some(node)) => {
                let thread = FramesThread::open(plan, *child, node, (&names, looked_at))?;
                Frames::Own(Box::new(thread))
            }
            (Cameras::Others(cameras, looked_at), Some(node)) => {
                let (measured_in, measured) = mailbox();
                seen = Some(measured_in);
                let cameras = (cameras, looked_at);
                let reports = arm_reports(node, arms, child.is_some())?;
                let events = node.events()?;
                Frames::Others(Box::new(Others {
                    cameras,
                    reports,
                    measured,
                    events,
                }))
            }
            (Cameras::None | Cameras::Own(_) | Cameras::Others(..), _) => Frames::None,
        };
        let (scene_in, snapshots) = mailbox::<Snapshot>();
        let scene = stage.scene.map(|scene| (scene, snapshots));
        let shows_scene = scene.is_some();
        // With others' cameras the arms are shown as they were when these took their frames.
        let of_arms = node.filter(|_| child.is_some() && !others);
        let states = (shows_scene || pages.is_some()).then(|| {
            let arms = of_arms.map(|node| (node, arms));
            StatesThread::open(arms, scene, pages)
        });
        let (states, states_in) = states.transpose()?.unzip();
        let shown = Shown {
            scene: shows_scene.then_some(scene_in),
            states: states_in.filter(|_| of_arms.is_some()),
            wakes: Vec::new(),
            query_every_steps: child.map(PolicyChild::query_every_steps),
            history_steps: child.map_or(0, PolicyChild::history_steps),
            frames: plan.wants_frames(),
            every_step: others,
            seen,
            console,
            log: None,
        };
        Ok((Self { frames, states }, shown))
    }

    /// Runs `simulation` from `first` on by `clock`, and these threads beside it, until the control
    /// thread has stopped.
    ///
    /// Blocks: the simulation runs on the calling thread.
    ///
    /// # Errors
    /// Of the states thread first, then of the simulation, then of the frames thread.
    pub(super) fn run(
        self,
        plan: &Plan,
        mut simulation: SimulationThread,
        (clock, first): (MonotonicClock, TimeNs),
        log: Option<SideLog>,
        signals: &Arc<Signals>,
    ) -> Result<Simulated, SessionError> {
        let Self { frames, states } = self;
        thread::scope(|scope| {
            let frames = scope.spawn(move || match (frames, log) {
                (Frames::Own(thread), log) => thread.run(plan, clock, log, signals),
                (Frames::Others(others), log) => others.run(plan, clock, log, signals),
                (Frames::None, Some(log)) => {
                    write_told(log, signals);
                    Ok(FramesEnd::default())
                }
                (Frames::None, None) => Ok(FramesEnd::default()),
            });
            let states = states.map(|states| scope.spawn(move || states.run(clock, signals)));
            let wakes = &mut simulation.shown.wakes;
            wakes.extend(states.iter().map(|thread| thread.thread().clone()));
            let simulated = simulation.run(clock, first);
            let frames = joined(frames).and_then(|end| end);
            let states = states.map(|states| joined(states).and_then(|end| end));
            states.transpose()?;
            Ok((simulated?, frames?))
        })
    }
}

impl Others {
    /// Watches these cameras as a robot's are watched.
    fn run(
        self,
        plan: &Plan,
        clock: MonotonicClock,
        log: Option<SideLog>,
        signals: &Arc<Signals>,
    ) -> Result<FramesEnd, SessionError> {
        let (_, noticed) = mailbox();
        let seen = ObserverChannels {
            measured: self.measured,
            news: CanEventLog::new(noticed),
            buses: None,
            log,
            signals: Arc::clone(signals),
            clock,
        };
        let rules = (plan.setup.robot.control.supervision, plan.warn);
        let asked = RobotOptions::default();
        let thread = RobotThread::new(seen, None, self.reports, self.cameras, (&asked, rules));
        let pages = plan.console.as_ref();
        let pages = pages.map(|console| CameraPages::of(console, plan.setup.camera_names()));
        let end = thread.shown_on(pages).woken_by(self.events).run()?;
        Ok(FramesEnd {
            pictures: None,
            ended_by: end.ended_by,
        })
    }
}

/// Writes what the `log` is to say where no frames are kept, until the control thread has stopped.
///
/// Once more at the end, so that the last events are in the log.
fn write_told(mut log: SideLog, signals: &Signals) {
    while !signals.stopped() {
        signals.write_told(Some(&mut log));
        rt::sleep_ns(TOLD_NS);
    }
    signals.write_told(Some(&mut log));
}
