//! A study's folder: a folder a cell, with what made it, what it is, and whether it is whole.
//!
//! ```text
//! DIR/study.json                      the grid and its tables
//! DIR/recording/ADDRESS/cell.json     written last, when the cell is done: its recipe, its files, what it took
//!                       result.json   what the verb reported
//!                       log.txt       what the verb said
//!                       data/         the dataset; of a training checkpoint/, of an evaluation kept/
//!                       lock          held while a process works on the cell
//! ```

use std::fs::{self, File, OpenOptions, TryLockError};
use std::path::{Path, PathBuf};

use serde::{Deserialize, Serialize};

use super::StudyError;
use super::address::Address;
use super::files::{FileRecord, difference, files_of, write_json};
use super::job::Kind;
use super::plan::{Cell, STUDY_FORMAT, StudyRecord};

/// `cell.json`: a cell that is done.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Manifest {
    /// Version of this form.
    pub format: u32,
    /// Its address.
    pub address: Address,
    /// What it is, for people.
    pub label: String,
    /// Everything that its address is of.
    pub recipe: serde_json::Value,
    /// The command line.
    pub command: Vec<String>,
    /// The executable's hash, of which an address may know no more than a label.
    pub executable_sha256: String,
    /// The machine.
    pub host: String,
    /// The GPU that it was given, if any.
    pub gpu: Option<String>,
    /// Time that the verb took, all attempts together, s.
    pub seconds: f64,
    /// Greatest memory of the process, bytes.
    pub memory_bytes: Option<u64>,
    /// Greatest memory of the process on its GPU, bytes.
    pub gpu_memory_bytes: Option<u64>,
    /// Attempts that it took.
    pub attempts: u32,
    /// Demonstrations, of a recording.
    pub episodes: Option<usize>,
    /// SHA-256 of the weights that were evaluated, of an evaluation that reports it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub weights_sha256: Option<String>,
    /// Its files.
    pub files: Vec<FileRecord>,
}

/// [`Manifest::format`] of this program.
pub const MANIFEST_FORMAT: u32 = 1;

/// How a cell stands.
#[derive(Clone, Debug, PartialEq)]
pub enum State {
    /// Nothing is there.
    Missing,
    /// It was begun and not ended.
    Begun,
    /// It is done.
    Done(Box<Manifest>),
    /// It is done, and some of what it made (a dataset, weights, logs) is not here any more; its
    /// result is.
    Bare(Box<Manifest>),
    /// Something is there that is not what was written.
    Damaged(String),
}

/// The folder of a study.
#[derive(Clone, Debug)]
pub struct Store {
    root: PathBuf,
}

/// What was done to a cell before it was done: kept beside it, so that time adds up over attempts.
#[derive(Clone, Copy, Debug, Default, Serialize, Deserialize)]
pub struct Attempts {
    /// How many.
    pub count: u32,
    /// Time that they took, s.
    pub seconds: f64,
}

/// What says that a cell is done, and where it lies while the cell is made anew.
const ASIDE: [(&str, &str); 2] = [
    ("cell.json", "cell.json.old"),
    ("result.json", "result.json.old"),
];

/// The folder, below its own, of what a cell makes.
const fn product_name(kind: Kind) -> &'static str {
    match kind {
        Kind::Recording => "data",
        Kind::Training => "checkpoint",
        Kind::Evaluation => "kept",
    }
}

/// The folder, below its own, of the checkpoint that an evaluation executes otherwise than it says
/// of itself.
pub const EXECUTED: &str = "policy";

impl Store {
    /// The folder `root`.
    #[must_use]
    pub const fn new(root: PathBuf) -> Self {
        Self { root }
    }

    /// The folder.
    #[must_use]
    pub fn root(&self) -> &Path {
        &self.root
    }

    /// The folder of a cell.
    #[must_use]
    pub fn cell(&self, kind: Kind, address: &Address) -> PathBuf {
        self.root.join(kind.as_str()).join(address.as_str())
    }

