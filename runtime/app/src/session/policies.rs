//! Committed policies: a folder a task, and in it the one policy that is recommended for the task.
//! They are found from any folder: in the repository whose root this is or whose `target` the
//! program is in, or beside the program that was installed.

use std::env;
use std::fs;
use std::path::{Component, Path, PathBuf};

use super::SessionError;

/// Where committed policies are in the repository.
pub const FOLDER: &str = "config/policies";

/// Where they are beside `bin/trocar` once it is installed.
const INSTALLED: &str = "share/trocar/policies";

/// The folders of committed policies that there are, those here first.
fn roots() -> Vec<PathBuf> {
    let mut folders = vec![PathBuf::from(FOLDER)];
    folders.extend(beside_the_program().unwrap_or_default());
    folders.retain(|folder| folder.is_dir());
    folders
}

fn beside_the_program() -> Option<Vec<PathBuf>> {
    let program = env::current_exe().ok()?.canonicalize().ok()?;
    // Of PREFIX/bin/trocar, and of REPOSITORY/target/PROFILE/trocar.
    let mut above = program.ancestors().skip(2);
    let prefix = above.next()?.join(INSTALLED);
    let repository = above.next().map(|folder| folder.join(FOLDER));
    Some([Some(prefix), repository].into_iter().flatten().collect())
}

/// The committed policy that `name` names, as `needle-lift/act-compact` or with `config/policies/`
/// before it, if there is one.
pub(super) fn named(name: &str) -> Option<PathBuf> {
    let name = Path::new(name);
    let name = name.strip_prefix(FOLDER).unwrap_or(name);
    let is_plain = name
        .components()
        .all(|part| matches!(part, Component::Normal(_)));
    let mut folders = roots().into_iter().map(|root| root.join(name));
    folders.find(|folder| is_plain && folder.join(CHECKPOINT_FILE).is_file())
}

/// What a checkpoint's folder has.
const CHECKPOINT_FILE: &str = "config.json";

/// The committed policy of the task called `task`: the only checkpoint in its folder.
///
/// # Errors
/// [`SessionError::BadArgument`] if there is none or more than one, with the tasks that have one.
pub fn recommended(task: &str) -> Result<PathBuf, SessionError> {
    let roots = roots();
    let with_one = roots
        .iter()
        .find(|root| !checkpoints(&root.join(task)).is_empty());
    let root = with_one.or_else(|| roots.first());
    recommended_in(root.map_or(Path::new(FOLDER), PathBuf::as_path), task)
}

fn recommended_in(root: &Path, task: &str) -> Result<PathBuf, SessionError> {
    let refuse = |reason: String| Err(SessionError::BadArgument(reason));
    if !root.is_dir() {
        return refuse(format!(
            "{}: there is no such folder here, nor beside the program: name a policy with --policy",
            root.display()
        ));
    }
    let folder = root.join(task);
    let mut found = checkpoints(&folder);
    match (found.pop(), found.len()) {
        (Some(only), 0) => Ok(only),
        (Some(_), others) => refuse(format!(
            "{}: has {} policies, and one is recommended a task; name one with --policy",
            folder.display(),
            others + 1
        )),
        (None, _) => {
            let tasks = tasks(root);
            let tasks = if tasks.is_empty() {
                "no task has one".to_owned()
            } else {
                format!("there is one for {}", tasks.join(", "))
            };
            refuse(format!(
                "task {task} has no committed policy in {}; {tasks}; --policy takes any other",
                root.display()
            ))
        }
    }
}

/// Tasks with a committed policy, by name.
fn tasks(root: &Path) -> Vec<String> {
    let with_policy = |folder: &PathBuf| !checkpoints(folder).is_empty();
    let name = |folder: PathBuf| Some(folder.file_name()?.to_string_lossy().into_owned());
    let folders = entries(root).into_iter().filter(with_policy);
    folders.filter_map(name).collect()
}

/// The checkpoints in `folder`, by name.
fn checkpoints(folder: &Path) -> Vec<PathBuf> {
    let mut found = entries(folder);
    found.retain(|entry| entry.join(CHECKPOINT_FILE).is_file());
    found
}

fn entries(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    paths
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::{PolicyChoice, Setup, tasks};

    #[test]
    fn each_committed_policy_is_the_only_one_of_its_task() {
        let root = Path::new("../../config/policies");
        let names: Vec<&str> = tasks::names().collect();
        let committed = super::tasks(root);
        assert!(committed.contains(&"needle-lift".to_owned()));
        for task in committed {
            assert!(names.contains(&task.as_str()), "{task}");
            let policy = PolicyChoice::Checkpoint(recommended_in(root, &task).unwrap());
            let setup = Setup::load(&task, None, &policy).unwrap();
            assert_eq!(setup.transfer_note(), None, "{task}");
        }
    }

    #[test]
    fn a_task_without_a_policy_or_with_two_is_refused() {
        let root = std::env::temp_dir().join(format!("trocar-policies-{}", std::process::id()));
        let _absent = fs::remove_dir_all(&root);
        let refusal = |task: &str| {
            let error = recommended_in(&root, task).unwrap_err();
            assert!(error.is_bad_input());
            error.to_string()
        };
        assert!(refusal("lift").contains("beside the program"));
        fs::create_dir_all(root.join("lift/notes")).unwrap();
        assert!(refusal("lift").contains("no task has one"));
        for policy in ["lift/act", "sew/act", "sew/dp3"] {
            fs::create_dir_all(root.join(policy)).unwrap();
            fs::write(root.join(policy).join(CHECKPOINT_FILE), "{}").unwrap();
        }
        assert_eq!(
            recommended_in(&root, "lift").unwrap(),
            root.join("lift/act")
        );
        assert!(refusal("sew").contains("has 2 policies"));
        let refused = refusal("cut");
        assert!(
            refused.contains("task cut has no committed policy")
                && refused.contains("there is one for lift, sew"),
            "{refused}"
        );
        fs::remove_dir_all(&root).unwrap();
    }
}
