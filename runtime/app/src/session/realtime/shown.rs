//! What the console hears of a run: ends for the control thread and the simulation, and for whoever
//! shows its scene.

use std::sync::Arc;

use trocar_tasks::cameras::SceneModel;
use trocar_tasks::scene::SceneSnapshot;
use trocar_tasks::task::TaskConfig;
use trocar_topics::FrameView;

use super::frames_thread::show_view;
use super::robot::ArmsScene;
use super::scene_topics::{SceneForPages, Snapshot, WorldForPages, WorldTopics};
use super::simulation_thread::ConsoleView;
use crate::console::{Console, Facts, FrameTap, PictureFacts, unseen_run};
use crate::mailbox::mailbox;
use crate::rt::MonotonicClock;
use crate::session::operator::{Listener, OperatorPort};
use crate::session::plan::Arms;
use crate::session::scene_options::BASELINE_M;
use crate::session::teleop::{Hands, picture};
use crate::session::{Plan, SessionError};

/// Shows a simulated task, steered at `listener`: the end for the simulation, and the scene that
/// pages are shown, if there is a console.
pub(super) fn show_task(
    plan: &Plan,
    start: &SceneSnapshot,
    (listener, port): (Option<&Listener>, &mut OperatorPort),
) -> Result<Option<(ConsoleView, SceneForPages)>, SessionError> {
    let setup = &plan.setup;
    let facts = facts_of(plan, &setup.task_name, setup.camera_names());
    let facts = facts.within_s(setup.task.time_limit_s);
    let facts = facts.moved_in(picture_of(&setup.task));
    let Some(console) = &plan.console else {
        show_operator(facts, listener, port);
        return Ok(None);
    };
    // Pages that are told of the scene ask for its file.
    let model = SceneModel::new(&setup.task, plan.seed);
    let scene = console.show_scene(model, start, &setup.robot().control.arms)?;
    let path = listener.map(|listener| listener.path().to_owned());
    let taps = console.show_run(facts.with_scene(), path);
    if let Some(listener) = listener {
        listener.show(taps.view);
    }
    port.tap = Some(taps.control);
    let (to, snapshots) = mailbox::<Snapshot>();
    let view = ConsoleView {
        to,
        frames: console.frames(),
        task: taps.task,
    };
    let cameras = setup.task.cameras.len();
    let pages = SceneForPages::new((scene, console.frames()), cameras, snapshots);
    Ok(Some((view, pages)))
}

/// The picture that hands move in.
fn picture_of(task: &TaskConfig) -> Option<PictureFacts> {
    let camera = picture(task)?;
    let config = task.cameras.get(camera)?;
    let right = config.right_eye(BASELINE_M).name;
    let lens = config.intrinsics();
    Some(PictureFacts {
        camera,
        wide: f64::from(lens.width) / lens.fx,
        right: task.cameras.iter().position(|it| it.name == right),
    })
}

/// Pages that are shown frames of the cameras of these names, in the order in which they were told
/// of them.
pub(super) struct CameraPages {
    to: FrameTap,
    names: Vec<String>,
}

impl CameraPages {
    /// Those of `console`, which were told of the cameras `names`.
    pub(super) fn of(console: &Console, names: Vec<String>) -> Self {
        Self {
            to: console.frames(),
            names,
        }
    }

    /// Shows pages what they want of `view`, the newest frame of the camera `name`, by the run's
    /// `clock`.
    pub(super) fn show(&self, name: &str, view: &FrameView, clock: MonotonicClock) {
        if let Some(camera) = self.names.iter().position(|known| known == name) {
            show_view(&self.to, camera, view, clock);
        }
    }
}

/// What pages are shown of arms outside of this process.
pub(super) struct RigPages {
    /// If there is a console.
    pub(super) cameras: Option<CameraPages>,
    /// Of a task, for a console or a log.
    pub(super) world: Option<WorldForPages>,
    /// Of a robot without a task, if there is a console.
    pub(super) arms: Option<ArmsScene>,
    /// Where a person says how the run goes, if that is asked.
    pub(super) marked_by: Option<Arc<Hands>>,
}

/// Shows the scene of a `world` of another process on the pages of the console of `plan`, which
/// begins with `start` if that is known.
pub(super) fn show_world(
    (plan, console): (&Plan, &Console),
    world: WorldTopics,
    start: Option<&SceneSnapshot>,
) -> Result<WorldTopics, SessionError> {
    let Some(start) = start else {
        return Ok(world);
    };
    let setup = &plan.setup;
    let model = SceneModel::new(&setup.task, plan.seed);
    let scene = console.show_scene(model, start, &setup.robot().control.arms)?;
    Ok(world.with_scene(scene))
}

/// Shows a run without a simulation of its own, whose arms are on these interfaces with this bit
/// rate, bit/s, with these cameras and, of a task, its world: what pages and log are told while it
/// goes on.
pub(super) fn show_rig<S: Arms>(
    plan: &Plan<S>,
    (interfaces, bit_rate): (Vec<String>, u32),
    (cameras, world): (Vec<String>, Option<WorldTopics>),
    (listener, port): (Option<&Listener>, &mut OperatorPort),
) -> RigPages {
    let task = plan.setup.task();
    let title = task.map_or("robot", |setup| setup.task_name.as_str());
    let mut facts = facts_of(plan, title, cameras.clone()).on_buses(interfaces, bit_rate);
    if let Some(setup) = task {
        facts = facts.within_s(setup.task.time_limit_s);
        facts = facts.moved_in(picture_of(&setup.task));
    }
    let Some(console) = &plan.console else {
        let hands = show_operator(facts, listener, port);
        return RigPages {
            cameras: None,
            world: world.map(|world| world.told_to(None)),
            arms: None,
            marked_by: hands.and_then(|hands| marked_by(plan, hands)),
        };
    };
    if world.as_ref().is_some_and(WorldTopics::has_scene) {
        facts = facts.with_scene();
    }
    let taps = console.show_run(facts, listener.map(|listener| listener.path().to_owned()));
    if let Some(listener) = listener {
        listener.show(taps.view);
    }
    port.tap = Some(taps.control);
    let arms = &plan.setup.robot().control.arms;
    let scene = || ArmsScene::new(console, arms, &cameras);
    RigPages {
        arms: task.is_none().then(scene),
        cameras: Some(CameraPages::of(console, cameras)),
        world: world.map(|world| world.told_to(Some(taps.task))),
        marked_by: marked_by(plan, console.hands()),
    }
}

/// The hands, at which a person may say from now on how the run goes; none if a task judges it, or
/// no log keeps what they say.
fn marked_by<S: Arms>(plan: &Plan<S>, hands: Arc<Hands>) -> Option<Arc<Hands>> {
    if plan.setup.task().is_some() || plan.log.is_none() {
        return None;
    }
    hands.ask_for_mark();
    Some(hands)
}

/// Shows a run that no page shows to whoever asks at `listener`: the hands of an operator there.
fn show_operator(
    facts: Facts,
    listener: Option<&Listener>,
    port: &mut OperatorPort,
) -> Option<Arc<Hands>> {
    let listener = listener?;
    let taps = unseen_run(facts, Some(listener.path().to_owned()));
    let hands = Arc::clone(taps.view.hands());
    listener.show(taps.view);
    port.tap = Some(taps.control);
    Some(hands)
}

fn facts_of<S: Arms>(plan: &Plan<S>, title: &str, cameras: Vec<String>) -> Facts {
    let control = &plan.setup.robot().control;
    Facts::new(title, &plan.policy.name(), plan.seed, control, cameras)
}
