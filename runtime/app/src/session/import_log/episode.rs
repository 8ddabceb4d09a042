//! A log as an episode: its steps with all their numbers, and where their images are.

use std::path::{Path, PathBuf};

use serde_json::{Value, json};
use trocar_data::dataset::CameraSpec;
use trocar_log::{LogEnd, RunHeader, RunMark, RunOutcome, Step, read_steps};

use super::frames::LoggedCamera;
use super::grid::SeenStep;
use super::ticks::{Row, Ticks};
use super::{LogImportError, LogImportOptions, SOURCE};
use crate::session::PolicyChoice;

/// An episode before its images are read.
#[derive(Debug)]
pub(super) struct LoggedEpisode {
    pub(super) log: PathBuf,
    /// The simulated task; empty of a robot.
    pub(super) task: String,
    pub(super) arms: usize,
    /// The cameras as the dataset has them.
    pub(super) cameras: Vec<CameraSpec>,
    pub(super) steps: Vec<(SeenStep, Row)>,
    /// What the dataset says of it.
    pub(super) note: Value,
}

/// What a log is to a dataset.
#[derive(Debug)]
pub(super) enum Found {
    /// An episode.
    Episode(Box<LoggedEpisode>),
    /// A run that failed or had a fault.
    Undone,
    /// A run that its operator discarded.
    Discarded,
}

impl LoggedEpisode {
    /// Reads `log`, of which the cameras called `names` are wanted, or all. A run that failed or
    /// had a fault is none unless `options` take it; one that was discarded never is.
    ///
    /// # Errors
    /// See [`super::import_logs`].
    pub(super) fn read(
        log: &Path,
        options: &LogImportOptions,
        names: &[String],
    ) -> Result<Found, LogImportError> {
        let found = LoggedCamera::all(log)?;
        let all: Vec<String> = found.iter().map(|camera| camera.name.clone()).collect();
        // What else is wrong with the log comes first.
        let (cameras, absent) = match LoggedCamera::chosen(log, found, names) {
            Ok(cameras) => (cameras, None),
            Err(error) => (Vec::new(), Some(error)),
        };
        let mut ticks = Ticks::new(log, &cameras, options.fps);
        let mut arms = 0;
        let (header, end) = read_steps(log, |_: &RunHeader, step: &Step<'_>| {
            arms = step.tick.arms.count();
            ticks.take(step)
        })?;
        let outcome = whole(log, end)?;
        if outcome.said.mark == Some(RunMark::Discard) {
            return Ok(Found::Discarded);
        }
        let judged = !header.task.is_empty();
        let undone = judged && outcome.success != Some(true);
        let failed = undone || outcome.said.mark == Some(RunMark::Failure);
        if (failed || ticks.faulted) && !options.failures {
            return Ok(Found::Undone);
        }
        let (grid, rows, ended) = ticks.finish()?;
        if let Some(error) = absent {
            return Err(error);
        }
        if options.cameras.is_empty() && all.len() != cameras.len() {
            return Err(more_cameras(log, arms, &all, names));
        }
        if options.size.is_none() {
            cameras.iter().try_for_each(|it| it.check_size(log))?;
        }
        let steps = grid.whole(log, ended)?;
        let spec = |camera: &LoggedCamera| {
            let (width, height) = options.size.unwrap_or(camera.size);
            CameraSpec {
                name: camera.name.clone(),
                width,
                height,
                depth: None,
            }
        };
        Ok(Found::Episode(Box::new(Self {
            log: log.to_owned(),
            cameras: cameras.iter().map(spec).collect(),
            arms,
            steps: steps.into_iter().zip(rows).collect(),
            note: note(log, &header, &outcome)?,
            task: header.task,
        })))
    }

    /// What all episodes of a dataset have alike.
    pub(super) fn shape(&self) -> (usize, &[CameraSpec]) {
        (self.arms, &self.cameras)
    }

    /// The same in words.
    pub(super) fn described(&self) -> String {
        let cameras = self.cameras.iter();
        let cameras = cameras.map(|it| format!("{} ({} x {})", it.name, it.width, it.height));
        described(self.arms, &cameras.collect::<Vec<_>>())
    }

    pub(super) fn camera_names(&self) -> Vec<String> {
        self.cameras
            .iter()
            .map(|camera| camera.name.clone())
            .collect()
    }

    /// Steps in which an operator drove.
    pub(super) fn by_hand(&self) -> usize {
        self.steps.iter().filter(|(_, row)| row.by_hand).count()
    }
}

