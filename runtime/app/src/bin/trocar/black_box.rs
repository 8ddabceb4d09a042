//! The log that a robot's run keeps unasked: what led to a fault is on disk, whoever forgot `--log`.

use std::env;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use crate::args::{Backend, RunArgs};
use crate::console;

/// What it takes at most, bytes: of a robot without cameras some hours, with two of 512 x 512 pixels about the last ten seconds.
const BYTES_MAX: u64 = 256 << 20;

/// The run's log and its bound, as asked or as a robot keeps it.
pub(crate) fn log_of(args: &RunArgs) -> (Option<PathBuf>, Option<u64>) {
    let asked = args.log.is_some() || args.no_log;
    let drives_a_robot = matches!(args.backend, Backend::Can);
    if asked || !drives_a_robot {
        return (args.log.clone(), args.log_max_mb.map(|mb| mb << 20));
    }
    match folder().and_then(|folder| kept(&folder, &args.topics)) {
        Ok(log) => {
            let (path, mb) = (log.display(), BYTES_MAX >> 20);
            console::note(&format!(
                "trocar: the last {mb} MB of its log are kept in {path}; --log FILE keeps all of it, --no-log nothing"
            ));
            (Some(log), Some(BYTES_MAX))
        }
        Err(error) => {
            console::warning(&format!("no log is kept of this run: {error}"));
            (None, None)
        }
    }
}

/// Where it is kept: the service's folder, or the user's for states.
fn folder() -> io::Result<PathBuf> {
    let named = |name: &str| env::var_os(name).map(PathBuf::from);
    let absolute = |path: PathBuf| path.is_absolute().then_some(path);
    let service = named("STATE_DIRECTORY").and_then(absolute);
    let user = || named("XDG_STATE_HOME").and_then(absolute);
    let home = || Some(named("HOME")?.join(".local/state"));
    let of_user = || Some(user().or_else(home)?.join("trocar"));
    let folder = service.or_else(of_user);
    let folder =
        folder.ok_or_else(|| io::Error::other("there is no HOME and no XDG_STATE_HOME"))?;
    Ok(folder.join("black-box"))
}

/// The log of a run on the topics of that name, with the one before it set aside.
fn kept(folder: &Path, topics: &str) -> io::Result<PathBuf> {
    // Another name is refused where the topics are opened.
    if Path::new(topics).file_name() != Some(topics.as_ref()) {
        return Err(io::Error::other(format!("{topics:?} is no name of topics")));
    }
    fs::create_dir_all(folder)?;
    let file = |end: &str| folder.join(format!("{topics}{end}.mcap"));
    for part in ["", ".earlier"] {
        let before = file(&format!(".before{part}"));
        match fs::rename(file(part), &before) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                // What is there from still longer ago would pass for a part of the one before.
                let _none = fs::remove_file(before);
            }
            done => done?,
        }
    }
    Ok(file(""))
}
