//! A dataset of this robot in Open-H-Embodiment's form: LeRobot's v2.1 layout with the names of its
//! dVRK datasets.
//!
//! ```text
//! meta/info.json             robot_type dvrk, features, splits; written last
//! meta/episodes.jsonl        an episode a line: number, tasks, frames
//! meta/episodes_stats.jsonl  min, max, mean and standard deviation of each
//! meta/tasks.jsonl           the instructions
//! meta/README.md             what is known of the recording, and lines to be filled in
//! data/chunk-000/episode_000000.parquet
//! videos/chunk-000/FEATURE/episode_000000.mp4
//! ```
//!
//! States are each arm's measured tip pose (m, unit quaternion x, y, z, w) and jaw (rad), actions
//! its absolute set-point, both in the arm's RCM frame; psm1's eight numbers, then psm2's; one arm
//! is psm1. Joint positions come along as `observation.state.joint_positions`. Depth and instance
//! ids stay behind.
//!
//! Splits are ranges of episodes, so episodes without a disturbance come first, then those that
//! recover from one; `val` and `test` are the first of them, `train` is the rest. Failures come
//! last, and are in no split but `failure`.
//!
//! Open-H-Embodiment fixes names and folders for each robot; its validator and LeRobot 0.3.3 are
//! what this is tested against, in `tests/scripts/open_h.py`. The way back is `import_mapped` with
//! the mapping `open-h-dvrk`.

mod episode;
mod names;
mod readme;
mod splits;
#[cfg(test)]
mod tests;

use std::fs;
use std::path::{Path, PathBuf};

use serde::Serialize;
use serde_json::{Value, json};

use crate::dataset::store::{io_error, write_json, write_lines, write_text};
use crate::dataset::{Dataset, DatasetError, Notes, VideoCodec};

pub use self::readme::Provenance;

use self::episode::write_episode;
use self::names::{cameras, features};
use self::splits::Splits;

/// The version of the layout.
const VERSION: &str = "v2.1";
/// Episodes that a folder may hold.
const CHUNK_SIZE: usize = 1000;
/// Frames a second that Open-H-Embodiment wants at least.
const FPS_MIN: u32 = 20;
/// Lines and columns that it wants a picture to have at least.
const SIDE_MIN: u32 = 480;

/// What to export, to where.
#[derive(Clone, Debug)]
pub struct ExportOptions {
    /// The dataset's folder.
    pub dataset: PathBuf,
    /// The folder of a dataset of attempts that failed, which come along as the split `failure`.
    pub failures: Option<PathBuf>,
    /// The new one's; it must not exist or be empty. After an error it holds what was written so
    /// far, without `info.json`.
    pub out: PathBuf,
    /// What the demonstrations show in words; what the dataset says if not given.
    pub instruction: Option<String>,
    /// The instrument of each arm; the last one holds for the rest.
    pub tools: Vec<String>,
    /// How colour is compressed.
    pub video: VideoCodec,
    /// How the demonstrations came about, for `meta/README.md`.
    pub provenance: Provenance,
}

/// What was exported.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExportSummary {
    /// Arms of the robot.
    pub arms: usize,
    /// The cameras' features.
    pub cameras: Vec<String>,
    /// Episodes.
    pub episodes: usize,
    /// Frames in them.
    pub frames: usize,
    /// Ranges of episodes, by name. As `FROM:TO`, the end excluded, in the exported numbering.
    pub splits: std::collections::BTreeMap<String, String>,
    /// What Open-H-Embodiment advises against. The dataset is written all the same.
    pub warnings: Vec<String>,
}

/// Writes `options.dataset` as `options.out`. After each episode `done` gets the number of episodes
/// so far and of all.
///
/// # Errors
/// A [`DatasetError`]: a dataset that can't be read or has no camera, a folder that is not empty,
/// sides that video can't have, ffmpeg.
pub fn export_open_h(
    options: &ExportOptions,
    done: &mut dyn FnMut(usize, usize),
) -> Result<ExportSummary, DatasetError> {
    let (dataset, notes) = read(options)?;
    let source = Source::new(options, &dataset, &notes)?;
    new_folder(&options.out)?;
    let mut lines = Lines::default();
    for (index, &episode) in source.splits.order.iter().enumerate() {
        let stats = write_episode(&source, index, episode, lines.frames)?;
        lines.add(&source, index, episode, stats);
        done(index + 1, source.splits.order.len());
    }
    finish(&source, &lines)
}

