//! The run's side: a thread that listens, and one for each operator that is connected.

use std::fs::{self, Permissions};
use std::io::{self, BufRead as _, BufReader, Read as _, Write as _};
use std::os::unix::fs::PermissionsExt as _;
use std::os::unix::net::{UnixListener, UnixStream};
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Mutex, OnceLock, PoisonError};
use std::thread::{self, Scope};
use std::time::Duration;

use rtrb::{Producer, RingBuffer};
use trocar_control::OperatorEvent;
use trocar_log::RunMark;

use super::{Command, OperatorPort, Query, Response, Status, place};
use crate::console::RunView;
use crate::mailbox::{MailboxReader, mailbox};
use crate::rt;
use crate::session::teleop::HandsMessageError;

/// Bytes that a line may have.
const LINE_MAX: u64 = 1000;
/// Operators at a time.
const OPERATORS_MAX: usize = 8;
/// Commands that may wait for the control thread.
const REQUESTS: usize = 16;
/// Polling period, ns.
const POLL_NS: u64 = 2_000_000;
/// Time that the control thread has for a command, ns.
const ANSWER_NS_MAX: u64 = 500_000_000;
/// Polling period for whether the run is over, for an operator that says nothing.
const SILENCE: Duration = Duration::from_millis(100);

/// What threads of the run have to do with the operator.
pub(in super::super) trait Served: Sync {
    /// The operator wants the run to end.
    fn stop(&self);
    /// Whether the arms come to rest, and then the run ends.
    fn ending(&self) -> bool;
    /// Whether it has ended.
    fn stopped(&self) -> bool;
}

/// A socket that a run listens at. Dropping it removes the socket.
#[derive(Debug)]
pub(in super::super) struct Listener {
    socket: UnixListener,
    path: PathBuf,
    desk: Mutex<Desk>,
    /// What the run does, for whoever looks on.
    view: OnceLock<RunView>,
    operators: AtomicUsize,
    /// Whether arms that were disabled may be enabled again.
    enables: bool,
}

#[derive(Debug)]
struct Desk {
    requests: Producer<OperatorEvent>,
    asked: u64,
    status: MailboxReader<Status>,
    newest: Option<Status>,
}

impl Desk {
    fn look(&mut self) -> Option<Status> {
        self.newest = self.status.take().or(self.newest);
        self.newest
    }
}

impl Drop for Listener {
    fn drop(&mut self) {
        let _gone = fs::remove_file(&self.path);
    }
}

impl Listener {
    /// Listens for operators of this process, and the control thread's end. Where set-points would
    /// run ahead of drives that take their time to switch on, `enables` is false.
    ///
    /// # Errors
    /// If the folder or the socket can't be made.
    pub(in super::super) fn open(enables: bool) -> io::Result<(Self, OperatorPort)> {
        let folder = place::folder()?;
        // Leftovers of runs that were killed.
        place::listening(&folder)?;
        let path = place::socket(&folder, &place::new_name());
        let socket = UnixListener::bind(&path)?;
        fs::set_permissions(&path, Permissions::from_mode(0o600))?;
        socket.set_nonblocking(true)?;
        let (requests, taken) = RingBuffer::new(REQUESTS);
        let (status_in, status) = mailbox();
        let desk = Desk {
            requests,
            asked: 0,
            status,
            newest: None,
        };
        let listener = Self {
            socket,
            path,
            desk: Mutex::new(desk),
            view: OnceLock::new(),
            operators: AtomicUsize::new(0),
            enables,
        };
        let port = OperatorPort {
            requests: Some(taken),
            status: status_in,
            handled: 0,
            tap: None,
        };
        Ok((listener, port))
    }

    /// Where it listens.
    pub(in super::super) fn path(&self) -> &Path {
        &self.path
    }

    /// From now on whoever asks is told what `view` says.
    pub(in super::super) fn show(&self, view: RunView) {
        let _shown_before = self.view.set(view);
    }

