//! A study from its file to its end: what `trocar study` does.
//!
//! The way of a study: `file` reads it, `materials` hashes what it names, `expand` makes the cells,
//! `scenes` and `work` check them, `run` makes them; `store` is the folder that all of that is in.

use std::path::{Path, PathBuf};

use super::commands::{Abilities, CommandLine};
use super::estimate::{Class, Durations, Left, in_words, time_left};
use super::file::StudyFile;
use super::job::{Job, Kind};
use super::materials::{Materials, code_of};
use super::plan::{Cell, Plan, Shard};
use super::run::{self, Outcome};
use super::schedule::{Machine, ResourceRequest, at_a_time};
use super::store::{State, Store};
use super::work::Workshop;
use super::{StudyError, expand, scenes};

/// What `trocar study` is asked for.
#[derive(Clone, Debug)]
pub struct Options {
    /// The study's file.
    pub file: PathBuf,
    /// The study's folder.
    pub out: PathBuf,
    /// The part of it that is run here.
    pub shard: Option<Shard>,
    /// What stands for the program in addresses, in place of its hash.
    pub code: Option<String>,
    /// The program.
    pub executable: PathBuf,
    /// What the machine has.
    pub machine: Machine,
}

/// A study that was read and checked.
#[derive(Debug)]
pub struct Study {
    /// As it was read; keys of it stand in errors.
    file: StudyFile,
    plan: Plan,
    /// Its folder, which need not exist before the first run.
    store: Store,
    options: Options,
    /// What the program's own command line can do, found once.
    abilities: Abilities,
}

impl Study {
    /// Reads and checks a study, without making anything. `line` is the parser of the program that
    /// cells are run by. It hashes the executable and all files that the study names, so that it
    /// takes as long as reading these.
    ///
    /// # Errors
    /// [`StudyError`], naming what is wrong.
    pub fn open(options: Options, line: &dyn CommandLine) -> Result<Self, StudyError> {
        let (file, source) = StudyFile::read(&options.file)?;
        let code = code_of(&options.executable, options.code.as_deref())?;
        let materials = Materials::gather(&file, &options.file, code)?;
        let plan = expand(&file, source.text(), &materials)?;
        scenes::check(&plan.cells, &materials.path)?;
        let store = Store::new(options.out.clone());
        let study = Self {
            abilities: Abilities::of(line),
            file,
            plan,
            store,
            options,
        };
        study
            .workshop(String::new())
            .check(&study.plan.cells, &materials.path, line)?;
        study.check_folder()?;
        Ok(study)
    }

    /// Shards of one grid belong together; a whole study may take the place of an earlier one,
    /// whose cells it shares.
    ///
    /// # Errors
    /// `OtherGrid` if this is a shard, and the folder holds a study of another grid.
    fn check_folder(&self) -> Result<(), StudyError> {
        let (Some(there), Some(_)) = (self.store.study()?, self.options.shard) else {
            return Ok(());
        };
        if there.grid == self.plan.record.grid {
            return Ok(());
        }
        Err(StudyError::OtherGrid {
            folder: self.store.root().to_owned(),
            there: there.grid.to_string(),
            title: there.title,
            here: self.plan.record.grid.to_string(),
        })
    }

