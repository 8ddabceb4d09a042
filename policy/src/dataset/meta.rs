//! The `meta` folder: what it holds, written and read.

use std::{
    fs,
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow_array::{
    ArrayRef, Int64Array, RecordBatch, StringArray,
    builder::{ListBuilder, StringBuilder},
};
use arrow_schema::Schema;
use parquet::{errors::ParquetError, file::properties::WriterProperties};

use super::{
    DatasetError, DatasetSpec,
    schema::{self, EPISODE_COLUMNS, Info, VERSION},
    store::{io_error, parquet_error, write_json, write_parquet},
    table::Table,
};

/// Files a folder may hold.
pub(super) const CHUNK_SIZE: usize = 1000;

/// One row of the episodes table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct EpisodeRow {
    pub(super) index: usize,
    pub(super) start: usize,
    pub(super) len: usize,
    pub(super) chunk: usize,
    pub(super) file: usize,
}

pub(super) fn info_path(dir: &Path) -> PathBuf {
    dir.join("meta/info.json")
}

pub(super) fn stats_path(dir: &Path) -> PathBuf {
    dir.join("meta/stats.json")
}

pub(super) fn tasks_path(dir: &Path) -> PathBuf {
    dir.join("meta/tasks.parquet")
}

pub(super) fn data_path(dir: &Path, chunk: usize, file: usize) -> PathBuf {
    dir.join(format!("data/chunk-{chunk:03}/file-{file:03}.parquet"))
}

/// The commit record for `episodes` episodes with `frames` frames.
pub(super) fn info(spec: &DatasetSpec, episodes: usize, frames: usize) -> Info {
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
        data_path: "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet".to_owned(),
        video_path: None,
        features: schema::features(spec),
    }
}

pub(super) fn read_info(dir: &Path) -> Result<Info, DatasetError> {
    let path = info_path(dir);
    let text = fs::read_to_string(&path).map_err(io_error(&path))?;
    let json_error = |source| DatasetError::Json {
        path: path.clone(),
        source,
    };
    // The version first: another one may lack the other keys.
    let value: serde_json::Value = serde_json::from_str(&text).map_err(json_error)?;
    let found = value["codebase_version"].as_str().unwrap_or_default();
    if found != VERSION {
        return Err(DatasetError::Version {
            path,
            found: found.to_owned(),
            expected: VERSION,
        });
    }
    serde_json::from_str(&text).map_err(json_error)
}

pub(super) fn write_info(dir: &Path, info: &Info) -> Result<(), DatasetError> {
    write_json(&info_path(dir), info)
}

pub(super) fn write_task(dir: &Path, task: &str) -> Result<(), DatasetError> {
    let columns: Vec<ArrayRef> = vec![
        Arc::new(Int64Array::from(vec![0])),
        Arc::new(StringArray::from(vec![task])),
    ];
    write_table(&tasks_path(dir), schema::tasks_schema(), columns)
}

/// The first task of a dataset; its column is named `task`, or as pandas names an index without a name.
pub(super) fn read_task(dir: &Path) -> Result<String, DatasetError> {
    let table = Table::open(&tasks_path(dir))?;
    let texts = table
        .strings("task")
        .or_else(|error| table.strings("__index_level_0__").map_err(|_| error))?;
    let first = texts.into_iter().next();
    first.ok_or_else(|| table.mismatch("task", "empty".to_owned(), "at least one".to_owned()))
}

pub(super) fn write_episodes(
    dir: &Path,
    task: &str,
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
    write_table(
        &dir.join("meta/episodes/chunk-000/file-000.parquet"),
        schema::episodes_schema(),
        columns,
    )
}

/// The episodes in order, out of every file of the table.
pub(super) fn read_episodes(dir: &Path) -> Result<Vec<EpisodeRow>, DatasetError> {
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
        rows.extend((0..index.len()).map(|row| EpisodeRow {
            index: index[row],
            start: start[row],
            len: len[row],
            chunk: chunk[row],
            file: file[row],
        }));
    }
    rows.sort_by_key(|row| row.index);
    Ok(rows)
}

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
