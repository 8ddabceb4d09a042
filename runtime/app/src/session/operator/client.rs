//! The verbs' side: finds the run, says a line, and gives back the answer.

use std::io::{self, BufRead as _, BufReader, Write as _};
use std::os::unix::net::UnixStream;
use std::path::{Path, PathBuf};
use std::time::Duration;

use super::{Command, Query, place};
use crate::session::SessionError;

/// A run that does not answer for this long hangs.
const PATIENCE: Duration = Duration::from_secs(5);

/// Which run is asked, and how it answers.
#[derive(Clone, Debug, Default)]
pub struct Ask {
    /// The run, by its process; the only run of this user if not given.
    pub run: Option<String>,
    /// Whether the answer is JSON.
    pub json: bool,
}

/// Says `command` to a run. Its answer, one line, and whether it is a yes.
///
/// # Errors
/// [`SessionError::BadArgument`] if there is no such run, or more than one to choose from;
/// [`SessionError::RealTime`] if it does not answer.
pub fn ask(command: Command, ask: &Ask) -> Result<(String, bool), SessionError> {
    let folder = place::folder().map_err(|error| {
        SessionError::RealTime(format!("the folder of this user's runs: {error}"))
    })?;
    let socket = find(&folder, ask.run.as_deref())?;
    let answer = exchange(&socket, &command, ask.json)
        .map_err(|error| SessionError::RealTime(format!("{}: {error}", socket.display())))?;
    let yes = answer.starts_with("ok") || answer.starts_with("{\"ok\":true");
    Ok((answer, yes))
}

/// A read-only client of a run, over a connection that is kept open.
#[derive(Debug)]
pub struct QueryClient {
    stream: BufReader<UnixStream>,
    socket: PathBuf,
}

impl QueryClient {
    /// Connects to the run of this process, or to the only one of this user.
    ///
    /// # Errors
    /// Those of [`ask`].
    pub fn of(run: Option<&str>) -> Result<Self, SessionError> {
        let failed = |error: io::Error| SessionError::RealTime(format!("the run: {error}"));
        let folder = place::folder().map_err(failed)?;
        let socket = find(&folder, run)?;
        let stream = connect(&socket).map_err(failed)?;
        Ok(Self {
            stream: BufReader::new(stream),
            socket,
        })
    }

    /// What the run answers, JSON.
    ///
    /// # Errors
    /// If the run has ended, or hangs.
    pub fn query(&mut self, look: Query) -> io::Result<String> {
        let line = format!("{}\n", look.word());
        self.stream.get_mut().write_all(line.as_bytes())?;
        answer(&mut self.stream)
    }

    /// Says `command` to the run; its answer.
    ///
    /// # Errors
    /// If the run has ended, or hangs.
    pub fn say(&self, command: &Command) -> io::Result<String> {
        exchange(&self.socket, command, false)
    }
}

fn find(folder: &Path, run: Option<&str>) -> Result<PathBuf, SessionError> {
    let found = place::listening(folder)
        .map_err(|error| SessionError::RealTime(format!("{}: {error}", folder.display())))?;
    if let Some(run) = run {
        let wanted = place::socket(folder, run);
        return if found.contains(&wanted) {
            Ok(wanted)
        } else {
            Err(SessionError::BadArgument(format!(
                "--run {run}: no run in real time of this user is process {run}"
            )))
        };
    }
    match found.as_slice() {
        [only] => Ok(only.clone()),
        [] => Err(SessionError::BadArgument(
            "no run in real time of this user listens for an operator".to_owned(),
        )),
        several => {
            let names: Vec<_> = several
                .iter()
                .filter_map(|path| path.file_stem()?.to_str()?.strip_prefix("run-"))
                .collect();
            Err(SessionError::BadArgument(format!(
                "{} runs of this user listen: choose one with --run {}",
                several.len(),
                names.join(" or ")
            )))
        }
    }
}

/// Says `command` at `socket`, for an answer as JSON or as text, one line; no longer than
/// [`PATIENCE`] for each way.
///
/// # Errors
/// If the run does not answer.
pub(crate) fn exchange(socket: &Path, command: &Command, json: bool) -> io::Result<String> {
    let mut stream = connect(socket)?;
    let form = if json { " json" } else { "" };
    stream.write_all(format!("{command}{form}\n").as_bytes())?;
    answer(&mut BufReader::new(stream))
}

fn connect(socket: &Path) -> io::Result<UnixStream> {
    let stream = UnixStream::connect(socket)?;
    stream.set_read_timeout(Some(PATIENCE))?;
    stream.set_write_timeout(Some(PATIENCE))?;
    Ok(stream)
}

/// The next line.
fn answer(stream: &mut BufReader<UnixStream>) -> io::Result<String> {
    let mut answer = String::new();
    stream.read_line(&mut answer)?;
    if answer.is_empty() {
        let text = "the run ended without an answer";
        return Err(io::Error::new(io::ErrorKind::UnexpectedEof, text));
    }
    Ok(answer.trim_end().to_owned())
}
