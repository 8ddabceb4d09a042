//! Where a dataset's episodes lie: the folders of LeRobot v3.0, and those of v2.0 and v2.1, which
//! are only read.
//!
//! ```text
//!        v3.0                                                  v2.1
//! meta   episodes/chunk-000/file-000.parquet, tasks.parquet    episodes.jsonl, tasks.jsonl
//! data   chunk-000/file-000.parquet, many episodes a file      chunk-000/episode_000000.parquet
//! videos KEY/chunk-000/file-000.mp4, many episodes a file      chunk-000/KEY/episode_000000.mp4
//! ```
//!
//! v2.0 and v2.1 differ for a reader only in their statistics (`stats.json` against
//! `episodes_stats.jsonl`), which are not read here. Paths are built, not taken from the templates
//! `data_path` and `video_path` in `info.json`.

use std::{
    collections::BTreeMap,
    io::{BufRead, BufReader, Read},
    path::Path,
};

use hal::files;
use serde::{Deserialize, de::DeserializeOwned};

use super::{
    DatasetError,
    error::mismatch,
    listed::{Listed, VideoPlace},
    meta::{self, CHUNK_SIZE},
    schema::{Info, VERSION},
    store::io_error,
};

/// Bytes that a line of a `.jsonl` file may have.
const LINE_MAX: u64 = 1 << 20;

/// The episodes in order; `videos` are the features that are kept as video.
///
/// In v2.x their lines must be numbered from 0 without a gap, and where an episode begins is the
/// sum of the lengths before it; v3.0 says it in `dataset_from_index`.
pub(super) fn read_episodes(
    dir: &Path,
    info: &Info,
    videos: &[String],
) -> Result<Vec<Listed>, DatasetError> {
    if info.codebase_version == VERSION {
        return meta::read_episodes(dir, videos);
    }
    let path = dir.join("meta/episodes.jsonl");
    let lines: Vec<EpisodeLine> = read_lines(&path)?;
    let mut start = 0_usize;
    let mut listed = Vec::with_capacity(lines.len());
    for (index, line) in lines.into_iter().enumerate() {
        if line.episode_index != index {
            let found = line.episode_index.to_string();
            return Err(mismatch(path, "episode_index", found, index));
        }
        listed.push(alone(dir, index, [start, line.length], videos));
        start = start.saturating_add(line.length);
    }
    Ok(listed)
}

/// An episode of v2.0 or v2.1, which has files of its own: `len` frames from frame `start` of the
/// dataset on.
fn alone(dir: &Path, index: usize, [start, len]: [usize; 2], videos: &[String]) -> Listed {
    let chunk = format!("chunk-{:03}", index / CHUNK_SIZE);
    let of_feature = |feature: &String| VideoPlace {
        path: dir.join(format!("videos/{chunk}/{feature}/episode_{index:06}.mp4")),
        from_s: 0.0,
    };
    Listed {
        index,
        start,
        len,
        data: dir.join(format!("data/{chunk}/episode_{index:06}.parquet")),
        alone: true,
        videos: videos.iter().map(of_feature).collect(),
    }
}

/// What the episodes show, in words: the first task. The dataset's other tasks are left out: a
/// dataset of this robot has one.
pub(super) fn read_task(dir: &Path, info: &Info) -> Result<String, DatasetError> {
    if info.codebase_version == VERSION {
        return meta::read_task(dir);
    }
    let path = dir.join("meta/tasks.jsonl");
    let lines: Vec<TaskLine> = read_lines(&path)?;
    let first = lines.into_iter().next();
    first
        .map(|line| line.task)
        .ok_or_else(|| mismatch(path, "task", "empty", "at least one"))
}

/// Every task by its number.
pub(super) fn read_tasks(dir: &Path, info: &Info) -> Result<BTreeMap<i64, String>, DatasetError> {
    if info.codebase_version == VERSION {
        return meta::read_tasks(dir);
    }
    let lines: Vec<NumberedTask> = read_lines(&dir.join("meta/tasks.jsonl"))?;
    let numbered = lines.into_iter().map(|line| (line.task_index, line.task));
    Ok(numbered.collect())
}

/// A line of `tasks.jsonl` for [`read_tasks`].
#[derive(Deserialize)]
struct NumberedTask {
    task_index: i64,
    task: String,
}

/// A line of `episodes.jsonl`; its `tasks` are not needed, since each row names its own.
#[derive(Deserialize)]
struct EpisodeLine {
    episode_index: usize,
    /// Frames of the episode.
    length: usize,
}

/// A line of `tasks.jsonl` for [`read_task`], which needs no number.
#[derive(Deserialize)]
struct TaskLine {
    task: String,
}

/// A JSON value a line, empty lines left out.
///
/// A line of more than `LINE_MAX` bytes is cut there and then malformed: no file makes this
/// allocate more than its values need.
pub(super) fn read_lines<T: DeserializeOwned>(path: &Path) -> Result<Vec<T>, DatasetError> {
    let mut reader = BufReader::new(files::open(path).map_err(io_error(path))?);
    let mut values = Vec::new();
    let mut line = Vec::new();
    loop {
        line.clear();
        let read = reader.by_ref().take(LINE_MAX).read_until(b'\n', &mut line);
        if read.map_err(io_error(path))? == 0 {
            return Ok(values);
        }
        if line.trim_ascii().is_empty() {
            continue;
        }
        let value = serde_json::from_slice(&line).map_err(|source| DatasetError::Json {
            path: path.to_owned(),
            source,
        });
        values.push(value?);
    }
}
