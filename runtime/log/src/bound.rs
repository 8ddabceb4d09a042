//! A log of bounded size: a full file is put aside and the next one begun; only the newest full one
//! stays.

use std::fs::{self, File};
use std::io::BufWriter;
use std::path::{Path, PathBuf};

use super::error::LogError;
use super::header::RunHeader;
use super::snapshot::{SeenChunks, SnapshotQueue};
use super::writer::LogWriter;

/// What may be written between two checks of the size, at least, and the end: room for twice as
/// much as between any two before, if that is more.
pub(super) const SPARE_BYTES: u64 = 2 << 20;

/// Of a file no more than this part is spare: what is written at once comes seldom.
const SPARE_PART: u64 = 3;

/// Of a file this part is for the index of its chunks, which ends it.
const INDEX_PART: u64 = 256;

/// What a log with a bound has besides.
pub(super) struct Bounded {
    pub(super) bound: Bound,
    pub(super) snapshots: SnapshotQueue,
    /// Chunks that a snapshot may name.
    pub(super) seen: SeenChunks,
    /// Whether any snapshot has come: then the next file begins at one.
    pub(super) has_snapshots: bool,
}

/// Whether a file may go on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Fill {
    /// Until the next check.
    HasRoom,
    /// The next file is to begin here if it can be replayed, for another check is possible.
    Reached,
    /// The next file is to begin here.
    Overdue,
}

/// The bound of a log.
pub(super) struct Bound {
    /// Half of the bound, less the index.
    file_bytes_max: u64,
    /// How large the file was when it was last checked, or had begun; unknown until the first
    /// check, before which frames of a long start count.
    checked_bytes: Option<u64>,
    /// The most that was written between two checks.
    growth_bytes_max: u64,
    run: RunHeader,
}

/// How large the file at `path` is; of what has no size, nothing.
fn size_bytes(path: &Path) -> u64 {
    fs::metadata(path).map_or(0, |found| found.len())
}

impl Bound {
    /// `bytes_max` for both files of the run `run`, of which one is at `path` and has begun. What
    /// an earlier run put aside there is no part of this one and is removed.
    pub(super) fn new(bytes_max: u64, run: &RunHeader, path: &Path) -> Self {
        let _absent = fs::remove_file(earlier(path));
        let file_bytes_max = bytes_max / 2;
        Self {
            file_bytes_max: file_bytes_max - file_bytes_max / INDEX_PART,
            checked_bytes: None,
            growth_bytes_max: 0,
            run: run.clone(),
        }
    }

    /// Whether the file at `path`, all of which was flushed, may go on if it is to end with
    /// `end_bytes` more.
    pub(super) fn check(&mut self, path: &Path, end_bytes: u64) -> Fill {
        let bytes = size_bytes(path);
        let growth_bytes = bytes.saturating_sub(self.checked_bytes.unwrap_or(bytes));
        self.growth_bytes_max = self.growth_bytes_max.max(growth_bytes);
        self.checked_bytes = Some(bytes);
        let left_bytes = self.file_bytes_max.saturating_sub(bytes + end_bytes);
        let spare_bytes = (2 * self.growth_bytes_max)
            .min(self.file_bytes_max / SPARE_PART)
            .max(SPARE_BYTES);
        if left_bytes > spare_bytes {
            Fill::HasRoom
        } else if left_bytes > spare_bytes / 2 {
            Fill::Reached
        } else {
            Fill::Overdue
        }
    }

    /// The file at `path` has begun: what it begins with is flushed.
    pub(super) fn begin(&mut self, path: &Path) {
        self.checked_bytes = Some(size_bytes(path));
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::tests::Scratch;

    /// Whatever is written between two checks, a file with its end stays within its half, and one
    /// more check is possible before it must end.
    #[test]
    fn a_file_ends_in_time() {
        let file = Scratch::new("bound");
        let bytes_max = 256 << 20;
        for growth_bytes in [70_000, 1_000_000, 6_000_000, 20_000_000] {
            for end_bytes in [0, 50_000, 7_000_000] {
                let sink = File::create(&file.0).unwrap();
                let mut bound = Bound::new(bytes_max, &RunHeader::default(), &file.0);
                let (mut bytes, mut waits) = (0, 0);
                loop {
                    bytes += growth_bytes;
                    sink.set_len(bytes).unwrap();
                    match bound.check(&file.0, end_bytes) {
                        Fill::HasRoom => assert_eq!(waits, 0),
                        Fill::Reached => waits += 1,
                        Fill::Overdue => break,
                    }
                }
                let (half, told) = (bytes_max / 2, format!("{growth_bytes}, {end_bytes}"));
                assert!(bytes + end_bytes <= half && waits > 0, "{told}");
                assert!(bytes + end_bytes > half * 3 / 4, "{told}");
            }
        }
    }

    /// What is written before the first check, such as frames while a run waits for its arms, is no
    /// measure of what comes between two.
    #[test]
    fn a_long_start_leaves_the_room_as_it_is() {
        let file = Scratch::new("bound-start");
        let sink = File::create(&file.0).unwrap();
        let mut bound = Bound::new(256 << 20, &RunHeader::default(), &file.0);
        for mib in 64..=124 {
            sink.set_len(mib << 20).unwrap();
            assert_eq!(bound.check(&file.0, 0), Fill::HasRoom, "{mib}");
        }
    }
}
