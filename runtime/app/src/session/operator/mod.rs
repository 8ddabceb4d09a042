//! The operator: CRTK's commands to a run in real time, over a local socket, one line each, and
//! what its arms are doing.
//!
//! `server` listens in the run, `client` is the verbs `trocar status`, `pause` and so on. Both
//! speak this: a line with a command ([`Command`]), `json` behind it for an answer as JSON; the
//! answer is one line too. Who looks on ([`Query`]) is told what the console's pages are. The
//! socket is of mode 0600 in a folder of mode 0700: whoever may use it is the run's own user.

mod client;
mod place;
mod server;

use std::fmt;
use std::str::FromStr;

use hal::{ARM_NAMES, Chunk, PerArm};
use serde::Serialize;
use trocar_control::{AnyController, Fault, Mode, OperatingState, OperatorEvent};
use trocar_log::{RunMark, RunNote, TickRecord};

use crate::console::ControlTap;
use crate::mailbox::{MailboxWriter, mailbox};

pub(crate) use client::exchange;
pub use client::{Ask, QueryClient, ask};
pub use place::check;
pub(super) use server::{Listener, Served};

/// The word for no mark.
const NO_MARK: &str = "none";

/// What an operator can say.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Command {
    /// Nothing: what are the arms doing?
    Status,
    /// Homing is part of bring-up: whether the arms are homed.
    Home,
    /// End the run: the arms come to rest first.
    Stop,
    /// How a run went that no task judges.
    Mark {
        /// How; none takes the mark back.
        mark: Option<RunMark>,
        /// What the run is called from now on; as before if not given.
        label: Option<String>,
    },
    /// Something for the controller.
    Event(OperatorEvent),
}

/// A line that is no command.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "{0:?} is no command: status, enable, disable, pause, resume, home, clear, stop, speed PERCENT with 1 to 100, or mark success, failure, discard or none, and a label as a JSON string or not, each with json behind it or not"
)]
pub struct UnknownCommand(String);

/// A request of a read-only client; the answer is one line of JSON.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Query {
    /// What does not change while the run goes on.
    Facts,
    /// The newest state; `null` before the first tick.
    State,
}

impl Query {
    const fn word(self) -> &'static str {
        match self {
            Self::Facts => "facts",
            Self::State => "state",
        }
    }
}

impl FromStr for Query {
    type Err = UnknownCommand;

    fn from_str(line: &str) -> Result<Self, UnknownCommand> {
        let known = [Self::Facts, Self::State];
        let found = known.into_iter().find(|look| look.word() == line);
        found.ok_or_else(|| UnknownCommand(line.to_owned()))
    }
}

impl FromStr for Command {
    type Err = UnknownCommand;

    fn from_str(line: &str) -> Result<Self, UnknownCommand> {
        if let Some(said) = line.trim().strip_prefix("mark ") {
            return mark(said).ok_or_else(|| UnknownCommand(line.to_owned()));
        }
        let mut words = line.split_ascii_whitespace();
        let command = match (words.next(), words.next(), words.next()) {
            (Some("status"), None, None) => Self::Status,
            (Some("home"), None, None) => Self::Home,
            (Some("stop"), None, None) => Self::Stop,
            (Some("enable"), None, None) => Self::Event(OperatorEvent::Enable),
            (Some("disable"), None, None) => Self::Event(OperatorEvent::Disable),
            (Some("pause"), None, None) => Self::Event(OperatorEvent::Pause),
            (Some("resume"), None, None) => Self::Event(OperatorEvent::Resume),
            (Some("clear"), None, None) => Self::Event(OperatorEvent::Clear),
            (Some("speed"), Some(percent), None) => match percent.parse() {
                Ok(percent @ 1..=100) => Self::Event(OperatorEvent::Speed { percent }),
                _ => return Err(UnknownCommand(line.to_owned())),
            },
            _ => return Err(UnknownCommand(line.to_owned())),
        };
        Ok(command)
    }
}

