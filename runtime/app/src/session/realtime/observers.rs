//! Who is shown the policy steps of simulated arms: the cameras, which draw the scene, and the thread that publishes the arms' state.

use std::thread;

use hal::TimeNs;
use trocar_log::SideLog;
use trocar_tasks::scene::SceneSnapshot;

use super::Simulated;
use super::arm_states::StatesThread;
use super::camera_thread::{CameraThread, ConsoleCameras, Snapshot};
use super::child::PolicyChild;
use super::signals::Signals;
use super::simulation_thread::{ConsoleView, Shown, SimulationThread};
use super::threads::joined;
use crate::mailbox::mailbox;
use crate::rt::{self, MonotonicClock};
use crate::session::{Plan, SessionError};

/// Time between two looks at what a log without frames is to say, ns.
const TOLD_NS: u64 = 20_000_000;

/// The threads before they run.
pub(super) struct Observers {
    cameras: Option<CameraThread>,
    states: Option<StatesThread>,
}

impl Observers {
    /// Opens the renderer, if anything is to be drawn, and the topics of `child`, if there is one; also gives the simulation's end of both.
    pub(super) fn open(
        plan: &Plan,
        child: Option<&PolicyChild>,
        (console_view, console_cameras): (Option<ConsoleView>, Option<ConsoleCameras>),
        start: &SceneSnapshot,
    ) -> Result<(Self, Shown), SessionError> {
        let node = child.map(PolicyChild::node);
        let names = cameras(plan, child);
        let (scene, snapshots) = mailbox::<Snapshot>();
        let draws = plan.wants_frames() || !names.is_empty() || console_cameras.is_some();
        let open = || CameraThread::new(plan, &names, node, (snapshots, console_cameras), start);
        let cameras = draws.then(open).transpose()?;
        let arms = plan.setup.task.arms.len();
        let states = node.map(|node| StatesThread::open(node, arms));
        let (states, states_in) = states.transpose()?.unzip();
        let shown = Shown {
            scene: cameras.as_ref().map(|_| scene),
            states: states_in,
            wakes: Vec::new(),
            query_every_steps: child.map(PolicyChild::query_every_steps),
            history_steps: child.map_or(0, PolicyChild::history_steps),
            frames: plan.wants_frames(),
            console: console_view,
        };
        Ok((Self { cameras, states }, shown))
    }

    /// Runs `simulation` from `first` on by `clock`, and these threads beside it, until the control thread has stopped.
    pub(super) fn run(
        self,
        mut simulation: SimulationThread,
        (clock, first): (MonotonicClock, TimeNs),
        log: Option<SideLog>,
        signals: &Signals,
    ) -> Result<Simulated, SessionError> {
        let Self { cameras, states } = self;
        thread::scope(|scope| {
            let cameras = match (cameras, log) {
                (Some(cameras), log) => Some(scope.spawn(|| cameras.run(log, signals))),
                (None, Some(log)) => {
                    scope.spawn(|| write_told(log, signals));
                    None
                }
                (None, None) => None,
            };
            let states = states.map(|states| scope.spawn(|| states.run(signals)));
            let wakes = &mut simulation.shown.wakes;
            wakes.extend(cameras.iter().map(|thread| thread.thread().clone()));
            wakes.extend(states.iter().map(|thread| thread.thread().clone()));
            let simulated = simulation.run(clock, first);
            let cameras = cameras.map(|cameras| joined(cameras).and_then(|end| end));
            let states = states.map(|states| joined(states).and_then(|end| end));
            states.transpose()?;
            Ok((simulated?, cameras.transpose()?))
        })
    }
}

/// Writes what the `log` is to say where no camera thread does, until the control thread has stopped.
fn write_told(mut log: SideLog, signals: &Signals) {
    while !signals.stopped() {
        signals.write_told(Some(&mut log));
        rt::sleep_ns(TOLD_NS);
    }
    signals.write_told(Some(&mut log));
}

/// Names of the cameras that are drawn for the log, the pictures and, if there is one, a policy process and others on its topics.
fn cameras(plan: &Plan, child: Option<&PolicyChild>) -> Vec<String> {
    let seen = child.map_or_else(Vec::new, PolicyChild::cameras);
    let on_topics = child.is_some() && plan.setup.kept_cameras.is_some();
    if plan.wants_frames() || on_topics {
        plan.setup.cameras_with(seen)
    } else {
        seen
    }
}