/// The note of a failed episode: marked as such, with `words` for an instruction if it has none.
fn failure_note(notes: &Notes, episode: usize, words: &str) -> Value {
    let note = note_of(notes, episode).cloned();
    let mut note = note.unwrap_or_else(|| json!({}));
    if !splits::is_failure(&note) {
        note["failure"] = true.into();
    }
    if note["instruction"].as_str().is_none_or(str::is_empty) {
        note["instruction"] = words.into();
    }
    note
}

/// The dataset with its notes; if there are failures, they follow as its last episodes, and the
/// notes say so. Both must have the same arms, rate and cameras, as [`Dataset::open_joined`]
/// demands.
fn read(options: &ExportOptions) -> Result<(Dataset, Notes), DatasetError> {
    let mut notes = Notes::read(&options.dataset)?;
    let Some(failures) = &options.failures else {
        return Ok((Dataset::open(&options.dataset)?, notes));
    };
    let dirs = [options.dataset.clone(), failures.clone()];
    let dataset = Dataset::open_joined(&dirs, None, None, false)?;
    let of_failures = Notes::read(failures)?;
    let words = Dataset::open_part(failures, Some(0), None)?
        .spec()
        .task
        .clone();
    let [kept, failed] = dataset.parts() else {
        return Ok((dataset, notes));
    };
    for episode in 0..failed.episodes {
        let mut note = failure_note(&of_failures, episode, &words);
        note["episode_index"] = json!(kept.episodes + episode);
        notes.episodes.push(note);
    }
    Ok((dataset, notes))
}

/// What is exported, looked at as a whole.
struct Source<'a> {
    options: &'a ExportOptions,
    dataset: &'a Dataset,
    /// The cameras' features, in the dataset's order.
    cameras: Vec<String>,
    splits: Splits,
    /// The instructions by number.
    tasks: Vec<String>,
    /// The number of each episode's instruction, in the dataset's order.
    task_of: Vec<usize>,
}

impl<'a> Source<'a> {
    fn new(
        options: &'a ExportOptions,
        dataset: &'a Dataset,
        notes: &Notes,
    ) -> Result<Self, DatasetError> {
        let cameras = cameras(&options.dataset, dataset)?;
        let mut tasks: Vec<String> = Vec::new();
        let mut task_of = Vec::new();
        for episode in 0..dataset.episodes().len() {
            let words = instruction(options, dataset, notes, episode);
            let known = tasks.iter().position(|task| *task == words);
            task_of.push(known.unwrap_or(tasks.len()));
            if known.is_none() {
                tasks.push(words);
            }
        }
        Ok(Self {
            options,
            dataset,
            cameras,
            splits: Splits::of(dataset.episodes().len(), notes),
            tasks,
            task_of,
        })
    }

    /// The instrument of an arm.
    fn tool(&self, arm: usize) -> &str {
        let tools = &self.options.tools;
        let tool = tools.get(arm).or_else(|| tools.last());
        tool.map_or("", String::as_str)
    }
}

/// The words of an episode: those that are given, its own, or the dataset's.
fn instruction(
    options: &ExportOptions,
    dataset: &Dataset,
    notes: &Notes,
    episode: usize,
) -> String {
    let own = note_of(notes, episode).and_then(|note| note["instruction"].as_str());
    let own = own.filter(|words| !words.is_empty());
    let given = options.instruction.as_deref().or(own);
    given.unwrap_or(&dataset.spec().task).to_owned()
}

/// What is noted of an episode.
fn note_of(notes: &Notes, episode: usize) -> Option<&Value> {
    let of_it = |note: &&Value| note["episode_index"].as_u64() == u64::try_from(episode).ok();
    notes.episodes.iter().find(of_it)
}

