//! The `meta` folder: what it holds, written and read.
//!
//! Written in v3.0 only. Tables are written first and `info.json` last, as the commit record: a
//! reader takes no more episodes than it counts.

use std::{
    collections::BTreeMap,
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow_array::{
    ArrayRef, Float64Array, Int64Array, RecordBatch, StringArray,
    builder::{ListBuilder, StringBuilder},
};
use arrow_schema::Schema;
use hal::files;
use parquet::{errors::ParquetError, file::properties::WriterProperties};

use super::{
    DatasetError, DatasetSpec, VideoCodec,
    listed::{Listed, VideoPlace},
    schema::{self, EPISODE_COLUMNS, Info, READABLE, VERSION, video_columns},
    store::{io_error, parquet_error, write_json, write_parquet},
    table::Table,
};

/// Where data files are, as `info.json` says it. Template for LeRobot's `str.format`; here paths
/// are built by [`data_path`].
const DATA_PATH: &str = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet";

/// Where videos are, as `info.json` says it. As [`DATA_PATH`], for [`video_path`].
const VIDEO_PATH: &str = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4";

/// Files a folder may hold. LeRobot's default; `info.json` repeats it as `chunks_size`.
pub(super) const CHUNK_SIZE: usize = 1000;

/// One row of the episodes table.
///
/// This writer gives each episode a data file of its own, which the format allows: an interrupted
/// recording then never leaves half a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct EpisodeRow {
    pub(super) index: usize,
    pub(super) start: usize,
    pub(super) len: usize,
    /// Number of its folder `chunk-NNN`.
    pub(super) chunk: usize,
    /// Number of its file within the folder.
    pub(super) file: usize,
}

/// The description and commit record of the dataset in `dir`.
pub(super) fn info_path(dir: &Path) -> PathBuf {
    dir.join("meta/info.json")
}

pub(super) fn stats_path(dir: &Path) -> PathBuf {
    dir.join("meta/stats.json")
}

pub(super) fn tasks_path(dir: &Path) -> PathBuf {
    dir.join("meta/tasks.parquet")
}

/// A data file of v3.0.
pub(super) fn data_path(dir: &Path, chunk: usize, file: usize) -> PathBuf {
    dir.join(format!("data/chunk-{chunk:03}/file-{file:03}.parquet"))
}

/// A file of the video of `feature`.
pub(super) fn video_path(dir: &Path, feature: &str, chunk: usize, file: usize) -> PathBuf {
    dir.join(format!(
        "videos/{feature}/chunk-{chunk:03}/file-{file:03}.mp4"
    ))
}

/// The commit record for `episodes` episodes with `frames` frames.
///
/// The limits of file sizes are LeRobot's defaults and say nothing about this writer's files. All
/// episodes are in the one split `train`.
pub(super) fn info(
    spec: &DatasetSpec,
    video: Option<VideoCodec>,
    episodes: usize,
    frames: usize,
    recording: Option<serde_json::Value>,
) -> Info {
    Info {
        codebase_version: VERSION.to_owned(),
        robot_type: Some(spec.robot_type.clone()),
        total_episodes: episodes,
        total_frames: frames,
        total_tasks: 1,
        chunks_size: CHUNK_SIZE,
        data_files_size_in_mb: 100,
        video_files_size_in_mb: 200,
        fps: spec.fps,
        splits: [("train".to_owned(), format!("0:{episodes}"))].into(),
        data_path: DATA_PATH.to_owned(),
        video_path: video.map(|_| VIDEO_PATH.to_owned()),
        features: schema::features(spec, video),
        trocar: recording,
    }
}

