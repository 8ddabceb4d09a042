//! The results of a study, from one folder or the folders of its shards.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use serde::Deserialize;

use super::statistics::Score;
use crate::study::StudyError;
use crate::study::address::Address;
use crate::study::job::Kind;
use crate::study::plan::StudyRecord;
use crate::study::store::{Manifest, State, Store};

/// One trial, as `eval` reports it.
#[derive(Clone, Debug, Deserialize)]
pub struct Trial {
    /// Its seed.
    pub seed: u64,
    /// Whether the task was done.
    pub success: bool,
    /// Whether the simulation left its bounds, so that the trial says nothing about the policy.
    #[serde(default)]
    pub invalid: bool,
    /// Why it ended.
    pub reason: String,
    /// Simulated time, s.
    pub seconds: f64,
    /// Hash of its commands.
    pub command_hash: String,
    /// Its log, if that was kept.
    #[serde(default)]
    pub log: Option<PathBuf>,
    /// Its animation, if that was kept.
    #[serde(default)]
    pub pictures: Option<PathBuf>,
}

impl Trial {
    /// Whether it was lost, and counts.
    #[must_use]
    pub const fn is_lost(&self) -> bool {
        !self.success && !self.invalid
    }
}

/// A cell that is done.
#[derive(Clone, Debug)]
pub struct Made {
    /// What made it.
    pub manifest: Manifest,
    /// Its folder.
    pub folder: PathBuf,
}

/// An evaluation.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// Its cell.
    pub made: Made,
    /// Its trials.
    pub trials: Vec<Trial>,
}

impl Evaluation {
    /// Its trials by how they ended.
    #[must_use]
    pub fn score(&self) -> Score {
        let mut score = Score::default();
        for trial in &self.trials {
            score.invalid += usize::from(trial.invalid);
            score.trials += usize::from(!trial.invalid);
            score.successes += usize::from(trial.success && !trial.invalid);
        }
        score
    }
}

/// A row of a training's `loss.csv`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LossRow {
    /// Optimiser step.
    pub step: f64,
    /// Total loss.
    pub loss: f64,
}

/// A training.
#[derive(Clone, Debug)]
pub struct Training {
    /// Its cell.
    pub made: Made,
    /// Its curve.
    pub curve: Vec<LossRow>,
}

/// Everything that there is.
#[derive(Clone, Debug)]
pub struct Results {
    /// The study.
    pub study: StudyRecord,
    /// Evaluations that are done.
    pub evaluations: BTreeMap<Address, Evaluation>,
    /// Trainings that are done.
    pub trainings: BTreeMap<Address, Training>,
    /// Recordings that are done.
    pub recordings: BTreeMap<Address, Made>,
    /// What is not what was written, with the reason.
    pub damaged: Vec<String>,
}

/// Of `eval --json` what a report needs; other keys are passed over.
#[derive(Deserialize)]
struct EvalFile {
    episodes: Vec<Trial>,
}

impl Results {
    /// Reads the results in `folders`.
    ///
    /// # Errors
    /// [`StudyError`] if one of them is no study's, or of another grid than the first.
    pub fn read(folders: &[PathBuf]) -> Result<Self, StudyError> {
        let (study, stores) = open(folders)?;
        let mut results = Self {
            study,
            evaluations: BTreeMap::new(),
            trainings: BTreeMap::new(),
            recordings: BTreeMap::new(),
            damaged: Vec::new(),
        };
        for (address, cell) in results.study.cells.clone() {
            results.cell(&stores, cell.kind, &address);
        }
        Ok(results)
    }

    /// Reads a cell from the first store in which it is whole.
    fn cell(&mut self, stores: &[Store], kind: Kind, address: &Address) {
        let mut reasons = Vec::new();
        for store in stores {
            let manifest = match store.state(kind, address) {
                State::Done(manifest) | State::Bare(manifest) => *manifest,
                State::Damaged(reason) => {
                    reasons.push(reason);
                    continue;
                }
                State::Missing | State::Begun => continue,
            };
            let folder = store.cell(kind, address);
            match self.take(kind, Made { manifest, folder }) {
                Ok(()) => return,
                Err(reason) => reasons.push(reason),
            }
        }
        self.damaged.extend(reasons);
    }