    /// Serves operators until the run has stopped.
    pub(in super::super) fn serve<'scope>(
        &'scope self,
        scope: &'scope Scope<'scope, '_>,
        served: &'scope dyn Served,
    ) {
        while !served.stopped() {
            match self.socket.accept() {
                Ok((mut stream, _)) => {
                    if self.operators.fetch_add(1, Ordering::Relaxed) < OPERATORS_MAX {
                        let begun = thread::Builder::new()
                            .spawn_scoped(scope, move || self.attend(&stream, served));
                        if begun.is_err() {
                            self.operators.fetch_sub(1, Ordering::Relaxed);
                        }
                    } else {
                        self.operators.fetch_sub(1, Ordering::Relaxed);
                        let _gone =
                            writeln!(stream, "error: {OPERATORS_MAX} operators are connected");
                    }
                }
                Err(_) => rt::sleep_ns(POLL_NS),
            }
        }
    }

    /// Answers one operator's lines until it goes or the run has stopped.
    fn attend(&self, stream: &UnixStream, served: &dyn Served) {
        let _done = self.answer_lines(stream, served);
        self.operators.fetch_sub(1, Ordering::Relaxed);
    }

    fn answer_lines(&self, mut stream: &UnixStream, served: &dyn Served) -> io::Result<()> {
        stream.set_nonblocking(false)?;
        stream.set_read_timeout(Some(SILENCE))?;
        stream.set_write_timeout(Some(SILENCE))?;
        let mut reader = BufReader::new(stream.take(LINE_MAX));
        let mut line = Vec::new();
        while !served.stopped() {
            reader.get_mut().set_limit(LINE_MAX);
            match reader.read_until(b'\n', &mut line) {
                Ok(_) if line.ends_with(b"\n") => {}
                Ok(0) if line.is_empty() => return Ok(()),
                Ok(1..) if (line.len() as u64) < LINE_MAX => continue,
                Ok(_) => {
                    return writeln!(
                        stream,
                        "error: a line has at most {LINE_MAX} bytes and an end"
                    );
                }
                Err(error) if is_silence(&error) => continue,
                Err(error) => return Err(error),
            }
            let text = String::from_utf8_lossy(&line).into_owned();
            writeln!(stream, "{}", self.answer(text.trim(), served))?;
            line.clear();
        }
        Ok(())
    }

    /// The answer to a line, as text or as JSON.
    fn answer(&self, line: &str, served: &dyn Served) -> String {
        if let (Some(view), Ok(look)) = (self.view.get(), line.parse()) {
            return match look {
                Query::Facts => view.facts(),
                Query::State => view.state().unwrap_or_else(|| "null".to_owned()),
            };
        }
        let (command, as_json) = match line.strip_suffix("json") {
            Some(command) => (command, true),
            None => (line, false),
        };
        let answer = match command.parse() {
            Ok(command) => self.obey(command, served),
            Err(error) => Response::of(None, Some(super::UnknownCommand::to_string(&error))),
        };
        if as_json {
            serde_json::to_string(&answer).unwrap_or_else(|error| format!("error: {error}"))
        } else {
            answer.to_string()
        }
    }

    fn obey(&self, command: Command, served: &dyn Served) -> Response {
        let status = self.look();
        let begun = || status.ok_or("the control loop has not begun");
        let done = match command {
            Command::Status => return self.tell(status.as_ref()),
            Command::Mark { mark, label } => {
                return match self.mark(mark, label.as_deref()) {
                    Ok(()) => self.tell(status.as_ref()),
                    Err(error) => Response::of(status.as_ref(), Some(error.to_string())),
                };
            }
            Command::Home => begun().and_then(|status| {
                let homed = status.arms.iter().all(|(mode, _)| mode.homed);
                homed.then_some(Some(status)).ok_or(
                    "an arm is not homed: it is while its joint positions are measured, and drives home during bring-up",
                )
            }),
            Command::Stop => {
                served.stop();
                Ok(status)
            }
            Command::Event(_) if served.ending() => {
                Err("the run is ending: a fault, a signal, its policy or the operator has ended it")
            }
            Command::Event(OperatorEvent::Enable) if !self.enables => {
                Err("drives are enabled at the beginning of a run alone: start a new one")
            }
            Command::Event(event) => match begun() {
                Ok(status) => return self.request(event, &status),
                Err(error) => Err(error),
            },
        };
        match done {
            Ok(status) => Response::of(status.as_ref(), None),
            Err(error) => Response::of(status.as_ref(), Some(error.to_owned())),
        }
    }

    /// What the arms are doing, and what a person says of the run.
    fn tell(&self, status: Option<&Status>) -> Response {
        Response {
            said: self.view.get().and_then(|view| view.hands().said()),
            ..Response::of(status, None)
        }
    }

    /// Marks the run, and labels it if `label` is given, as a page does.
    fn mark(&self, mark: Option<RunMark>, label: Option<&str>) -> Result<(), HandsMessageError> {
        let view = self.view.get().ok_or(HandsMessageError::NoMark)?;
        view.hands().say(mark, label)
    }

    /// Hands `event` to the control thread and waits for what comes of it.
    fn request(&self, event: OperatorEvent, status: &Status) -> Response {
        if let Some(state) = status.refuses(event) {
            let reason = format!("{} does not apply in {state}", Command::Event(event));
            return Response::of(Some(status), Some(reason));
        }
        let number = {
            let mut desk = self.desk.lock().unwrap_or_else(PoisonError::into_inner);
            if desk.requests.push(event).is_err() {
                let reason = "the control loop takes no commands".to_owned();
                return Response::of(Some(status), Some(reason));
            }
            desk.asked += 1;
            desk.asked
        };
        for _ in 0..ANSWER_NS_MAX / POLL_NS {
            if let Some(status) = self.look()
                && status.handled >= number
            {
                return Response::of(Some(&status), None);
            }
            rt::sleep_ns(POLL_NS);
        }
        let reason = format!(
            "no answer from the control loop in {} ms",
            ANSWER_NS_MAX / 1_000_000
        );
        Response::of(self.look().as_ref(), Some(reason))
    }

    fn look(&self) -> Option<Status> {
        self.desk
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .look()
    }
}

fn is_silence(error: &io::Error) -> bool {
    matches!(
        error.kind(),
        io::ErrorKind::WouldBlock | io::ErrorKind::TimedOut | io::ErrorKind::Interrupted
    )
}
