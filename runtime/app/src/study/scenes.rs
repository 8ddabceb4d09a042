//! Whether the scenes exist that a study asks for: tasks with those needles, views and cameras. A
//! misspelt needle would otherwise be found hours later, when its cell is begun.

use std::collections::BTreeSet;

use trocar_tasks::task::View;

use super::StudyError;
use super::job::{Job, TaskInput};
use super::plan::Cell;
use crate::session::scene_options::{CameraSet, SceneOptions};
use crate::session::{PolicyChoice, Setup};

/// Checks every cell's scene, without drawing any. Each scene is made once, however many cells have
/// it. Trainings have none of their own.
///
/// # Errors
/// [`StudyError::BadCell`] with the cell.
pub(super) fn check(cells: &[Cell], path: &str) -> Result<(), StudyError> {
    let mut seen = BTreeSet::new();
    for cell in cells {
        let (task, needle, view, cameras) = match &cell.job {
            Job::Recording(job) => (&job.task, None, "train", Some(job.cameras.as_str())),
            Job::Evaluation(job) => (&job.task, job.needle.as_deref(), job.view.as_str(), None),
            Job::Training(_) => continue,
        };
        if !seen.insert((
            task.argument.clone(),
            task.scene.clone(),
            needle,
            view,
            cameras,
        )) {
            continue;
        }
        check_one(task, needle, view, cameras).map_err(|reason| StudyError::BadCell {
            path: path.to_owned(),
            cell: format!("{} {}", cell.job.kind().as_str(), cell.label),
            reason,
        })?;
    }
    Ok(())
}

/// Loads the task and puts the scene together as `record` and `eval` do; says why that fails.
fn check_one(
    task: &TaskInput,
    needle: Option<&str>,
    view: &str,
    cameras: Option<&str>,
) -> Result<(), String> {
    let options = SceneOptions {
        file: task.scene.clone(),
        needle: needle.map(str::to_owned),
        view: view_named(view),
        varied: Vec::new(),
        cameras: cameras.map(CameraSet::parse),
    };
    let setup = Setup::load(&task.argument, None, &PolicyChoice::Expert);
    let checked = setup.and_then(|setup| setup.with_scene(&options));
    checked.map(drop).map_err(|error| error.to_string())
}

/// The file has checked the name. What it does not know is the training view.
fn view_named(name: &str) -> View {
    match name {
        "view1" => View::View1,
        "view2" => View::View2,
        _ => View::Train,
    }
}
