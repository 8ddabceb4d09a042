//! What verbs report, as far as a study looks at it.

use std::path::Path;

use serde::Deserialize;

use super::job::Job;

#[derive(Deserialize)]
struct Recorded {
    episodes: usize,
}

#[derive(Deserialize)]
struct Trained {
    steps: u64,
}

#[derive(Deserialize)]
struct Evaluated {
    trials: usize,
    successes: usize,
    episodes: Vec<Trial>,
    #[serde(default)]
    weights_sha256: Option<String>,
}

#[derive(Deserialize)]
struct Trial {
    seed: u64,
}

/// Checks that the result at `path` is what `job` asked for; gives the hash of the weights that it is of, if it tells.
///
/// # Errors
/// What is wrong with it.
pub(super) fn check(job: &Job, path: &Path) -> Result<Option<String>, String> {
    let in_file = |error: &dyn std::fmt::Display| format!("{}: {error}", path.display());
    let text = std::fs::read_to_string(path).map_err(|error| in_file(&error))?;
    match job {
        Job::Recording(job) => {
            let found: Recorded = serde_json::from_str(&text).map_err(|error| in_file(&error))?;
            // A training takes the first ones.
            if found.episodes < job.episodes {
                let (found, asked) = (found.episodes, job.episodes);
                return Err(in_file(&format!(
                    "{found} demonstrations in place of {asked}"
                )));
            }
        }
        Job::Training(job) => {
            let found: Trained = serde_json::from_str(&text).map_err(|error| in_file(&error))?;
            if job.steps.is_some_and(|steps| steps != found.steps) {
                return Err(in_file(&format!(
                    "{} steps in place of {:?}",
                    found.steps, job.steps
                )));
            }
        }
        Job::Evaluation(job) => {
            let found: Evaluated = serde_json::from_str(&text).map_err(|error| in_file(&error))?;
            let seeds = (0..job.trials as u64).map(|index| job.first_seed.wrapping_add(index));
            if !found.episodes.iter().map(|trial| trial.seed).eq(seeds) || found.trials > job.trials
            {
                let (found, asked) = (found.episodes.len(), job.trials);
                return Err(in_file(&format!(
                    "{found} trials in place of {asked}, or other seeds"
                )));
            }
            if found.successes > found.trials {
                return Err(in_file(&"more successes than trials"));
            }
            return Ok(found.weights_sha256);
        }
    }
    Ok(None)
}
