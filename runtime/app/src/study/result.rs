//! What verbs report, as far as a study looks at it. A verb may have been killed, or another
//! version of it may have written the file: only a result that is of this very job makes a cell
//! done. Other keys are passed over.

use std::path::Path;

use serde::Deserialize;

use super::job::{EvaluationJob, Job, RecordingJob, TrainingJob};

/// `record --json`: how many demonstrations were kept.
#[derive(Deserialize)]
struct Recorded {
    episodes: usize,
}

/// `train --json`: the optimiser's steps, which a resumed training has in all.
#[derive(Deserialize)]
struct Trained {
    steps: u64,
}

/// `eval --json`: valid trials, their successes, and every trial in order.
#[derive(Deserialize)]
struct Evaluated {
    trials: usize,
    successes: usize,
    episodes: Vec<Trial>,
    #[serde(default)]
    weights_sha256: Option<String>,
}

/// One trial, by whose seed it is known that none is missing and none is of another run.
#[derive(Deserialize)]
struct Trial {
    seed: u64,
}

impl Recorded {
    /// # Errors
    /// Fewer demonstrations than asked for; more are the recording of a cell that asked for more.
    fn check(&self, job: &RecordingJob) -> Result<(), String> {
        let (found, asked) = (self.episodes, job.episodes);
        // A training takes the first ones.
        if found < asked {
            return Err(format!("{found} demonstrations in place of {asked}"));
        }
        Ok(())
    }
}

impl Trained {
    /// # Errors
    /// Other steps than asked for. Without a number in the study's file the network's own is not
    /// known here, and passes.
    fn check(&self, job: &TrainingJob) -> Result<(), String> {
        if job.steps.is_some_and(|steps| steps != self.steps) {
            return Err(format!("{} steps in place of {:?}", self.steps, job.steps));
        }
        Ok(())
    }
}

impl Evaluated {
    /// # Errors
    /// Trials whose seeds are not exactly those asked for, or counts that contradict each other. An
    /// invalid trial has a seed and is not counted in `trials`, which may therefore be fewer.
    fn check(&self, job: &EvaluationJob) -> Result<(), String> {
        let seeds = (0..job.trials as u64).map(|index| job.first_seed.wrapping_add(index));
        if !self.episodes.iter().map(|trial| trial.seed).eq(seeds) || self.trials > job.trials {
            let (found, asked) = (self.episodes.len(), job.trials);
            return Err(format!(
                "{found} trials in place of {asked}, or other seeds"
            ));
        }
        if self.successes > self.trials {
            return Err("more successes than trials".to_owned());
        }
        Ok(())
    }
}

/// Checks that the result at `path` is what `job` asked for; gives the hash of the weights that it
/// is of, if it reports one.
///
/// # Errors
/// What is wrong with it.
pub(super) fn check(job: &Job, path: &Path) -> Result<Option<String>, String> {
    let in_file = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let text = std::fs::read_to_string(path).map_err(|error| in_file(&error))?;
    match job {
        Job::Recording(job) => {
            let found: Recorded = serde_json::from_str(&text).map_err(|error| in_file(&error))?;
            found.check(job).map_err(|defect| in_file(&defect))?;
        }
        Job::Training(job) => {
            let found: Trained = serde_json::from_str(&text).map_err(|error| in_file(&error))?;
            found.check(job).map_err(|defect| in_file(&defect))?;
        }
        Job::Evaluation(job) => {
            let found: Evaluated = serde_json::from_str(&text).map_err(|error| in_file(&error))?;
            found.check(job).map_err(|defect| in_file(&defect))?;
            return Ok(found.weights_sha256);
        }
    }
    Ok(None)
}