    /// Adds a cell that is whole. Of a training a curve that is missing or can't be read is empty;
    /// of an evaluation a result that can't be read is damage, and the next store is tried.
    fn take(&mut self, kind: Kind, made: Made) -> Result<(), String> {
        let address = made.manifest.address.clone();
        match kind {
            Kind::Recording => {
                self.recordings.insert(address, made);
            }
            Kind::Training => {
                let curve = read_curve(&made.folder.join("checkpoint/loss.csv"));
                self.trainings.insert(address, Training { made, curve });
            }
            Kind::Evaluation => {
                let path = made.folder.join("result.json");
                let in_file =
                    |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
                let text = fs::read_to_string(&path).map_err(|error| in_file(&error))?;
                let read: EvalFile =
                    serde_json::from_str(&text).map_err(|error| in_file(&error))?;
                let trials = read.episodes;
                self.evaluations
                    .insert(address, Evaluation { made, trials });
            }
        }
        Ok(())
    }

    /// Evaluations in the order of their first place in a grid.
    #[must_use]
    pub fn in_order(&self) -> Vec<(&Address, &Evaluation)> {
        let mut seen = std::collections::BTreeSet::new();
        let entries = self.study.entries.iter().map(|entry| &entry.evaluation);
        let new = entries.filter(|address| seen.insert((*address).clone()));
        new.filter_map(|address| Some((address, self.evaluations.get(address)?)))
            .collect()
    }
}

/// Steps and losses of `loss.csv`; what can't be read is left out.
fn read_curve(path: &Path) -> Vec<LossRow> {
    let text = fs::read_to_string(path).unwrap_or_default();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap_or_default().split(',').collect();
    let column = |name: &str| names.iter().position(|found| found.trim() == name);
    let (Some(step), Some(loss)) = (column("step"), column("loss")) else {
        return Vec::new();
    };
    let rows = lines.filter_map(|line| {
        let values: Vec<&str> = line.split(',').collect();
        let number = |index: usize| values.get(index)?.trim().parse::<f64>().ok();
        let row = LossRow {
            step: number(step)?,
            loss: number(loss)?,
        };
        (row.loss.is_finite() && row.loss > 0.0).then_some(row)
    });
    rows.collect()
}

/// Names both folders and both studies, since it is a folder that was given by mistake.
fn other_grid(
    (study, folder): (&StudyRecord, &Path),
    (known, other): (&StudyRecord, &Path),
) -> StudyError {
    StudyError::BadArgument(format!(
        "{} is of grid {} ({}), and {} of grid {} ({}): only shards of one grid make one report",
        folder.display(),
        study.grid.short(),
        study.title,
        other.display(),
        known.grid.short(),
        known.title
    ))
}

/// The study in `folders`, whose grid is one, with the store in each.
fn open(folders: &[PathBuf]) -> Result<(StudyRecord, Vec<Store>), StudyError> {
    let mut stores = Vec::new();
    let mut first: Option<(StudyRecord, &Path)> = None;
    for folder in folders {
        let store = Store::new(folder.clone());
        let study = store.study()?.ok_or_else(|| {
            StudyError::BadArgument(format!(
                "{}: has no study.json: it is no folder of `trocar study`",
                folder.display()
            ))
        })?;
        match &first {
            None => first = Some((study, folder)),
            Some((known, _)) if known.grid == study.grid => {}
            Some((known, other)) => {
                return Err(other_grid((&study, folder), (known, other)));
            }
        }
        stores.push(store);
    }
    let Some((study, _)) = first else {
        return Err(StudyError::BadArgument("no folder to report".to_owned()));
    };
    Ok((study, stores))
}
