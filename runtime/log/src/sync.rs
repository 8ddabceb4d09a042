//! Brings a log to its disk about once a second, in a thread of its own: a disk that takes long
//! holds up nobody, and a machine that loses its power loses little of the log.

use std::fs::File;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::mpsc::{self, Receiver, RecvTimeoutError, Sender};
use std::thread;
use std::time::Duration;

use super::bound;

/// Time between two times.
const EVERY: Duration = Duration::from_secs(1);

/// Held as long as the log is written.
pub(super) struct Syncing {
    _ends: Sender<()>,
}

impl Syncing {
    /// Begins to sync the file at `path`, and what its bound puts aside.
    ///
    /// # Errors
    /// If there can be no thread.
    pub(super) fn start(path: &Path) -> io::Result<Self> {
        let (ends, ended) = mpsc::channel();
        let files = [path.to_owned(), bound::earlier(path)];
        thread::Builder::new()
            .name("log-sync".to_owned())
            .spawn(move || sync_until(&ended, &files))?;
        Ok(Self { _ends: ends })
    }
}

fn sync_until(ended: &Receiver<()>, files: &[PathBuf]) {
    while ended.recv_timeout(EVERY) == Err(RecvTimeoutError::Timeout) {
        for file in files {
            // What can't be written is told by the next write; pipes and the like have no disk.
            let _synced = File::open(file).and_then(|file| file.sync_data());
        }
    }
}
