//! A run in real time, seen in a terminal, with the operator's commands as keys.
//!
//! It asks the run over its operator's socket for what pages of the console are told, ten times a
//! second: `seen` reads that, `draw` and `timing` draw it; `rig/can_traffic` counts frames on the
//! CAN interfaces of this machine. Nothing is kept between two looks but the newest state, so that
//! a terminal that stalls delays nothing and loses nothing but what it did not show.

mod draw;
mod seen;
mod timing;
mod tone;

use std::io::{self, IsTerminal as _};
use std::time::Duration;

use ratatui::DefaultTerminal;
use ratatui::crossterm::event::{self, Event, KeyCode, KeyEvent, KeyEventKind, KeyModifiers};

use crate::rig::can_traffic::Buses;
use crate::rt;
use crate::session::SessionError;
use crate::session::operator::{Command, Query, QueryClient};
use seen::{Facts, State};
use trocar_control::OperatorEvent;
use trocar_log::{RunMark, RunNote};

/// Time from one look to the next.
const LOOK: Duration = Duration::from_millis(100);

/// Steps of the speed keys, percent. What comes of it is kept within 1 to 100.
const SPEED_STEP: u8 = 10;

/// What is on the screen. One for the whole time; `draw` reads it and changes nothing.
#[derive(Debug)]
struct Screen {
    facts: Facts,
    /// None before the first tick.
    state: Option<State>,
    buses: Buses,
    /// The last key's command, and what the run answered.
    answer: Answer,
}

/// What a run answered to a command.
#[derive(Debug, Default)]
struct Answer {
    /// The command, then the answer in the run's own words.
    text: String,
    refused: bool,
}

impl Screen {
    /// What a person says of the run; none if it takes no mark.
    fn note(&self) -> Option<&RunNote> {
        self.state.as_ref()?.said.as_ref()
    }
}

/// What a key asks for.
///
/// All but the end go to the run's socket.
#[derive(Clone, Debug, PartialEq, Eq)]
enum KeyAction {
    Quit,
    Send(Command),
}

/// Shows the run of process `run`, or the only one of this user, until it ends or the person
/// leaves. The terminal is put back as it was in either case, and after a signal.
///
/// # Errors
/// [`SessionError::BadArgument`] if there is no such run, or no terminal;
/// [`SessionError::RealTime`] if the terminal or the run fails.
pub fn monitor(run: Option<&str>) -> Result<(), SessionError> {
    if !io::stdout().is_terminal() || !io::stdin().is_terminal() {
        let reason = "monitor needs a terminal; for scripts there is `trocar status --json`";
        return Err(SessionError::BadArgument(reason.to_owned()));
    }
    let failed = |error: io::Error| SessionError::RealTime(format!("monitor: {error}"));
    let mut client = QueryClient::of(run)?;
    let facts = client.query(Query::Facts).map_err(failed)?;
    let facts = serde_json::from_str(&facts).map_err(|error| failed(error.into()))?;
    let mut screen = Screen {
        facts,
        state: None,
        buses: Buses::find(),
        answer: Answer::default(),
    };
    // A signal ends it with the terminal as it was.
    rt::catch_interrupts().map_err(failed)?;
    let mut terminal = ratatui::try_init().map_err(|error| {
        ratatui::restore();
        failed(error)
    })?;
    let shown = show(&mut terminal, &mut client, &mut screen);
    ratatui::restore();
    shown.map_err(failed)
}

/// Looks and draws until the run ends or the person leaves. A key is answered at once; without one
/// the next look is after `LOOK`.
fn show(
    terminal: &mut DefaultTerminal,
    client: &mut QueryClient,
    screen: &mut Screen,
) -> io::Result<()> {
    loop {
        if rt::interrupted() {
            return Ok(());
        }
        let state = match client.query(Query::State) {
            Ok(state) => state,
            Err(error) if is_end(&error) => return Ok(()),
            Err(error) => {
                let text = format!("the run does not answer: {error}");
                return Err(io::Error::new(error.kind(), text));
            }
        };
        let state: Option<State> = serde_json::from_str(&state)?;
        screen.buses.look();
        screen.state = state.or(screen.state.take());
        terminal.draw(|frame| draw::screen(frame, screen))?;
        if !event::poll(LOOK)? {
            continue;
        }
        let Event::Key(key) = event::read()? else {
            continue;
        };
        let percent = screen.state.as_ref().map(|state| state.speed_percent);
        let mark = screen.note().and_then(|note| note.mark);
        match wish(key, percent.unwrap_or(100), mark) {
            Some(KeyAction::Quit) => return Ok(()),
            Some(KeyAction::Send(command)) => screen.answer = said(client, &command),
            None => {}
        }
    }
}

/// Whether the run has closed its socket, as it does at its end.
fn is_end(error: &io::Error) -> bool {
    use io::ErrorKind::{BrokenPipe, ConnectionReset, UnexpectedEof};
    matches!(error.kind(), BrokenPipe | ConnectionReset | UnexpectedEof)
}

/// An error of the socket is an answer too.
fn said(client: &QueryClient, command: &Command) -> Answer {
    let answer = client.say(command);
    let answer = answer.unwrap_or_else(|error| format!("error: {error}"));
    Answer {
        text: format!("{command}: {answer}"),
        refused: answer.starts_with("error: "),
    }
}

/// What `key` asks for, of a run whose speed limits are at `percent` and whose mark is `mark`. Keys
/// are those of `draw`'s last line. Only presses count, not repeats or releases where a terminal
/// tells them apart.
fn wish(key: KeyEvent, percent: u8, mark: Option<RunMark>) -> Option<KeyAction> {
    if key.kind != KeyEventKind::Press {
        return None;
    }
    let KeyCode::Char(letter) = key.code else {
        return (key.code == KeyCode::Esc).then_some(KeyAction::Quit);
    };
    if key.modifiers.contains(KeyModifiers::CONTROL) {
        return (letter == 'c').then_some(KeyAction::Quit);
    }
    let speed = |percent| OperatorEvent::Speed { percent };
    let event = match letter {
        'q' => return Some(KeyAction::Quit),
        's' => return Some(KeyAction::Send(Command::Stop)),
        'p' => OperatorEvent::Pause,
        'r' => OperatorEvent::Resume,
        'e' => OperatorEvent::Enable,
        'd' => OperatorEvent::Disable,
        'c' => OperatorEvent::Clear,
        '-' => speed(percent.saturating_sub(SPEED_STEP).max(1)),
        '+' => speed(percent.saturating_add(SPEED_STEP).min(100)),
        _ => return marks(letter, mark).map(KeyAction::Send),
    };
    Some(KeyAction::Send(Command::Event(event)))
}

/// The mark that a key sets, with the letters of the console's page; the key of the mark that the
/// run has (`set`) takes it back.
fn marks(letter: char, set: Option<RunMark>) -> Option<Command> {
    let mark = match letter {
        'y' => RunMark::Success,
        'z' => RunMark::Failure,
        'x' => RunMark::Discard,
        _ => return None,
    };
    let mark = Some(mark).filter(|mark| set != Some(*mark));
    Some(Command::Mark { mark, label: None })
}

#[cfg(test)]
mod tests;
