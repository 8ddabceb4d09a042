//! Where runs listen: one socket a run, in a folder that its user alone may enter.

use std::fs::{self, DirBuilder};
use std::io;
use std::os::unix::fs::{DirBuilderExt as _, MetadataExt as _};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicU32, Ordering};

/// The folder of this user's runs, made if it is not there.
///
/// # Errors
/// If it can't be made, or is another user's or open to others.
pub(super) fn folder() -> io::Result<PathBuf> {
    let base = std::env::var_os("XDG_RUNTIME_DIR").map(PathBuf::from);
    let base = base.filter(|base| base.is_absolute() && base.is_dir());
    let base = base.unwrap_or_else(|| "/tmp".into());
    let own = fs::metadata("/proc/self")?.uid();
    let folder = base.join(format!("trocar-{own}"));
    match DirBuilder::new().mode(0o700).create(&folder) {
        Err(error) if error.kind() != io::ErrorKind::AlreadyExists => return Err(error),
        Ok(()) | Err(_) => {}
    }
    let found = fs::symlink_metadata(&folder)?;
    if !found.is_dir() || found.uid() != own || found.mode() & 0o077 != 0 {
        return Err(io::Error::other(format!(
            "{} is to be a folder of this user with mode 0700",
            folder.display()
        )));
    }
    Ok(folder)
}

/// Why no operator will reach the runs of this process, if that is so.
#[must_use]
pub fn check() -> Option<String> {
    folder().err().map(|error| error.to_string())
}

/// A name for another run of this process: its number, and behind it which of its runs it is if
/// that is not the first.
pub(super) fn new_name() -> String {
    static RUNS: AtomicU32 = AtomicU32::new(0);
    let process = std::process::id();
    match RUNS.fetch_add(1, Ordering::Relaxed) {
        0 => process.to_string(),
        run => format!("{process}.{run}"),
    }
}

/// The socket of the run called `name`.
pub(super) fn socket(folder: &Path, name: &str) -> PathBuf {
    folder.join(format!("run-{name}.sock"))
}

/// Whether the process that made `socket` is gone.
fn is_left_over(socket: &Path) -> bool {
    let name = socket.file_stem().and_then(|name| name.to_str());
    let name = name.and_then(|name| name.strip_prefix("run-"));
    let process = name.and_then(|name| name.split('.').next());
    process.is_some_and(|process| !Path::new("/proc").join(process).exists())
}

/// The sockets in `folder` at which a run listens; those of runs that are gone are removed.
pub(super) fn listening(folder: &Path) -> io::Result<Vec<PathBuf>> {
    let mut found = Vec::new();
    for entry in fs::read_dir(folder)? {
        let path = entry?.path();
        if path.extension().is_none_or(|ending| ending != "sock") {
            continue;
        }
        match UnixStream::connect(&path) {
            Ok(_) => found.push(path),
            Err(_) if is_left_over(&path) => {
                let _gone = fs::remove_file(&path);
            }
            Err(_) => {}
        }
    }
    found.sort();
    Ok(found)
}