/// The lines of the tables of episodes so far. Kept until the end: two JSON values an episode, a
/// few kilobytes.
#[derive(Default)]
struct Lines {
    episodes: Vec<Value>,
    stats: Vec<Value>,
    frames: usize,
}

impl Lines {
    fn add(&mut self, source: &Source<'_>, index: usize, episode: usize, stats: Value) {
        let len = source.dataset.episodes()[episode].len;
        let task = &source.tasks[source.task_of[episode]];
        self.episodes
            .push(json!({"episode_index": index, "tasks": [task], "length": len}));
        self.stats
            .push(json!({"episode_index": index, "stats": stats}));
        self.frames += len;
    }
}

/// Writes what describes the episodes; `info.json` last, which makes a dataset of the folder.
fn finish(source: &Source<'_>, lines: &Lines) -> Result<ExportSummary, DatasetError> {
    let meta = source.options.out.join("meta");
    let tasks = source.tasks.iter().enumerate();
    let tasks: Vec<Value> = tasks
        .map(|(index, task)| json!({"task_index": index, "task": task}))
        .collect();
    write_lines(&meta.join("tasks.jsonl"), &tasks)?;
    write_lines(&meta.join("episodes.jsonl"), &lines.episodes)?;
    write_lines(&meta.join("episodes_stats.jsonl"), &lines.stats)?;
    write_text(&meta.join("README.md"), &readme::text(source, lines.frames))?;
    write_json(&meta.join("info.json"), &info(source, lines))?;
    Ok(ExportSummary {
        arms: source.dataset.arms(),
        cameras: source.cameras.clone(),
        episodes: lines.episodes.len(),
        frames: lines.frames,
        splits: source.splits.ranges(),
        warnings: warnings(source.dataset),
    })
}

/// `meta/info.json`, its keys as LeRobot 0.3.3 has them. Readers of v2.1 build each path from the
/// templates `data_path` and `video_path`.
fn info(source: &Source<'_>, lines: &Lines) -> Value {
    let episodes = lines.episodes.len();
    let features: serde_json::Map<String, Value> = features(source).into_iter().collect();
    json!({
        "codebase_version": VERSION,
        "robot_type": "dvrk",
        "total_episodes": episodes,
        "total_frames": lines.frames,
        "total_tasks": source.tasks.len(),
        "total_videos": episodes * source.cameras.len(),
        "total_chunks": episodes.div_ceil(CHUNK_SIZE),
        "chunks_size": CHUNK_SIZE,
        "fps": source.dataset.fps(),
        "splits": source.splits.ranges(),
        "data_path": "data/chunk-{episode_chunk:03d}/episode_{episode_index:06d}.parquet",
        "video_path": "videos/chunk-{episode_chunk:03d}/{video_key}/episode_{episode_index:06d}.mp4",
        "features": features,
    })
}

/// Rate and picture size below what Open-H-Embodiment asks for.
fn warnings(dataset: &Dataset) -> Vec<String> {
    let mut warnings = Vec::new();
    let fps = dataset.fps();
    if fps < FPS_MIN {
        warnings.push(format!(
            "{fps} frames a second, at least {FPS_MIN} are wanted"
        ));
    }
    for camera in &dataset.spec().cameras {
        let (name, width, height) = (&camera.name, camera.width, camera.height);
        if width.min(height) < SIDE_MIN {
            let wanted = format!("at least {SIDE_MIN} x {SIDE_MIN} are wanted");
            warnings.push(format!("{name} has {width} x {height} pixels, {wanted}"));
        }
    }
    warnings
}

/// Makes the folder, or takes an empty one.
fn new_folder(path: &Path) -> Result<(), DatasetError> {
    fs::create_dir_all(path).map_err(io_error(path))?;
    match fs::read_dir(path).map_err(io_error(path))?.next() {
        None => Ok(()),
        Some(_) => Err(DatasetError::Exists {
            path: path.to_owned(),
        }),
    }
}