    /// `executable_sha256` may be empty where nothing is made: only manifests have it.
    fn workshop(&self, executable_sha256: String) -> Workshop<'_> {
        Workshop {
            store: &self.store,
            file: &self.file,
            executable: self.options.executable.clone(),
            executable_sha256,
            host: host(),
            abilities: self.abilities,
        }
    }

    /// Every cell of the part with how it stands. Nothing is locked or written: another
    /// process may work in the folder meanwhile. The last line has the sums and an estimate of the
    /// time, from what the cells that are done took.
    #[must_use]
    pub fn list(&self) -> Vec<String> {
        let part = self.plan.part(self.options.shard);
        let mut lines = Vec::new();
        let mut durations = Durations::default();
        let mut left = Vec::new();
        let (mut done, mut begun, mut damaged) = (0, 0, 0);
        let cells = self.plan.cells.iter();
        let of_part: Vec<&Cell> = cells.filter(|cell| part.contains(&cell.address)).collect();
        for &cell in &of_part {
            let (kind, address) = (cell.job.kind(), &cell.address);
            let class = Class::of(&cell.job);
            let state = match self.store.state(kind, address) {
                State::Done(manifest) if is_enough(&cell.job, manifest.episodes) => {
                    durations.add(class, manifest.seconds);
                    done += 1;
                    lines.push(line(kind, address.short(), &cell.label, "done"));
                    continue;
                }
                State::Bare(manifest)
                    if is_enough(&cell.job, manifest.episodes)
                        && !self.store.is_wanted(cell, &of_part) =>
                {
                    durations.add(class, manifest.seconds);
                    done += 1;
                    let state = "done, without what it made";
                    lines.push(line(kind, address.short(), &cell.label, state));
                    continue;
                }
                State::Damaged(reason) => {
                    damaged += 1;
                    format!("damaged: {reason}")
                }
                State::Done(manifest) => {
                    format!(
                        "to do: has {} demonstrations",
                        manifest.episodes.unwrap_or(0)
                    )
                }
                State::Bare(_) => "to do again: what it made is gone and needed".to_owned(),
                State::Begun => {
                    begun += 1;
                    "begun".to_owned()
                }
                State::Missing => "to do".to_owned(),
            };
            lines.push(line(kind, address.short(), &cell.label, &state));
            let need = ResourceRequest::of(&cell.job, &self.file, self.options.machine.cores);
            #[expect(clippy::cast_precision_loss, reason = "a few hundred at most")]
            let at_a_time = at_a_time(need, &self.options.machine) as f64;
            left.push(Left {
                class,
                ran: 0.0,
                at_a_time,
            });
        }
        let (seconds, whole) = time_left(&left, &durations);
        let time = match (left.is_empty(), whole) {
            (true, _) => String::new(),
            (false, true) => format!("; about {}", in_words(seconds)),
            (false, false) => {
                "; how long it takes is known once a cell of each kind is done".to_owned()
            }
        };
        let (cells, left) = (lines.len(), left.len());
        lines.push(format!(
            "grid {}: {cells} cells, {done} done, {left} left ({begun} begun, {damaged} damaged){time}",
            self.plan.record.grid.short()
        ));
        lines
    }

    /// Runs the part. `say` hears of each cell that begins or ends, a line each. A signal ends it
    /// in order: what runs is asked to end and keeps its state.
    ///
    /// # Errors
    /// [`StudyError`] if a cell needs a GPU and there is none, or the study's folder can't be used.
    pub fn run(&self, say: &mut dyn FnMut(&str)) -> Result<Outcome, StudyError> {
        let part = self.plan.part(self.options.shard);
        let mut cells = self.plan.cells.iter();
        let on_gpu = cells.find(|cell| part.contains(&cell.address) && cell.job.on_gpu());
        if let (Some(cell), true) = (on_gpu, self.options.machine.gpus.is_empty()) {
            return Err(StudyError::BadCell {
                path: self.options.file.display().to_string(),
                cell: format!("{} {}", cell.job.kind().as_str(), cell.label),
                reason:
                    "device = \"cuda\": this libtorch sees no CUDA device, and --gpus names none"
                        .to_owned(),
            });
        }
        self.store.keep_study(&self.plan.record)?;
        let executable = &self.options.executable;
        let hash = crate::digest::hash_file(executable);
        let hash = hash.map_err(|error| StudyError::io(executable, error))?;
        run::run(
            &self.plan,
            &part,
            &self.workshop(hash),
            &self.options.machine,
            say,
        )
    }
}

/// Whether a recording that is done has as many demonstrations as this study asks for; another
/// study in the same folder may have asked for fewer. Anything else is done or not.
fn is_enough(job: &Job, episodes: Option<usize>) -> bool {
    match (job, episodes) {
        (Job::Recording(job), Some(episodes)) => episodes >= job.episodes,
        (Job::Recording(_) | Job::Training(_) | Job::Evaluation(_), _) => true,
    }
}

/// A line of `list`: kind, short address, label, state.
fn line(kind: Kind, address: &str, label: &str, state: &str) -> String {
    format!("{:<10} {address}  {label}: {state}", kind.as_str())
}

/// The machine's name.
fn host() -> String {
    let name = std::fs::read_to_string("/proc/sys/kernel/hostname");
    name.map_or_else(|_| "unknown".to_owned(), |name| name.trim().to_owned())
}

/// The folder of the study in `file`, if none is named.
#[must_use]
pub fn default_folder(file: &Path) -> PathBuf {
    let stem = file
        .file_stem()
        .map_or_else(|| "study".into(), |stem| stem.to_owned());
    Path::new("runs").join(stem)
}
