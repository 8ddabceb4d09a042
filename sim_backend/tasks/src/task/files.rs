//! A task's files: a folder with `scene.toml` and `safety.toml`, whose name is the task's.
//!
//! The folders of `config/tasks/` are built in, found by `build.rs`. Any other folder is a task as
//! well, given its path.

use std::path::{MAIN_SEPARATOR, Path};
use std::sync::LazyLock;

use hal::config::{ConfigError, Source};
use serde::Deserialize;

use super::TaskConfig;
use super::common::TitleFile;

/// The scene, in a task's folder.
pub const SCENE_FILE: &str = "scene.toml";

/// The limits, in a task's folder.
pub const SAFETY_FILE: &str = "safety.toml";

/// Longest name of a task, bytes: it must find room in what processes tell each other, and in file
/// names.
const NAME_BYTES_MAX: usize = 64;

/// A task that is built into the program.
struct BuiltIn {
    name: &'static str,
    scene: &'static str,
    safety: &'static str,
}

/// The built-in tasks by name.
const BUILT_IN: &[BuiltIn] = include!(concat!(env!("OUT_DIR"), "/tasks.rs"));

/// Their names in the order of their scene files.
static NAMES: LazyLock<Vec<&'static str>> = LazyLock::new(|| {
    let mut names: Vec<_> = BUILT_IN
        .iter()
        .map(|task| (task.order(), task.name))
        .collect();
    names.sort_unstable();
    names.into_iter().map(|(_, name)| name).collect()
});

/// What a task consists of.
#[derive(Clone, Debug)]
pub struct TaskFiles {
    /// The name by which results, logs and datasets know the task.
    pub name: String,
    /// What is there, and what counts as success.
    pub scene: Source,
    /// Workspace and forbidden regions. Handed on to the controller, never read here.
    pub safety: Source,
}

/// Why there is no such task.
#[derive(Debug, thiserror::Error)]
pub enum TaskError {
    /// Neither a name nor a path.
    #[error(
        "there is no task {asked:?}; there are {}, and any folder with {SCENE_FILE} and {SAFETY_FILE}, given its path",
        known.join(", ")
    )]
    Unknown {
        /// The requested one.
        asked: String,
        /// Names of the built-in tasks.
        known: Vec<&'static str>,
    },
    /// The path leads to no folder.
    #[error("task {path}: there is no such folder")]
    NoFolder {
        /// The path.
        path: String,
    },
    /// The folder's name can't be a task's.
    #[error(
        "task {path}: the folder's name is the task's, which is 1 to {NAME_BYTES_MAX} plain letters, digits, - and _"
    )]
    BadName {
        /// The path.
        path: String,
    },
    /// The folder is called like a built-in task and is another one: results would be taken for
    /// that one's.
    #[error(
        "task {path}: {file} is not that of the built-in task of this name; a task of its own needs a folder of another name"
    )]
    NameTaken {
        /// The path.
        path: String,
        /// The file that differs.
        file: &'static str,
    },
    /// A file is missing or wrong.
    #[error(transparent)]
    Config(#[from] ConfigError),
}

impl TaskError {
    pub(super) fn unknown(asked: &str) -> Self {
        Self::Unknown {
            asked: asked.to_owned(),
            known: names().collect(),
        }
    }
}

/// The part of a scene file that every kind has.
#[derive(Deserialize)]
struct Heading {
    task: TitleFile,
}

/// The title, kind and description in the scene file `source`.
pub(super) fn title(source: &Source) -> Result<TitleFile, ConfigError> {
    source.parse().map(|heading: Heading| heading.task)
}

impl BuiltIn {
    /// The place in lists. Errors of the file are reported when the task is loaded.
    fn order(&self) -> u32 {
        let order = title(&self.files().scene)
            .ok()
            .and_then(|title| title.order);
        order.unwrap_or(u32::MAX)
    }

    fn files(&self) -> TaskFiles {
        let source =
            |file, text| Source::embedded(&format!("config/tasks/{}/{file}", self.name), text);
        TaskFiles {
            name: self.name.to_owned(),
            scene: source(SCENE_FILE, self.scene),
            safety: source(SAFETY_FILE, self.safety),
        }
    }
}

/// Names of the built-in tasks.
pub(super) fn names() -> impl Iterator<Item = &'static str> {
    NAMES.iter().copied()
}

impl TaskFiles {
    /// The built-in task `name`; none if there is no such task.
    #[must_use]
    pub fn built_in(name: &str) -> Option<Self> {
        let task = BUILT_IN.iter().find(|task| task.name == name)?;
        Some(task.files())
    }

    /// The task that `asked` stands for: the name of a built-in one, or the path of a folder.
    ///
    /// # Errors
    /// [`TaskError`], with the known names if it is neither.
    pub fn find(asked: &str) -> Result<Self, TaskError> {
        if let Some(files) = Self::built_in(asked) {
            return Ok(files);
        }
        let path = Path::new(asked);
        if path.is_dir() || asked.contains(MAIN_SEPARATOR) {
            return Self::read(path);
        }
        Err(TaskError::unknown(asked))
    }

    /// The task in `folder`.
    ///
    /// # Errors
    /// [`TaskError`], naming the folder or the file.
    pub fn read(folder: &Path) -> Result<Self, TaskError> {
        let path = folder.display().to_string();
        // The whole path has a name where "." has none.
        let whole = match folder.canonicalize() {
            Ok(whole) if whole.is_dir() => whole,
            Ok(_) | Err(_) => return Err(TaskError::NoFolder { path }),
        };
        let name = whole.file_name().and_then(|name| name.to_str());
        let Some(name) = name.filter(|name| is_name(name)) else {
            return Err(TaskError::BadName { path });
        };
        let source = |file| Source::read(&folder.join(file).display().to_string());
        let files = Self {
            name: name.to_owned(),
            scene: source(SCENE_FILE)?,
            safety: source(SAFETY_FILE)?,
        };
        match files.differs_from_built_in() {
            Some(file) => Err(TaskError::NameTaken { path, file }),
            None => Ok(files),
        }
    }

    /// The file that is another one than that of the built-in task of the same name, if there is
    /// such a task.
    fn differs_from_built_in(&self) -> Option<&'static str> {
        let built_in = Self::built_in(&self.name)?;
        let pairs = [
            (SCENE_FILE, &self.scene, &built_in.scene),
            (SAFETY_FILE, &self.safety, &built_in.safety),
        ];
        let mut differing = pairs
            .into_iter()
            .filter(|(_, own, shipped)| own.text() != shipped.text());
        differing.next().map(|(file, ..)| file)
    }

    /// The task, checked.
    ///
    /// # Errors
    /// [`ConfigError`], naming line, key and allowed range.
    pub fn config(&self) -> Result<TaskConfig, ConfigError> {
        TaskConfig::parse(&self.name, &self.scene)
    }
}

fn is_name(name: &str) -> bool {
    let letters = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
    (1..=NAME_BYTES_MAX).contains(&name.len()) && name.chars().all(letters)
}

#[cfg(test)]
mod tests;