/// What `mark` is said with: the mark's name, and behind it a label as a JSON string or none.
fn mark(said: &str) -> Option<Command> {
    let said = said.trim();
    let (name, label) = match said.split_once(' ') {
        Some((name, label)) => (name, Some(serde_json::from_str(label).ok()?)),
        None => (said, None),
    };
    let mark = match name {
        NO_MARK => None,
        name => Some(RunMark::named(name)?),
    };
    Some(Command::Mark { mark, label })
}

impl fmt::Display for Command {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Status => f.write_str("status"),
            Self::Home => f.write_str("home"),
            Self::Stop => f.write_str("stop"),
            Self::Mark { mark, label } => {
                write!(f, "mark {}", mark.map_or(NO_MARK, RunMark::name))?;
                match label {
                    Some(label) => write!(f, " {}", serde_json::Value::from(label.as_str())),
                    None => Ok(()),
                }
            }
            Self::Event(OperatorEvent::Enable) => f.write_str("enable"),
            Self::Event(OperatorEvent::Disable) => f.write_str("disable"),
            Self::Event(OperatorEvent::Pause) => f.write_str("pause"),
            Self::Event(OperatorEvent::Resume) => f.write_str("resume"),
            Self::Event(OperatorEvent::Clear) => f.write_str("clear"),
            Self::Event(OperatorEvent::Speed { percent }) => write!(f, "speed {percent}"),
            // Hands say so, not words.
            Self::Event(OperatorEvent::TakeOver) => f.write_str("take over"),
            Self::Event(OperatorEvent::HandBack) => f.write_str("hand back"),
            // And the run itself.
            Self::Event(OperatorEvent::GoOn) => f.write_str("go on"),
        }
    }
}

/// What a run says of itself after a tick. Plain data, so that the control thread hands it over
/// without allocating.
#[derive(Clone, Copy, Debug)]
pub(super) struct Status {
    /// Count of the control periods.
    tick: u64,
    /// Commands of the operator that the controller has had.
    handled: u64,
    arms: PerArm<(Mode, Option<Fault>)>,
}

impl Status {
    /// The state in which `event` does nothing, if it does nothing for any arm.
    fn refuses(&self, event: OperatorEvent) -> Option<OperatingState> {
        use OperatingState::{Disabled, Enabled, Fault, Paused};
        let applies = |state: OperatingState| match event {
            OperatorEvent::Enable => matches!(state, Disabled | Enabled),
            OperatorEvent::Disable => matches!(state, Disabled | Enabled | Paused),
            OperatorEvent::Pause | OperatorEvent::Resume | OperatorEvent::GoOn => {
                matches!(state, Enabled | Paused)
            }
            OperatorEvent::Clear => state == Fault,
            OperatorEvent::Speed { .. } | OperatorEvent::TakeOver | OperatorEvent::HandBack => true,
        };
        let states = || self.arms.iter().map(|(mode, _)| mode.state);
        let applies_to_one = states().any(applies);
        states().next().filter(|_| !applies_to_one)
    }
}

/// The control thread's end: what the operator asks for, and where to say what came of it. Hot
/// path: bounded, no allocation, never waits.
#[derive(Debug)]
pub(super) struct OperatorPort {
    /// None where nobody listens.
    requests: Option<rtrb::Consumer<OperatorEvent>>,
    status: MailboxWriter<Status>,
    handled: u64,
    /// The console's, if there is one.
    pub(super) tap: Option<ControlTap>,
}

impl OperatorPort {
    /// One that no operator reaches.
    pub(super) fn unreachable() -> Self {
        Self {
            requests: None,
            status: mailbox().0,
            handled: 0,
            tap: None,
        }
    }

    /// What the operator asks for next, if anything.
    pub(super) fn next(&mut self) -> Option<OperatorEvent> {
        let request = self.requests.as_mut()?.pop().ok()?;
        self.handled += 1;
        Some(request)
    }

    /// Says that these chunks were handed to the controller, so long after their observation.
    pub(super) fn chunk(&mut self, chunks: &PerArm<Chunk>, latency_ns: u64) {
        if let Some(tap) = &mut self.tap {
            tap.chunk(chunks, latency_ns);
        }
    }

