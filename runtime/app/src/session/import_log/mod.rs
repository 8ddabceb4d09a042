//! Run logs into a dataset: each log is an episode, of a robot or simulated.
//!
//! ```text
//! log ── images: when each was taken ──> grid: a frame of each camera a step ─┐
//!     └─ ticks: who drives, measured arms, targets, ENABLED ──────────────────┴─> episode ──> images once more ──> dataset
//! ```
//!
//! A step's instant is the stamp of a frame of the first camera. What the arms measured, and the
//! target that the aggregated chunks had then, are those of the tick nearest to it. An episode
//! begins with the first target of ENABLED arms and ends with the state ENABLED.
//!
//! Logs are read in order and never whole in memory: of the first two passes the numbers of steps
//! stay, the third decodes a frame at a time. All logs are judged before anything is written.

mod copy;
mod episode;
mod error;
mod frames;
mod grid;
mod ticks;

#[cfg(test)]
mod tests;

use std::path::PathBuf;

use serde::Serialize;
use serde_json::json;
use trocar_data::dataset::{CameraSpec, DatasetSpec, DatasetWriter, VideoCodec};
use trocar_data::import::robot_type;

use super::SessionError;
use episode::{Found, LoggedEpisode};
pub use error::LogImportError;

/// Which logs, and what becomes of them.
#[derive(Clone, Debug)]
pub struct LogImportOptions {
    /// The logs, an episode each, in this order.
    pub logs: Vec<PathBuf>,
    /// The dataset's folder; a new or an empty one.
    pub out: PathBuf,
    /// What every episode shows, in words.
    pub task: String,
    /// Steps a second.
    pub fps: u32,
    /// The cameras, that whose frames are the steps first; all that the first log has if empty.
    pub cameras: Vec<String>,
    /// Width and height that images are brought to, pixels; as they are if not given.
    pub size: Option<(u32, u32)>,
    /// Keep colour as video.
    pub video: Option<VideoCodec>,
    /// Take runs whose task was not done, or which their operator called a failure, too.
    pub failures: bool,
}

/// What was imported.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct LogImportSummary {
    /// Arms of the robot.
    pub arms: usize,
    /// The cameras, in the dataset's order.
    pub cameras: Vec<String>,
    /// Episodes in the dataset.
    pub episodes: usize,
    /// Frames in them.
    pub frames: usize,
    /// Frames in which an operator drove, who had taken over from a policy.
    pub by_hand: usize,
    /// Runs that were left out because their task was not done.
    pub left_out: usize,
    /// The logs of runs that were left out because their operator discarded them.
    pub discarded: Vec<PathBuf>,
}

/// Writes the logs of `options` as a dataset. After each that is written `done` gets the number of
/// episodes so far and of all.
///
/// # Errors
/// A [`LogImportError`] that names the log and what helps, before anything is written but for an
/// image that can't be decoded; [`SessionError::Log`] for a file that is no log or damaged;
/// [`SessionError::Dataset`] if the dataset can't be written.
pub fn import_logs(
    options: &LogImportOptions,
    done: &mut dyn FnMut(usize, usize),
) -> Result<LogImportSummary, SessionError> {
    let Survey {
        episodes,
        cameras,
        left_out,
        discarded,
    } = survey(options)?;
    let arms = episodes.first().map_or(0, |episode| episode.arms);
    let spec = DatasetSpec {
        fps: options.fps,
        robot_type: robot_type(arms).to_owned(),
        arms,
        task: options.task.clone(),
        cameras,
        intervention: episodes.iter().any(|episode| episode.by_hand() > 0),
    };
    let mut writer = DatasetWriter::create_with(&options.out, &spec, options.video)?;
    writer.describe(described(&episodes))?;
    for (index, episode) in episodes.iter().enumerate() {
        copy::copy(episode, &spec.cameras, options.size, &mut writer)?;
        writer.end_episode_with(episode.note.clone())?;
        done(index + 1, episodes.len());
    }
    let totals = writer.finish()?;
    Ok(LogImportSummary {
        arms,
        cameras: spec.cameras.into_iter().map(|camera| camera.name).collect(),
        episodes: totals.episodes,
        frames: totals.frames,
        by_hand: episodes.iter().map(LoggedEpisode::by_hand).sum(),
        left_out,
        discarded,
    })
}

/// What the logs hold.
struct Survey {
    episodes: Vec<LoggedEpisode>,
    cameras: Vec<CameraSpec>,
    left_out: usize,
    discarded: Vec<PathBuf>,
}

/// Looks at every log; all must be of the same arms and cameras.
fn survey(options: &LogImportOptions) -> Result<Survey, SessionError> {
    let mut names = options.cameras.clone();
    let mut episodes: Vec<LoggedEpisode> = Vec::new();
    let (mut left_out, mut discarded) = (0, Vec::new());
    for log in &options.logs {
        let episode = match LoggedEpisode::read(log, options, &names)? {
            Found::Episode(episode) => *episode,
            Found::Undone => {
                left_out += 1;
                continue;
            }
            Found::Discarded => {
                discarded.push(log.clone());
                continue;
            }
        };
        if let Some(first) = episodes.first()
            && first.shape() != episode.shape()
        {
            return Err(LogImportError::Differs {
                log: log.clone(),
                found: episode.described(),
                expected: first.described(),
            }
            .into());
        }
        if names.is_empty() {
            names = episode.camera_names();
        }
        episodes.push(episode);
    }
    let Some(first) = episodes.first() else {
        return Err(match left_out {
            0 => LogImportError::Discarded {
                count: options.logs.len(),
            },
            count => LogImportError::Failures { count },
        }
        .into());
    };
    let cameras = first.cameras.clone();
    Ok(Survey {
        episodes,
        cameras,
        left_out,
        discarded,
    })
}

/// What is said of the dataset as a whole: of one simulated task its name, by which trials of it
/// are found.
fn described(episodes: &[LoggedEpisode]) -> serde_json::Value {
    let mut note = json!({"trocar": env!("CARGO_PKG_VERSION"), "source": SOURCE});
    let mut tasks = episodes.iter().map(|episode| episode.task.as_str());
    let first = tasks.next().filter(|task| !task.is_empty());
    if let Some(task) = first.filter(|first| tasks.all(|task| task == *first)) {
        note["task"] = task.into();
    }
    note
}

/// Where the demonstrations come from, as the dataset says it.
const SOURCE: &str = "log";
