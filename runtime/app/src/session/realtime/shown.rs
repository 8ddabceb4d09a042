//! What the console hears of a run: ends for the control thread, the simulation and the cameras.

use trocar_control::ControlConfig;

use super::camera_thread::{ConsoleCameras, Snapshot};
use super::simulation_thread::ConsoleView;
use crate::console::Facts;
use crate::mailbox::mailbox;
use crate::session::Setup;
use crate::session::operator::{Listener, OperatorPort};
use crate::session::run::RunOptions;

/// Shows a simulated task, steered at `listener`: the ends for the simulation and for the cameras, if there is a console.
pub(super) fn show_task(
    setup: &Setup,
    options: &RunOptions,
    (listener, port): (Option<&Listener>, &mut OperatorPort),
) -> Option<(ConsoleView, ConsoleCameras)> {
    let console = options.console.as_ref()?;
    let policy = options.policy.name();
    let (task, cameras) = (&setup.task_name, setup.camera_names());
    let facts = Facts::new(task, &policy, options.seed, &setup.control, cameras);
    let facts = facts.within_s(setup.task.time_limit_s);
    let taps = console.show_run(facts, listener.map(|listener| listener.path().to_owned()));
    port.tap = Some(taps.control);
    let (to, snapshots) = mailbox::<Snapshot>();
    let view = ConsoleView {
        to,
        frames: console.frames(),
        missing: taps.task,
    };
    let frames = console.frames();
    Some((view, ConsoleCameras::new(frames, snapshots)))
}

/// Shows a run without a simulation of its own: `title` under `control`, steered at `listener`.
pub(super) fn show_rig(
    title: &str,
    control: &ControlConfig,
    options: &RunOptions,
    (listener, port): (Option<&Listener>, &mut OperatorPort),
) {
    if let Some(console) = &options.console {
        let policy = options.policy.name();
        let facts = Facts::new(title, &policy, options.seed, control, Vec::new());
        let taps = console.show_run(facts, listener.map(|listener| listener.path().to_owned()));
        port.tap = Some(taps.control);
    }
}
