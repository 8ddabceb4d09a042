//! A log of bounded size: a full file is put aside and the next one begun; only the newest full one stays.

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use super::error::LogError;
use super::header::RunHeader;
use super::snapshot::{SeenChunks, SnapshotQueue};
use super::writer::LogWriter;

/// What may be written between two checks of the size: all between two flushes, and the end.
pub(super) const SPARE_BYTES: u64 = 2 << 20;

/// What a log with a bound has besides.
pub(super) struct Bounded {
    pub(super) bound: Bound,
    pub(super) snapshots: SnapshotQueue,
    /// Chunks that a snapshot may name.
    pub(super) seen: SeenChunks,
    /// Whether any snapshot has come: then the next file begins at one.
    pub(super) has_snapshots: bool,
}

/// The bound of a log.
pub(super) struct Bound {
    file_bytes_max: u64,
    run: RunHeader,
}

impl Bound {
    /// `bytes_max` for both files of the run `run`, of which one is at `path`. What an earlier run put aside there is no part of this one and
    /// is removed.
    pub(super) fn new(bytes_max: u64, run: &RunHeader, path: &Path) -> Self {
        let _absent = fs::remove_file(earlier(path));
        Self {
            file_bytes_max: (bytes_max / 2).saturating_sub(SPARE_BYTES),
            run: run.clone(),
        }
    }

    /// Whether the file at `path` is as large as it may get.
    pub(super) fn is_reached(&self, path: &Path) -> bool {
        fs::metadata(path).is_ok_and(|found| found.len() >= self.file_bytes_max)
    }

    /// Whether it is so large that half of what is spare is gone.
    pub(super) fn is_overdue(&self, path: &Path) -> bool {
        let bytes_max = self.file_bytes_max + SPARE_BYTES / 2;
        fs::metadata(path).is_ok_and(|found| found.len() >= bytes_max)
    }

    /// Puts the file at `path` aside and begins the next one, after `ticks` ticks.
    pub(super) fn next(
        &self,
        path: &Path,
        ticks: u64,
    ) -> Result<LogWriter<BufWriter<File>>, LogError> {
        let io = |source| LogError::Create {
            path: path.to_owned(),
            source,
        };
        fs::rename(path, earlier(path)).map_err(io)?;
        let sink = BufWriter::new(File::create(path).map_err(io)?);
        let run = RunHeader {
            left_out: ticks,
            ..self.run.clone()
        };
        LogWriter::new(sink, &run).map_err(|source| LogError::Write {
            path: path.to_owned(),
            source,
        })
    }
}

/// Where what came before is.
pub(super) fn earlier(path: &Path) -> PathBuf {
    path.with_extension("earlier.mcap")
}