/// `info.json` of the dataset in `dir`, its version checked first.
///
/// # Errors
/// [`DatasetError::Io`]; [`DatasetError::Json`]; [`DatasetError::Version`] for a version of the
/// format that is not read.
pub(super) fn read_info(dir: &Path) -> Result<Info, DatasetError> {
    let path = info_path(dir);
    let text = files::read_text(&path, "info.json", files::JSON_SIZE_MAX);
    let text = text.map_err(io_error(&path))?;
    let json_error = |source| DatasetError::Json {
        path: path.clone(),
        source,
    };
    // The version first: another one may lack the other keys.
    let value: serde_json::Value = serde_json::from_str(&text).map_err(json_error)?;
    let found = value["codebase_version"].as_str().unwrap_or_default();
    if !READABLE.contains(&found) {
        return Err(DatasetError::Version {
            path,
            found: found.to_owned(),
            expected: READABLE.join(", "),
        });
    }
    serde_json::from_str(&text).map_err(json_error)
}

pub(super) fn write_info(dir: &Path, info: &Info) -> Result<(), DatasetError> {
    write_json(&info_path(dir), info)
}

/// The table with the one task, number 0.
pub(super) fn write_task(dir: &Path, task: &str) -> Result<(), DatasetError> {
    let columns: Vec<ArrayRef> = vec![
        Arc::new(Int64Array::from(vec![0])),
        Arc::new(StringArray::from(vec![task])),
    ];
    write_table(&tasks_path(dir), schema::tasks_schema(), columns)
}

/// The first task of a dataset; its column is named `task`, or as pandas names an index without a
/// name.
pub(super) fn read_task(dir: &Path) -> Result<String, DatasetError> {
    let table = Table::open(&tasks_path(dir))?;
    let texts = table
        .strings("task")
        .or_else(|error| table.strings("__index_level_0__").map_err(|_| error))?;
    let first = texts.into_iter().next();
    first.ok_or_else(|| table.mismatch("task", "empty".to_owned(), "at least one".to_owned()))
}

/// Every task of a dataset by its number.
pub(super) fn read_tasks(dir: &Path) -> Result<BTreeMap<i64, String>, DatasetError> {
    let table = Table::open(&tasks_path(dir))?;
    let texts = table
        .strings("task")
        .or_else(|error| table.strings("__index_level_0__").map_err(|_| error))?;
    let numbers = table.integers("task_index")?;
    table.check_rows("task_index", numbers.len(), texts.len())?;
    Ok(numbers.into_iter().zip(texts).collect())
}

/// Rewrites the whole table: O(episodes) at each end of an episode. A video's times are `0` to
/// `len / fps`, since each episode has a file of its own.
pub(super) fn write_episodes(
    dir: &Path,
    task: &str,
    fps: u32,
    videos: &[String],
    episodes: &[EpisodeRow],
) -> Result<(), DatasetError> {
    let column = |name: &str| -> ArrayRef {
        let value = |row: &EpisodeRow| match name {
            "episode_index" => row.index,
            "length" => row.len,
            "data/chunk_index" => row.chunk,
            "data/file_index" => row.file,
            "dataset_from_index" => row.start,
            "dataset_to_index" => row.start + row.len,
            // This table itself is a single file.
            _ => 0,
        };
        Arc::new(Int64Array::from_iter_values(
            episodes.iter().map(|row| value(row) as i64),
        ))
    };
    let mut columns: Vec<ArrayRef> = EPISODE_COLUMNS.iter().map(|name| column(name)).collect();
    let mut tasks = ListBuilder::new(StringBuilder::new());
    for _ in episodes {
        tasks.append_value([Some(task)]);
    }
    columns.push(Arc::new(tasks.finish()));
    for _ in videos {
        // An episode has a video of its own, numbered as its data file.
        columns.push(column("data/chunk_index"));
        columns.push(column("data/file_index"));
        let seconds = |end: &dyn Fn(&EpisodeRow) -> usize| -> ArrayRef {
            let seconds = episodes.iter().map(|row| seconds_of(end(row), fps));
            Arc::new(Float64Array::from_iter_values(seconds))
        };
        columns.push(seconds(&|_| 0));
        columns.push(seconds(&|row| row.len));
    }
    write_table(
        &dir.join("meta/episodes/chunk-000/file-000.parquet"),
        schema::episodes_schema(videos),
        columns,
    )
}