/// Arms and cameras in words.
fn described(arms: usize, cameras: &[String]) -> String {
    let arms = if arms == 1 { "one arm" } else { "two arms" };
    format!("{arms} and the cameras {}", cameras.join(", "))
}

/// The error of a log that has more cameras than the first one.
fn more_cameras(log: &Path, arms: usize, found: &[String], names: &[String]) -> LogImportError {
    LogImportError::Differs {
        log: log.to_owned(),
        found: described(arms, found),
        expected: format!("the cameras {}", names.join(", ")),
    }
}

/// How the run ended, if the log holds all of it and it is known what its operator said of it.
pub(super) fn whole(log: &Path, end: LogEnd) -> Result<RunOutcome, LogImportError> {
    let log = log.to_owned();
    match (end.cut, end.outcome) {
        (Some(reason), _) if end.bounded => Err(LogImportError::Bounded { log, reason }),
        (Some(reason), _) => Err(LogImportError::Cut { log, reason }),
        (None, _) if end.altered => Err(LogImportError::Altered { log }),
        (None, None) => Err(LogImportError::Cut {
            log,
            reason: "it does not say how its run ended".to_owned(),
        }),
        (None, Some(outcome)) => match end.unknown_mark {
            Some(mark) => Err(LogImportError::Mark { log, mark }),
            None => Ok(outcome),
        },
    }
}

/// What an operator's hands did in the run, if they drove.
fn teleop(log: &Path, outcome: &RunOutcome) -> Result<Option<Value>, LogImportError> {
    let Some(text) = &outcome.teleop else {
        return Ok(None);
    };
    match serde_json::from_str(text) {
        Ok(teleop @ Value::Object(_)) => Ok(Some(teleop)),
        Ok(_) | Err(_) => Err(LogImportError::Teleop {
            log: log.to_owned(),
            text: text.clone(),
        }),
    }
}

/// Who demonstrated: an operator's hands alone, hands that took over from a policy; the log itself
/// if it does not say so.
fn source(header: &RunHeader, teleop: Option<&Value>) -> &'static str {
    match teleop {
        Some(_) if header.policy == PolicyChoice::Teleop.name() => "teleop",
        Some(_) => "intervention",
        None => SOURCE,
    }
}

/// How the episode came about.
fn note(log: &Path, header: &RunHeader, outcome: &RunOutcome) -> Result<Value, LogImportError> {
    let teleop = teleop(log, outcome)?;
    let mut note = json!({
        "source": source(header, teleop.as_ref()),
        "log": log.file_name().map(|name| name.to_string_lossy()),
        "policy": header.policy,
        "reason": outcome.reason,
        "command_hash": outcome.command_hash,
    });
    if let Some(success) = outcome.success {
        note["success"] = success.into();
    }
    if let Some(mark) = outcome.said.mark {
        note["success"] = (mark == RunMark::Success).into();
        note["ended_by"] = "operator".into();
    }
    if !outcome.said.label.is_empty() {
        note["label"] = outcome.said.label.as_str().into();
    }
    if let Some(teleop) = teleop {
        note["teleop"] = teleop;
    }
    if !header.task.is_empty() {
        note["task"] = header.task.as_str().into();
        note["seed"] = header.seed.into();
    }
    let versions = [("commit", "commit"), ("policy_sha256", "weights_sha256")];
    for (key, version) in versions {
        if let Some(version) = header.versions.get(version) {
            note[key] = version.as_str().into();
        }
    }
    Ok(note)
}
