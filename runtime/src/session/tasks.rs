//! The tasks that a session can run: scene and safety limits by name.

use hal::config::Source;
use sim_backend::task::TaskConfig;

use super::SessionError;

/// Safety limits that are built into the program, by task.
const SAFETY: [(&str, &str, &str); 5] = [
    (
        "needle-lift",
        "config/tasks/needle-lift/safety.toml",
        include_str!("../../../config/tasks/needle-lift/safety.toml"),
    ),
    (
        "block-transfer",
        "config/tasks/block-transfer/safety.toml",
        include_str!("../../../config/tasks/block-transfer/safety.toml"),
    ),
    (
        "suture-pad",
        "config/tasks/suture-pad/safety.toml",
        include_str!("../../../config/tasks/suture-pad/safety.toml"),
    ),
    (
        "needle-handover",
        "config/tasks/needle-handover/safety.toml",
        include_str!("../../../config/tasks/needle-handover/safety.toml"),
    ),
    (
        "tissue-retraction",
        "config/tasks/tissue-retraction/safety.toml",
        include_str!("../../../config/tasks/tissue-retraction/safety.toml"),
    ),
];

/// Names of all tasks that can be run.
pub fn names() -> impl Iterator<Item = &'static str> {
    SAFETY.iter().map(|(name, _, _)| *name)
}

/// Scene and safety limits of `task`.
///
/// # Errors
/// [`SessionError::BadArgument`] if there is no such task.
pub fn sources(task: &str) -> Result<(Source, Source), SessionError> {
    let safety = SAFETY.iter().find(|(name, _, _)| *name == task);
    match (TaskConfig::source(task), safety) {
        (Some(scene), Some((_, path, text))) => Ok((scene, Source::embedded(path, text))),
        _ => {
            let known: Vec<&str> = names().collect();
            Err(SessionError::BadArgument(format!(
                "there is no task {task:?}; there are {}",
                known.join(", ")
            )))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{names, sources};
    use crate::session::Setup;
    use crate::session::source::PolicyChoice;
    use sim_backend::task::TaskConfig;

    #[test]
    fn every_task_has_its_limits_and_they_fit_its_scene() {
        let simulated: Vec<&str> = TaskConfig::names().collect();
        for name in names() {
            assert!(simulated.contains(&name), "{name}");
            let setup = Setup::load(name, None, &PolicyChoice::Expert).unwrap();
            assert_eq!(setup.task_name, name);
        }
        let error = sources("no-such-task").unwrap_err().to_string();
        assert!(error.contains("no-such-task") && error.contains("block-transfer"));
    }
}
