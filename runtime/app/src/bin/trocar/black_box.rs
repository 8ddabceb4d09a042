//! The log that a run in real time keeps unasked: what led to a fault is on disk, whoever forgot
//! `--log`.

use std::env;
use std::fs::{self, File, TryLockError};
use std::io;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;

use trocar::session::drives::DEFAULT_TOPICS;

use crate::args::{Backend, RunArgs};
use crate::console;

/// What it takes at most, bytes: of a run without cameras some hours, with two of 512 x 512 pixels
/// about the last ten seconds.
const BYTES_MAX: u64 = 256 << 20;

/// A log that is no longer holds a few ticks at most, bytes: of a run that ended before its arms
/// moved. Configuration and schemas are 23 kB of it, a tick about 1 kB.
const HEADER_BYTES: u64 = 48_000;

/// Runs of one name that keep a log at a time.
const AT_A_TIME: u32 = 8;

/// The lock of the log that this process keeps.
static LOCK: OnceLock<File> = OnceLock::new();

/// What simulated arms keep is called this.
const SIMULATION: &str = "simulation";

/// The log of a run.
pub(crate) struct Log {
    /// Where it goes, if anywhere.
    pub(crate) path: Option<PathBuf>,
    /// Bytes that it takes at most, if it has a bound.
    pub(crate) bytes_max: Option<u64>,
    /// What is said once it is open.
    pub(crate) opened: fn(&Path),
}

/// The log as asked, or as a run in real time keeps it.
pub(crate) fn log_of(args: &RunArgs) -> Log {
    let asked = args.log.is_some() || args.no_log;
    if asked || args.lockstep {
        return Log {
            path: args.log.clone(),
            bytes_max: args.log_max_mb.map(|mb| mb << 20),
            opened: |_| (),
        };
    }
    let name = match args.backend {
        Backend::Can | Backend::Topics => args.topics.as_deref().unwrap_or(DEFAULT_TOPICS),
        Backend::Sim => SIMULATION,
    };
    match folder().and_then(|folder| kept(&folder, name)) {
        Ok(log) => Log {
            path: Some(log),
            bytes_max: Some(BYTES_MAX),
            opened: say_where,
        },
        Err(error) => {
            console::warning(&format!("no log is kept of this run: {error}"));
            Log {
                path: None,
                bytes_max: None,
                opened: |_| (),
            }
        }
    }
}

/// Says that the log at `path` is kept unasked. A run that is refused before it is open keeps none.
fn say_where(path: &Path) {
    let (path, mb) = (path.display(), BYTES_MAX >> 20);
    console::note(&format!(
        "trocar: the last {mb} MB of its log are kept in {path}; --log FILE keeps all of it, --no-log nothing"
    ));
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

/// The log of a run on the topics of that name, or of the simulation, with the one before it set
/// aside. Runs at the same time have one each: `NAME.mcap`, `NAME.2.mcap` and so on.
fn kept(folder: &Path, name: &str) -> io::Result<PathBuf> {
    // Another name is refused where the topics are opened.
    if Path::new(name).file_name() != Some(name.as_ref()) {
        return Err(io::Error::other(format!("{name:?} is no name of topics")));
    }
    fs::create_dir_all(folder)?;
    let name = own_name(folder, name)?;
    let file = |end: &str| folder.join(format!("{name}{end}.mcap"));
    let there = fs::metadata(file("")).map_or(0, |found| found.len());
    // One that came to no motion leaves the log of the one before, in which a fault may be.
    let parts: &[&str] = if there > HEADER_BYTES || file(".earlier").exists() {
        &["", ".earlier"]
    } else {
        &[]
    };
    for part in parts {
        let before = file(&format!(".before{part}"));
        match fs::rename(file(part), &before) {
            Err(error) if error.kind() == io::ErrorKind::NotFound => {
                // What is there from still longer ago would pass for a part of the one before.
                let _none = fs::remove_file(before);
            }
            done => done?,
        }
    }
    // Whether it can be written is said now, not when the arms have torque.
    let log = File::options().append(true).create(true).open(file(""))?;
    // A start that is refused leaves nothing.
    if log.metadata()?.len() == 0 {
        fs::remove_file(file(""))?;
    }
    Ok(file(""))
}

/// The first of the names `name`, `name.2` ... that no other run has; names of topics have no dot.
/// It is this process' own for as long as it lives.
fn own_name(folder: &Path, name: &str) -> io::Result<String> {
    for number in 1..=AT_A_TIME {
        let own = match number {
            1 => name.to_owned(),
            _ => format!("{name}.{number}"),
        };
        let lock = File::create(folder.join(format!("{own}.lock")))?;
        match lock.try_lock() {
            Ok(()) => {
                let _first = LOCK.set(lock);
                return Ok(own);
            }
            Err(TryLockError::WouldBlock) => {}
            Err(TryLockError::Error(error)) => return Err(error),
        }
    }
    Err(io::Error::other(format!(
        "{AT_A_TIME} other runs of {name:?} keep theirs"
    )))
}
