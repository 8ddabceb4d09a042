//! The tasks that a session can run: scene and safety limits by name.

use hal::config::Source;
use sim_backend::task::TaskConfig;

use super::SessionError;

/// Names of all tasks that can be run.
pub fn names() -> impl Iterator<Item = &'static str> {
    TaskConfig::names()
}

/// Scene and safety limits of `task`.
///
/// # Errors
/// [`SessionError::BadArgument`] if there is no such task.
pub fn sources(task: &str) -> Result<(Source, Source), SessionError> {
    let both = TaskConfig::source(task).zip(TaskConfig::safety_source(task));
    both.ok_or_else(|| {
        let known: Vec<&str> = names().collect();
        SessionError::BadArgument(format!(
            "there is no task {task:?}; there are {}",
            known.join(", ")
        ))
    })
}

#[cfg(test)]
mod tests {
    use super::{names, sources};
    use crate::session::Setup;
    use crate::session::source::PolicyChoice;

    #[test]
    fn every_task_has_its_limits_and_they_fit_its_scene() {
        assert!(names().count() >= 5);
        for name in names() {
            let setup = Setup::load(name, None, &PolicyChoice::Expert).unwrap();
            assert_eq!((setup.task_name.as_str(), setup.task.name), (name, name));
            let path = format!("../config/tasks/{name}/safety.toml");
            assert_eq!(setup.texts.safety, std::fs::read_to_string(path).unwrap());
        }
        let error = sources("no-such-task").unwrap_err().to_string();
        assert!(error.contains("no-such-task") && error.contains("block-transfer"));
    }
}
