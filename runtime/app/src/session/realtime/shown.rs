//! What the console hears of a run: ends for the control thread, the simulation and the cameras.

use trocar_tasks::cameras::SceneModel;
use trocar_tasks::scene::SceneSnapshot;

use super::camera_thread::{ConsoleCameras, Snapshot};
use super::simulation_thread::ConsoleView;
use crate::console::Facts;
use crate::mailbox::mailbox;
use crate::session::operator::{Listener, OperatorPort};
use crate::session::plan::Arms;
use crate::session::{Plan, SessionError};

/// Shows a simulated task, steered at `listener`: the ends for the simulation and for the cameras, if there is a console.
pub(super) fn show_task(
    plan: &Plan,
    start: &SceneSnapshot,
    (listener, port): (Option<&Listener>, &mut OperatorPort),
) -> Result<Option<(ConsoleView, ConsoleCameras)>, SessionError> {
    let Some(console) = &plan.console else {
        return Ok(None);
    };
    let setup = &plan.setup;
    // Pages that are told of the scene ask for its file.
    let model = SceneModel::new(&setup.task, plan.seed);
    let scene = console.show_scene(model, start, &setup.robot().control.arms)?;
    let facts = facts_of(plan, &setup.task_name, setup.camera_names());
    let facts = facts.within_s(setup.task.time_limit_s).with_scene();
    let taps = console.show_run(facts, listener.map(|listener| listener.path().to_owned()));
    port.tap = Some(taps.control);
    let (to, snapshots) = mailbox::<Snapshot>();
    let view = ConsoleView {
        to,
        frames: console.frames(),
        missing: taps.task,
    };
    let frames = console.frames();
    let cameras = ConsoleCameras::new(frames, scene, snapshots);
    Ok(Some((view, cameras)))
}

/// Shows a run without a simulation of its own.
pub(super) fn show_rig<S: Arms>(
    plan: &Plan<S>,
    (listener, port): (Option<&Listener>, &mut OperatorPort),
) {
    if let Some(console) = &plan.console {
        let title = plan
            .setup
            .task()
            .map_or("robot", |setup| setup.task_name.as_str());
        let facts = facts_of(plan, title, Vec::new());
        let taps = console.show_run(facts, listener.map(|listener| listener.path().to_owned()));
        port.tap = Some(taps.control);
    }
}

fn facts_of<S: Arms>(plan: &Plan<S>, title: &str, cameras: Vec<String>) -> Facts {
    let control = &plan.setup.robot().control;
    Facts::new(title, &plan.policy.name(), plan.seed, control, cameras)
}
