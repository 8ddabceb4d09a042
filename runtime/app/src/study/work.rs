//! A cell's work: from what it begins, with which command line, and what makes it done.

use std::ffi::OsString;
use std::fs;
use std::path::{Path, PathBuf};

use super::address::Address;
use super::child::Ended;
use super::commands::{Abilities, Arguments, Begin, CommandLine, Places, command_line};
use super::file::{ExecutionSection, StudyFile};
use super::job::{EvaluationJob, Job, Kind, PolicyInput};
use super::plan::Cell;
use super::store::{Attempts, EXECUTED, MANIFEST_FORMAT, Manifest, Store};
use super::{StudyError, result};
use crate::session::outputs;

/// The state that a training which is not at its end keeps in its checkpoint's folder.
const TRAINING_STATE: &str = "training_state.safetensors";

/// What all cells of a run have in common.
#[derive(Debug)]
pub struct Workshop<'a> {
    /// The study's folder.
    pub store: &'a Store,
    /// The study's file.
    pub file: &'a StudyFile,
    /// The program.
    pub executable: PathBuf,
    /// Its hash.
    pub executable_sha256: String,
    /// The machine's name.
    pub host: String,
    /// What its verbs can do.
    pub abilities: Abilities,
}

/// How a cell is begun.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Start {
    /// Its verb has done everything; only the manifest is missing.
    Found,
    /// With this command line.
    Run(Arguments, Begin),
}

/// What a cell took.
#[derive(Clone, Debug)]
pub struct Took {
    /// The command line.
    pub command: Vec<String>,
    /// The GPU.
    pub gpu: Option<String>,
    /// All attempts.
    pub attempts: Attempts,
    /// How the verb ended; none if it was found ended.
    pub ended: Option<Ended>,
    /// Greatest memory on the GPU, bytes.
    pub gpu_memory_bytes: Option<u64>,
}

impl Workshop<'_> {
    /// Checks with `line` that every cell's command line is one.
    ///
    /// # Errors
    /// [`StudyError::BadCell`] with the parser's reason.
    pub fn check(
        &self,
        cells: &[Cell],
        path: &str,
        line: &dyn CommandLine,
    ) -> Result<(), StudyError> {
        for cell in cells {
            let places = self.places(cell);
            let job = &cell.job;
            let arguments = command_line(job, &places, &self.file.run, Begin::New, self.abilities);
            line.check(arguments.as_slice())
                .map_err(|reason| StudyError::BadCell {
                    path: path.to_owned(),
                    cell: format!("{} {}", job.kind().as_str(), cell.label),
                    reason,
                })?;
        }
        Ok(())
    }

    /// Where a cell's files are while it is made.
    fn places(&self, cell: &Cell) -> Places {
        let (kind, address) = (cell.job.kind(), &cell.address);
        let folder = self.store.cell(kind, address);
        Places {
            product: match kind {
                Kind::Recording => folder.join("data.part"),
                Kind::Training | Kind::Evaluation => self.store.product(kind, address),
            },
            result: self.store.result(kind, address),
            input: self.input(&cell.job, &folder),
        }
    }

    fn input(&self, job: &Job, folder: &Path) -> Option<PathBuf> {
        match job {
            Job::Recording(_) => None,
            Job::Training(job) => Some(self.store.product(Kind::Recording, &job.recording)),
            Job::Evaluation(job) if job.execution.changes_checkpoint() => {
                Some(folder.join(EXECUTED))
            }
            Job::Evaluation(job) => self.checkpoint(&job.policy),
        }
    }

    fn checkpoint(&self, policy: &PolicyInput) -> Option<PathBuf> {
        match policy {
            PolicyInput::Training(address) => Some(self.store.product(Kind::Training, address)),
            PolicyInput::Checkpoint { folder, .. } => Some(folder.clone()),
            PolicyInput::Named(_) => None,
        }
    }

    /// How the recording of `cell` in `product` is begun; none if it is there, `whole`.
    fn begin_recording(
        &self,
        cell: &Cell,
        product: &Path,
        whole: bool,
    ) -> Result<Option<Begin>, StudyError> {
        let done = self.store.product(Kind::Recording, &cell.address);
        if whole && (done.exists() || product.exists()) {
            return Ok(None);
        }
        // More demonstrations than there are: what is there is their beginning.
        let folder = self.store.cell(Kind::Recording, &cell.address);
        remove(&folder.join("cell.json"))?;
        if done.exists() && !product.exists() {
            rename(&done, product)?;
        }
        let resumes = self.abilities.record_resume && outputs::has_recording(product);
        Ok(Some(if resumes { Begin::Resumed } else { Begin::New }))
    }

    /// Writes the checkpoint of `job` with its execution mode into `policy`.
    fn change_execution(&self, job: &EvaluationJob, policy: &Path) -> Result<(), StudyError> {
        let Some(from) = self.checkpoint(&job.policy) else {
            return Ok(());
        };
        remove(policy)?;
        executed_otherwise(&from, policy, &job.execution)
    }

    /// Makes a cell ready to be begun or resumed. The caller holds its lock.
    ///
    /// # Errors
    /// What failed.
    pub fn prepare(&self, cell: &Cell) -> Result<Start, StudyError> {
        let places = self.places(cell);
        let folder = self.store.cell(cell.job.kind(), &cell.address);
        let whole = result::check(&cell.job, &places.result).is_ok();
        let interrupted = places.product.join(TRAINING_STATE).is_file();
        let begin = match &cell.job {
            Job::Recording(_) => match self.begin_recording(cell, &places.product, whole)? {
                Some(begin) => begin,
                None => return Ok(Start::Found),
            },
            Job::Training(_) if interrupted => Begin::Resumed,
            Job::Training(_) if whole => return Ok(Start::Found),
            Job::Evaluation(_) if whole => return Ok(Start::Found),
            Job::Training(_) | Job::Evaluation(_) => Begin::New,
        };
        remove(&places.result)?;
        if begin == Begin::New {
            remove(&places.product)?;
        }
        if let Job::Evaluation(job) = &cell.job
            && job.execution.changes_checkpoint()
        {
            self.change_execution(job, &folder.join(EXECUTED))?;
        }
        let arguments = command_line(&cell.job, &places, &self.file.run, begin, self.abilities);
        Ok(Start::Run(arguments, begin))
    }

    /// Takes away what a resumed training or recording can't go on from, so that it begins anew.
    ///
    /// # Errors
    /// [`StudyError::Io`].
    pub fn forget_product(&self, cell: &Cell) -> Result<(), StudyError> {
        remove(&self.places(cell).product)
    }

    /// Removes the data of a done recording; what says that it is done stays. The caller holds its
    /// lock.
    ///
    /// # Errors
    /// [`StudyError::Io`].
    pub fn drop_recording(&self, address: &Address) -> Result<(), StudyError> {
        remove(&self.store.product(Kind::Recording, address))
    }

    /// Checks what a verb has made, and writes what makes the cell done.
    ///
    /// # Errors
    /// What is wrong with it.
    pub fn finish(&self, cell: &Cell, took: Took) -> Result<Manifest, String> {
        let places = self.places(cell);
        let weights_sha256 = result::check(&cell.job, &places.result)?;
        if let Job::Recording(_) = &cell.job
            && places.product.exists()
        {
            let done = self.store.product(Kind::Recording, &cell.address);
            remove(&done).map_err(|error| error.to_string())?;
            rename(&places.product, &done).map_err(|error| error.to_string())?;
        }
        let recipe = cell.job.recipe().map_err(|error| error.to_string())?;
        let manifest = Manifest {
            weights_sha256,
            ..self.manifest(cell, recipe, took)
        };
        let finished = self.store.finish(cell.job.kind(), manifest.clone());
        finished.map_err(|error| error.to_string())?;
        Ok(manifest)
    }

    /// The manifest of a cell, without what its files tell.
    fn manifest(&self, cell: &Cell, recipe: serde_json::Value, took: Took) -> Manifest {
        let episodes = match &cell.job {
            Job::Recording(job) => Some(job.episodes),
            Job::Training(_) | Job::Evaluation(_) => None,
        };
        Manifest {
            format: MANIFEST_FORMAT,
            address: cell.address.clone(),
            label: cell.label.clone(),
            recipe,
            command: took.command,
            executable_sha256: self.executable_sha256.clone(),
            host: self.host.clone(),
            gpu: took.gpu,
            seconds: took.attempts.seconds,
            memory_bytes: took.ended.and_then(|ended| ended.memory_bytes),
            gpu_memory_bytes: took.gpu_memory_bytes,
            attempts: took.attempts.count,
            episodes,
            weights_sha256: None,
            files: Vec::new(),
        }
    }
}