/// The time that `frames` frames take, s.
#[expect(
    clippy::cast_precision_loss,
    reason = "frame counts stay far below 2^53"
)]
fn seconds_of(frames: usize, fps: u32) -> f64 {
    frames as f64 / f64::from(fps)
}

/// The episodes in order, out of every file of the table; `videos` are the features that are kept
/// as video. The files are read in order of their names and the rows sorted by their number.
pub(super) fn read_episodes(dir: &Path, videos: &[String]) -> Result<Vec<Listed>, DatasetError> {
    let mut rows = Vec::new();
    for path in parquet_files(&dir.join("meta/episodes"))? {
        let table = Table::open(&path)?;
        let [index, len, chunk, file, start] = [
            "episode_index",
            "length",
            "data/chunk_index",
            "data/file_index",
            "dataset_from_index",
        ]
        .map(|name| table.counts(name));
        let (index, len, chunk, file, start) = (index?, len?, chunk?, file?, start?);
        for (name, rows) in [
            ("length", len.len()),
            ("data/chunk_index", chunk.len()),
            ("data/file_index", file.len()),
            ("dataset_from_index", start.len()),
        ] {
            table.check_rows(name, rows, index.len())?;
        }
        let places = read_video_places(dir, &table, videos)?;
        for (feature, places) in videos.iter().zip(&places) {
            table.check_rows(feature, places.len(), index.len())?;
        }
        rows.extend((0..index.len()).map(|row| Listed {
            index: index[row],
            start: start[row],
            len: len[row],
            data: data_path(dir, chunk[row], file[row]),
            alone: false,
            videos: places.iter().map(|of_rows| of_rows[row].clone()).collect(),
        }));
    }
    rows.sort_by_key(|row| row.index);
    Ok(rows)
}

/// Where each row's frames are, by feature.
fn read_video_places(
    dir: &Path,
    table: &Table,
    videos: &[String],
) -> Result<Vec<Vec<VideoPlace>>, DatasetError> {
    let of_feature = |feature: &String| {
        let [chunk, file, from, _] = video_columns(feature);
        let (chunk, file) = (table.counts(&chunk)?, table.counts(&file)?);
        let from = table.reals(&from)?;
        let rows = chunk.iter().zip(&file).zip(&from);
        Ok(rows
            .map(|((&chunk, &file), &from_s)| VideoPlace {
                path: video_path(dir, feature, chunk, file),
                from_s,
            })
            .collect())
    };
    videos.iter().map(of_feature).collect()
}

/// One batch as a parquet file of `meta`, with the library's default properties.
fn write_table(path: &Path, schema: Schema, columns: Vec<ArrayRef>) -> Result<(), DatasetError> {
    let schema = Arc::new(schema);
    let batch = RecordBatch::try_new(Arc::clone(&schema), columns)
        .map_err(ParquetError::from)
        .map_err(parquet_error(path))?;
    write_parquet(
        path,
        &schema,
        WriterProperties::default(),
        std::iter::once(Ok(batch)),
    )
}

/// `chunk-*/file-*.parquet` below `folder`, in order of their names.
fn parquet_files(folder: &Path) -> Result<Vec<PathBuf>, DatasetError> {
    let entries = |folder: &Path| -> Result<Vec<PathBuf>, DatasetError> {
        let listed = fs::read_dir(folder)
            .and_then(|entries| entries.map(|entry| Ok(entry?.path())).collect());
        let mut listed: Vec<PathBuf> = listed.map_err(io_error(folder))?;
        listed.sort();
        Ok(listed)
    };
    let mut files = Vec::new();
    for chunk in entries(folder)?.iter().filter(|path| path.is_dir()) {
        files.extend(
            entries(chunk)?
                .into_iter()
                .filter(|path| path.extension().is_some_and(|it| it == "parquet")),
        );
    }
    Ok(files)
}
