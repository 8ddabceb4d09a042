//! The tasks that a session can run: the built-in ones by name, any other by the path of its
//! folder.

use std::path::{Path, PathBuf};

use trocar_tasks::task::{SAFETY_FILE, SCENE_FILE, TaskConfig, TaskError, TaskFiles};

use super::SessionError;

/// Names of the built-in tasks, in the order in which lists show them.
pub fn names() -> impl Iterator<Item = &'static str> {
    TaskConfig::names()
}

/// Scene and safety limits of `task`, a name or the path of a folder.
///
/// # Errors
/// [`SessionError::BadArgument`] if there is no such task, [`SessionError::Config`] if one of its
/// files can't be read.
pub fn files(task: &str) -> Result<TaskFiles, SessionError> {
    TaskFiles::find(task).map_err(|error| match error {
        TaskError::Config(error) => error.into(),
        TaskError::Unknown { .. }
        | TaskError::NoFolder { .. }
        | TaskError::BadName { .. }
        | TaskError::NameTaken { .. } => SessionError::BadArgument(format!("--task: {error}")),
    })
}

/// The files that `task` is read from: none of a built-in one.
#[must_use]
pub fn paths(task: &str) -> Vec<PathBuf> {
    if TaskFiles::built_in(task).is_some() {
        return Vec::new();
    }
    [SCENE_FILE, SAFETY_FILE]
        .map(|file| Path::new(task).join(file))
        .into()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::PolicyChoice;
    use crate::session::Setup;

    #[test]
    fn every_task_has_its_limits_and_they_fit_its_scene() {
        let names: Vec<_> = names().collect();
        // Those that a task was added to come after them.
        assert_eq!(
            names[..5],
            [
                "needle-lift",
                "needle-handover",
                "tissue-retraction",
                "suture-pad",
                "block-transfer"
            ]
        );
        for name in names {
            let setup = Setup::load(name, None, &PolicyChoice::Expert).unwrap();
            assert_eq!(
                (setup.task_name.as_str(), setup.task.name.as_str()),
                (name, name)
            );
            assert_eq!(setup.scene_file, None);
            let path = format!("../../config/tasks/{name}/safety.toml");
            assert_eq!(
                setup.robot.texts.safety,
                std::fs::read_to_string(path).unwrap()
            );
        }
        let error = files("no-such-task").unwrap_err();
        assert!(error.is_bad_input());
        let error = error.to_string();
        assert!(error.contains("no-such-task") && error.contains("block-transfer"));
    }

    #[test]
    fn the_folder_of_a_built_in_task_is_that_task() {
        let folder = "../../config/tasks/suture-pad";
        let setup = Setup::load(folder, None, &PolicyChoice::Expert).unwrap();
        let built_in = Setup::load("suture-pad", None, &PolicyChoice::Expert).unwrap();
        assert_eq!(setup.task_name, "suture-pad");
        assert_eq!(setup.robot.texts.scene, built_in.robot.texts.scene);
        assert_eq!(setup.scene_file, Some(format!("{folder}/scene.toml")));
    }
}
