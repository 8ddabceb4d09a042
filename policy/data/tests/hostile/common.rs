//! A folder for each test, the seeds of its cases, and bounds on memory. The hostile tests of the
//! other crates in `policy/` have it too.

use std::fs;
use std::path::{Path, PathBuf};

/// Address space that all tests of a program may ask for together, on top of what it begins with,
/// bytes. Files here have less than a megabyte; what is left is for threads and the network
/// library.
const MEMORY_MAX: u64 = 3 << 30;

/// A folder of its own for one test, removed at the end.
pub(crate) struct Folder(PathBuf);

impl Folder {
    pub(crate) fn new(test: &str) -> Self {
        let path =
            std::env::temp_dir().join(format!("trocar-hostile-{test}-{}", std::process::id()));
        let _ = fs::remove_dir_all(&path);
        fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    pub(crate) fn path(&self) -> &Path {
        &self.0
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

/// The seeds of a test's cases; `share` of the number asked for, since some cases take longer.
pub(crate) fn seeds(share: u64) -> std::ops::Range<u64> {
    let number = |name: &str| -> Option<u64> { std::env::var(name).ok()?.parse().ok() };
    let first = number("TROCAR_HOSTILE_SEED").unwrap_or(0);
    let cases = number("TROCAR_HOSTILE_CASES").unwrap_or(400);
    first..first + cases.div_ceil(share)
}

/// Greatest address space so far, bytes.
fn peak() -> u64 {
    let status = fs::read_to_string("/proc/self/status").unwrap();
    let line = status.lines().find(|line| line.starts_with("VmPeak:"));
    let kilobytes = line.unwrap().split_whitespace().nth(1).unwrap();
    kilobytes.parse::<u64>().unwrap() << 10
}

/// Runs `test`, which must not have asked for more than [`MEMORY_MAX`].
pub(crate) fn within_memory(test: impl FnOnce()) {
    let before = peak();
    test();
    let more = peak() - before;
    assert!(more < MEMORY_MAX, "{more} bytes more than at the beginning");
}

/// The error with all its causes, as they are told.
pub(crate) fn told(error: &dyn std::error::Error) -> String {
    let mut text = error.to_string();
    let mut source = error.source();
    while let Some(cause) = source {
        text = format!("{text}: {cause}");
        source = cause.source();
    }
    text
}
