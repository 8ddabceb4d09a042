//! What the files behind a study contain, as hashes: what they were when a cell was made is part of
//! its address.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use hal::config::Source;
use trocar_tasks::task::patient_file;

use super::StudyError;
use super::file::{PolicyKind, StudyFile};
use super::job::TaskInput;
use crate::digest::{hash_file, hash_text};
use crate::session::tasks;
use trocar_control::ControlConfig;

/// The clouds that networks are trained on where no other file is named.
const CLOUDS: &str = include_str!("../../../../config/clouds.toml");

/// Hashes of everything that a study is made of.
#[derive(Clone, Debug)]
pub struct Materials {
    /// The study's file.
    pub path: String,
    /// Its folder: paths in the file begin there.
    pub folder: PathBuf,
    /// The program: see [`code_of`].
    pub code: String,
    /// The study's tasks by name.
    pub tasks: BTreeMap<String, TaskInput>,
    /// Hashes of checkpoints by the networks' names.
    pub checkpoints: BTreeMap<String, (String, PathBuf)>,
}

/// What stands for the program in addresses: its version, the network library's, and the hash of
/// the executable at `executable`. Whoever knows better gives a `label`, which takes the place of
/// all that.
///
/// # Errors
/// [`StudyError::Io`].
pub fn code_of(executable: &Path, label: Option<&str>) -> Result<String, StudyError> {
    if let Some(label) = label {
        return Ok(format!("label {label}"));
    }
    let hash = hash_file(executable).map_err(|error| StudyError::io(executable, error))?;
    Ok(format!(
        "trocar {} {}, libtorch {}",
        env!("CARGO_PKG_VERSION"),
        hash.get(..16).unwrap_or(&hash),
        crate::session::run::LIBTORCH_VERSION
    ))
}

impl Materials {
    /// Reads what `file` at `path` names.
    ///
    /// # Errors
    /// [`StudyError::BadCell`] naming the task or the network, or [`StudyError::Io`].
    pub fn gather(file: &StudyFile, path: &Path, code: String) -> Result<Self, StudyError> {
        let folder = path.parent().unwrap_or_else(|| Path::new("")).to_owned();
        let mut materials = Self {
            path: path.display().to_string(),
            folder,
            code,
            tasks: BTreeMap::new(),
            checkpoints: BTreeMap::new(),
        };
        for name in file.task.keys() {
            let task = materials.task(file, name)?;
            materials.tasks.insert(name.clone(), task);
        }
        for (name, network) in &file.network {
            let Some(checkpoint) = &network.checkpoint else {
                continue;
            };
            if network.policy == PolicyKind::Checkpoint {
                let hashed = materials.checkpoint(name, checkpoint)?;
                materials.checkpoints.insert(name.clone(), hashed);
            }
        }
        Ok(materials)
    }

    /// Hash and folder of the checkpoint of network `name`.
    fn checkpoint(&self, name: &str, checkpoint: &str) -> Result<(String, PathBuf), StudyError> {
        let folder = self.folder.join(checkpoint);
        let hash = hash_folder(&folder).map_err(|error| {
            let reason = format!("{}: {error}", folder.display());
            self.bad(&format!("network.{name}.checkpoint"), reason)
        })?;
        Ok((hash, folder))
    }

    /// The error of `cell`.
    #[must_use]
    pub fn bad(&self, cell: &str, reason: impl Into<String>) -> StudyError {
        StudyError::BadCell {
            path: self.path.clone(),
            cell: cell.to_owned(),
            reason: reason.into(),
        }
    }

    fn task(&self, file: &StudyFile, name: &str) -> Result<TaskInput, StudyError> {
        let section = file.task.get(name).cloned().unwrap_or_default();
        let asked = section.task.unwrap_or_else(|| name.to_owned());
        let is_path = asked.contains('/');
        let argument = if is_path {
            self.folder.join(&asked).display().to_string()
        } else {
            asked
        };
        let key = format!("task.{name}");
        let files = tasks::files(&argument).map_err(|error| self.bad(&key, error.to_string()))?;
        let scene = section.scene.map(|scene| self.folder.join(scene));
        Ok(TaskInput {
            task: files.name,
            scene_sha256: self.scene_hash(&key, files.scene, scene.as_deref())?,
            safety_sha256: hash_text(files.safety.text()),
            control_sha256: hash_text(ControlConfig::default_control().text()),
            argument,
            scene,
        })
    }

    /// Hash of the scene in the file `other`, or of the task's `own`. A scene with a patient is
    /// another one with another patient.
    fn scene_hash(
        &self,
        key: &str,
        own: Source,
        other: Option<&Path>,
    ) -> Result<String, StudyError> {
        let scene_sha256 = match other {
            None => hash_text(own.text()),
            Some(path) => hash_file(path).map_err(|error| {
                let reason = format!("scene {}: {error}", path.display());
                self.bad(key, reason)
            })?,
        };
        let text = other.map_or(Ok(own), |path| Source::read(&path.display().to_string()));
        let text = text.map_err(|error| self.bad(key, error.to_string()))?;
        let Some(patient) = patient_file(&text) else {
            return Ok(scene_sha256);
        };
        let patient = hash_file(&patient).map_err(|error| StudyError::io(&patient, error))?;
        Ok(hash_text(&format!("{scene_sha256} {patient}")))
    }

    /// Hashes of the files that `options` name, of those that are there.
    ///
    /// # Errors
    /// [`StudyError::Io`].
    pub fn files(&self, options: &[String]) -> Result<BTreeMap<String, String>, StudyError> {
        let mut files = BTreeMap::new();
        for option in options {
            let value = option
                .split_once('=')
                .map_or(option.as_str(), |(_, value)| value);
            let path = Path::new(value);
            let hash = if value.starts_with("--") || !path.exists() {
                continue;
            } else if path.is_dir() {
                hash_folder(path)
            } else {
                hash_file(path)
            };
            let hash = hash.map_err(|error| StudyError::io(path, error))?;
            files.insert(value.to_owned(), hash);
        }
        Ok(files)
    }

    /// The clouds of a network that learns from them, unless its options name others.
    #[must_use]
    pub fn clouds(&self, options: &[String]) -> Option<(String, String)> {
        let named = options.iter().any(|option| option.starts_with("--clouds"));
        (!named).then(|| ("config/clouds.toml".to_owned(), hash_text(CLOUDS)))
    }
}

/// Hash over the files in `folder`, by name.
fn hash_folder(folder: &Path) -> std::io::Result<String> {
    let mut hashes = BTreeMap::new();
    for entry in std::fs::read_dir(folder)? {
        let entry = entry?;
        if entry.file_type()?.is_file() {
            let name = entry.file_name().to_string_lossy().into_owned();
            hashes.insert(name, hash_file(&entry.path())?);
        }
    }
    if hashes.is_empty() {
        return Err(std::io::Error::other("the folder is empty"));
    }
    Ok(hash_text(&format!("{hashes:?}")))
}