    /// Where a cell keeps what it is.
    #[must_use]
    pub fn product(&self, kind: Kind, address: &Address) -> PathBuf {
        self.cell(kind, address).join(product_name(kind))
    }

    /// Where a cell keeps its verb's result.
    #[must_use]
    pub fn result(&self, kind: Kind, address: &Address) -> PathBuf {
        self.cell(kind, address).join("result.json")
    }

    /// How a cell stands. Of its files only lengths and times are looked at, and contents where the
    /// time is another.
    #[must_use]
    pub fn state(&self, kind: Kind, address: &Address) -> State {
        let folder = self.cell(kind, address);
        let read = match manifest(&folder, address) {
            Ok(read) => read,
            Err(state) => return state,
        };
        let kept_apart = [product_name(kind), EXECUTED];
        let is_gone = |file: &&FileRecord| {
            kept_apart.iter().any(|name| file.path.starts_with(name))
                && !folder.join(&file.path).exists()
        };
        let here = read.files.iter().filter(|file| !is_gone(file));
        match here.into_iter().find_map(|file| difference(&folder, file)) {
            Some(difference) => State::Damaged(difference),
            None if read.files.iter().any(|file| is_gone(&file)) => State::Bare(Box::new(read)),
            None => State::Done(Box::new(read)),
        }
    }

    /// Whether what `cell` made is needed by another one of `cells` that is to be made.
    #[must_use]
    pub fn is_wanted(&self, cell: &Cell, cells: &[&Cell]) -> bool {
        let needing = cells
            .iter()
            .filter(|other| other.job.inputs().contains(&cell.address));
        needing
            .into_iter()
            .any(|other| match self.state(other.job.kind(), &other.address) {
                State::Done(_) | State::Damaged(_) => false,
                State::Bare(_) => self.is_wanted(other, cells),
                State::Missing | State::Begun => true,
            })
    }

    /// Lays what says that a cell is done aside, so that it is made anew; until it is,
    /// [`Self::put_back`] undoes it. The caller holds its lock.
    ///
    /// # Errors
    /// [`StudyError::Io`].
    pub fn set_aside(&self, kind: Kind, address: &Address) -> Result<(), StudyError> {
        let folder = self.cell(kind, address);
        // What says that it is done goes first and comes back last.
        for (name, aside) in ASIDE {
            let from = folder.join(name);
            fs::rename(&from, folder.join(aside)).map_err(|error| StudyError::io(&from, error))?;
        }
        Ok(())
    }