/// A command line as text.
#[must_use]
pub fn texts(arguments: &[OsString]) -> Vec<String> {
    let text = |argument: &OsString| argument.to_string_lossy().into_owned();
    arguments.iter().map(text).collect()
}

/// A checkpoint like the one in `from` whose chunks are executed as `execution` says: its files by
/// link, but for `trocar.json`.
fn executed_otherwise(
    from: &Path,
    to: &Path,
    execution: &ExecutionSection,
) -> Result<(), StudyError> {
    let recipe = trocar_nets::checkpoint::load_recipe(from);
    let recipe = recipe.map_err(|error| StudyError::io(from, error))?;
    let Some(mut recipe) = recipe else {
        let reason = "has no trocar.json, in which an execution mode could be changed";
        return Err(StudyError::io(from, reason));
    };
    if let Some(mode) = execution.mode {
        recipe.aggregation.mode = mode;
    }
    if let Some(decay) = execution.decay {
        recipe.aggregation.decay = decay;
    }
    if let Some(steps) = execution.query_every_steps {
        recipe.query_every_steps = steps;
    }
    link_files(from, to)?;
    super::files::write_json(&to.join("trocar.json"), &recipe)
}

/// Links every file in the checkpoint `from` into the new folder `to`, but for `trocar.json`.
fn link_files(from: &Path, to: &Path) -> Result<(), StudyError> {
    let failed = |error: std::io::Error| StudyError::io(to, error);
    fs::create_dir_all(to).map_err(failed)?;
    let whole = from
        .canonicalize()
        .map_err(|error| StudyError::io(from, error))?;
    for entry in fs::read_dir(&whole).map_err(failed)? {
        let entry = entry.map_err(failed)?;
        if entry.file_name() != "trocar.json" {
            let link = to.join(entry.file_name());
            std::os::unix::fs::symlink(entry.path(), link).map_err(failed)?;
        }
    }
    Ok(())
}

fn rename(from: &Path, to: &Path) -> Result<(), StudyError> {
    fs::rename(from, to).map_err(|error| StudyError::io(from, error))
}

/// Takes away a file or a folder, if it is there.
fn remove(path: &Path) -> Result<(), StudyError> {
    let gone = match fs::symlink_metadata(path) {
        Err(error) => Err(error),
        Ok(found) if found.is_dir() => fs::remove_dir_all(path),
        Ok(_) => fs::remove_file(path),
    };
    match gone {
        Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
            Err(StudyError::io(path, error))
        }
        Err(_) | Ok(()) => Ok(()),
    }
}