    /// Says what the arms did, and how many periods have been skipped since the run began.
    pub(super) fn report(&mut self, record: &TickRecord, controller: &AnyController, skipped: u64) {
        if let Some(tap) = &mut self.tap {
            tap.tick(record, controller, skipped);
        }
        let arms = record.arms.map(|arm| (arm.report.mode, arm.report.fault));
        self.status.put(Status {
            tick: record.tick,
            handled: self.handled,
            arms,
        });
    }
}

/// The answer to a line.
#[derive(Clone, Debug, PartialEq, Serialize)]
struct Response {
    ok: bool,
    /// Why not.
    error: Option<String>,
    /// Seconds since the run began, of control.
    seconds: Option<f64>,
    arms: Vec<ArmResponse>,
    /// Present if it was asked for, and a person may say how the run went: what they say.
    #[serde(skip_serializing_if = "Option::is_none")]
    said: Option<RunNote>,
}

#[derive(Clone, Debug, PartialEq, Serialize)]
struct ArmResponse {
    name: &'static str,
    /// CRTK's operating state.
    state: &'static str,
    homed: bool,
    busy: bool,
    fault: Option<String>,
}

impl Response {
    fn of(status: Option<&Status>, error: Option<String>) -> Self {
        let arms = status.iter().flat_map(|status| status.arms.iter());
        #[expect(clippy::cast_precision_loss, reason = "ticks of some days")]
        let seconds = status.map(|status| status.tick as f64 * hal::TICK_S);
        Self {
            ok: error.is_none(),
            error,
            seconds,
            arms: ARM_NAMES
                .iter()
                .zip(arms)
                .map(|(&name, (mode, fault))| ArmResponse {
                    name,
                    state: mode.state.name(),
                    homed: mode.homed,
                    busy: mode.busy,
                    fault: fault.map(|fault| fault.to_string()),
                })
                .collect(),
            said: None,
        }
    }
}

impl fmt::Display for Response {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.error {
            None => f.write_str("ok")?,
            Some(error) => write!(f, "error: {error}")?,
        }
        if let Some(seconds) = self.seconds {
            write!(f, "; {seconds:.2} s")?;
        }
        for arm in &self.arms {
            write!(f, "; {} {}", arm.name, arm.state)?;
            f.write_str(if arm.homed { " homed" } else { " not homed" })?;
            f.write_str(if arm.busy { " moving" } else { "" })?;
            if let Some(fault) = &arm.fault {
                write!(f, " ({fault})")?;
            }
        }
        match &self.said {
            Some(said) => write!(f, "; {said}"),
            None => Ok(()),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::{Command, OperatorEvent, RunMark};

    #[test]
    fn commands_are_read_as_they_are_written() {
        for text in [
            "status",
            "home",
            "stop",
            "enable",
            "disable",
            "pause",
            "resume",
            "clear",
            "speed 40",
            "mark success",
            "mark failure",
            "mark none",
            r#"mark discard """#,
            r#"mark none "the \"third\" try.json""#,
        ] {
            let command: Command = text.parse().unwrap();
            assert_eq!(command.to_string(), text);
        }
        let percent = 100;
        let full = Command::Event(OperatorEvent::Speed { percent });
        assert_eq!(" speed  100 ".parse(), Ok(full));
        let marked = Command::Mark {
            mark: Some(RunMark::Discard),
            label: Some("two\nlines".to_owned()),
        };
        assert_eq!(marked.to_string(), r#"mark discard "two\nlines""#);
        assert_eq!(r#" mark  discard   "two\nlines" "#.parse(), Ok(marked));
        for text in [
            "",
            "Pause",
            "speed",
            "speed 0",
            "speed 101",
            "speed 1 2",
            "pause now",
            "mark",
            "mark good",
            "mark success third try",
            r#"mark success "third" "try""#,
            "mark success 3",
            r#"mark "third try""#,
        ] {
            let refused = text.parse::<Command>().unwrap_err();
            assert!(refused.to_string().contains("is no command: status"));
        }
    }
}