    /// Lays what was laid aside back in its place, unless the cell was made anew meanwhile, or what
    /// it makes is there in part: that is resumed. The caller holds its lock.
    ///
    /// # Errors
    /// [`StudyError::Io`].
    pub fn put_back(&self, kind: Kind, address: &Address) -> Result<(), StudyError> {
        let folder = self.cell(kind, address);
        if folder.join("cell.json").exists() || self.product(kind, address).exists() {
            return Ok(());
        }
        for (name, aside) in ASIDE.into_iter().rev() {
            let from = folder.join(aside);
            match fs::rename(&from, folder.join(name)) {
                Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                    return Err(StudyError::io(&from, error));
                }
                Err(_) | Ok(()) => {}
            }
        }
        Ok(())
    }

    /// Takes a cell's lock, if no other process has it.
    ///
    /// # Errors
    /// [`StudyError::Io`].
    pub fn lock(&self, kind: Kind, address: &Address) -> Result<Option<File>, StudyError> {
        let file = self.lock_file(kind, address)?;
        let path = self.cell(kind, address);
        match file.try_lock() {
            Ok(()) => Ok(Some(file)),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) => Err(StudyError::io(&path, error)),
        }
    }

    /// Takes part in a cell's lock, beside others who only read it, if no process changes it.
    ///
    /// # Errors
    /// [`StudyError::Io`].
    pub fn lock_to_read(&self, kind: Kind, address: &Address) -> Result<Option<File>, StudyError> {
        let file = self.lock_file(kind, address)?;
        let path = self.cell(kind, address);
        match file.try_lock_shared() {
            Ok(()) => Ok(Some(file)),
            Err(TryLockError::WouldBlock) => Ok(None),
            Err(TryLockError::Error(error)) => Err(StudyError::io(&path, error)),
        }
    }

    fn lock_file(&self, kind: Kind, address: &Address) -> Result<File, StudyError> {
        let folder = self.cell(kind, address);
        fs::create_dir_all(&folder).map_err(|error| StudyError::io(&folder, error))?;
        let path = folder.join("lock");
        let mut options = OpenOptions::new();
        let opened = options
            .create(true)
            .truncate(false)
            .read(true)
            .write(true)
            .open(&path);
        opened.map_err(|error| StudyError::io(&path, error))
    }

    /// What was done to a cell so far.
    #[must_use]
    pub fn attempts(&self, kind: Kind, address: &Address) -> Attempts {
        let text = fs::read_to_string(self.cell(kind, address).join("attempts.json"));
        let read = text.ok().and_then(|text| serde_json::from_str(&text).ok());
        read.unwrap_or_default()
    }

    /// Keeps what was done to a cell so far.
    ///
    /// # Errors
    /// [`StudyError::Io`].
    pub fn keep_attempts(
        &self,
        kind: Kind,
        address: &Address,
        attempts: Attempts,
    ) -> Result<(), StudyError> {
        write_json(&self.cell(kind, address).join("attempts.json"), &attempts)
    }

    /// Writes what makes a cell done.
    ///
    /// # Errors
    /// [`StudyError::Io`].
    pub fn finish(&self, kind: Kind, mut manifest: Manifest) -> Result<(), StudyError> {
        let folder = self.cell(kind, &manifest.address);
        manifest.files = files_of(&folder)?;
        write_json(&folder.join("cell.json"), &manifest)?;
        for (_, aside) in ASIDE {
            // What is left of it means nothing beside the new one.
            let _gone = fs::remove_file(folder.join(aside));
        }
        Ok(())
    }

    /// What the folder remembers of its study, if there is one.
    ///
    /// # Errors
    /// [`StudyError::Damaged`] or [`StudyError::Io`].
    pub fn study(&self) -> Result<Option<StudyRecord>, StudyError> {
        let path = self.root.join("study.json");
        let text = match fs::read_to_string(&path) {
            Ok(text) => text,
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => return Ok(None),
            Err(error) => return Err(StudyError::io(&path, error)),
        };
        let damaged = |reason: String| StudyError::Damaged {
            path: path.clone(),
            reason,
            remedy: "`trocar study` writes it anew once it is moved away",
        };
        let read: StudyRecord = serde_json::from_str(&text)
            .map_err(|error| damaged(format!("cut off or changed: {error}")))?;
        if read.format != STUDY_FORMAT {
            return Err(damaged(format!(
                "format {} is not this program's",
                read.format
            )));
        }
        Ok(Some(read))
    }

    /// Remembers the study.
    ///
    /// # Errors
    /// [`StudyError::Io`].
    pub fn keep_study(&self, record: &StudyRecord) -> Result<(), StudyError> {
        write_json(&self.root.join("study.json"), record)
    }
}

/// The manifest of the cell at `address` in `folder`, or how the cell stands that has none.
fn manifest(folder: &Path, address: &Address) -> Result<Manifest, State> {
    let path = folder.join("cell.json");
    let damaged = |reason: String| State::Damaged(format!("{}: {reason}", path.display()));
    let text = match fs::read_to_string(&path) {
        Ok(text) => text,
        Err(error) if error.kind() == std::io::ErrorKind::NotFound => {
            let begun = folder.join("attempts.json").exists();
            return Err(if begun { State::Begun } else { State::Missing });
        }
        Err(error) => return Err(damaged(error.to_string())),
    };
    let read: Manifest = serde_json::from_str(&text)
        .map_err(|error| damaged(format!("cut off or changed: {error}")))?;
    if read.format != MANIFEST_FORMAT || read.address != *address {
        return Err(damaged(format!("is of cell {}", read.address)));
    }
    Ok(read)
}
