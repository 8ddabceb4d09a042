//! Files that are whole or absent: written beside their place, synced, then renamed.
//!
//! Every file of a dataset but its videos goes through `replace`; `encoder` does the same for
//! videos.

use std::{
    fs::{self, File},
    io::Write,
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow_array::RecordBatch;
use arrow_schema::Schema;
use parquet::{arrow::ArrowWriter, errors::ParquetError, file::properties::WriterProperties};

use super::DatasetError;

/// For `map_err`: names the file that was being worked on.
pub(crate) fn io_error(path: &Path) -> impl FnOnce(std::io::Error) -> DatasetError {
    let path = path.to_owned();
    move |source| DatasetError::Io { path, source }
}

pub(crate) fn parquet_error(path: &Path) -> impl FnOnce(ParquetError) -> DatasetError {
    let path = path.to_owned();
    move |source| DatasetError::Parquet { path, source }
}

/// Writes `value` as indented JSON.
pub(crate) fn write_json<T: serde::Serialize>(path: &Path, value: &T) -> Result<(), DatasetError> {
    let mut text = serde_json::to_vec_pretty(value).map_err(|source| DatasetError::Json {
        path: path.to_owned(),
        source,
    })?;
    text.push(b'\n');
    replace(path, |mut file| {
        file.write_all(&text).map_err(io_error(path))?;
        Ok(file)
    })
}

/// Writes `values` as JSON, a line each.
pub(crate) fn write_lines<T: serde::Serialize>(
    path: &Path,
    values: &[T],
) -> Result<(), DatasetError> {
    let mut text = Vec::new();
    for value in values {
        serde_json::to_writer(&mut text, value).map_err(|source| DatasetError::Json {
            path: path.to_owned(),
            source,
        })?;
        text.push(b'\n');
    }
    replace(path, |mut file| {
        file.write_all(&text).map_err(io_error(path))?;
        Ok(file)
    })
}

/// Writes `text`.
pub(crate) fn write_text(path: &Path, text: &str) -> Result<(), DatasetError> {
    replace(path, |mut file| {
        file.write_all(text.as_bytes()).map_err(io_error(path))?;
        Ok(file)
    })
}

/// Writes the batches as one row group.
///
/// Batches are made one at a time, when the writer wants the next; the row group is buffered
/// encoded until the file is closed.
pub(crate) fn write_parquet(
    path: &Path,
    schema: &Arc<Schema>,
    properties: WriterProperties,
    batches: impl Iterator<Item = Result<RecordBatch, DatasetError>>,
) -> Result<(), DatasetError> {
    replace(path, |file| {
        let mut writer = ArrowWriter::try_new(file, Arc::clone(schema), Some(properties))
            .map_err(parquet_error(path))?;
        for batch in batches {
            writer.write(&batch?).map_err(parquet_error(path))?;
        }
        writer.into_inner().map_err(parquet_error(path))
    })
}

/// Lets `write` fill a file beside `path`, then puts it in the place of `path`.
///
/// File and folder are synced, so once this returns the new content survives a power cut. After a
/// failure the old file is untouched; the partial one stays and is overwritten next time.
fn replace(
    path: &Path,
    write: impl FnOnce(File) -> Result<File, DatasetError>,
) -> Result<(), DatasetError> {
    let folder = path.parent().unwrap_or(Path::new("."));
    fs::create_dir_all(folder).map_err(io_error(folder))?;
    // The suffix keeps the file from every reader's `*.parquet` until it is whole.
    let mut beside = path.as_os_str().to_owned();
    beside.push(".partial");
    let beside = PathBuf::from(beside);
    let file = write(File::create(&beside).map_err(io_error(&beside))?)?;
    file.sync_all().map_err(io_error(&beside))?;
    fs::rename(&beside, path).map_err(io_error(path))?;
    // Makes the new name itself survive a power cut.
    File::open(folder)
        .and_then(|folder| folder.sync_all())
        .map_err(io_error(folder))
}
