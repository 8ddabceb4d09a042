//! What a page may say, one JSON text a message, and how often.

use hal::TimeNs;
use serde::Deserialize;

use super::drawn::Stream;
use crate::session::operator::Command;
use crate::session::teleop::{EpisodeCommand, HandsMessage};
use trocar_log::RunMark;

/// Bytes that a message may have.
pub(super) const MESSAGE_BYTES_MAX: usize = 1024;

/// Streams that a page may watch.
const STREAMS_MAX: usize = 24;

/// A message of the page.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub(super) enum Request {
    /// So many messages have arrived since the last one of these.
    Seen(u32),
    /// The page wants to be the one that steers, or no longer.
    Steer(bool),
    /// A verb of the operator.
    Command(String),
    /// The pictures that are wanted, in the place of those before.
    Show(Vec<Stream>),
    /// The newest picture of a camera that a person has before their eyes: its camera and time, s.
    Shown((u8, f64)),
    /// The operator's hands.
    Hands(HandsMessage),
    /// The page is hidden or has lost the focus: hands let go.
    HandsOff(bool),
    /// What part of a hand's way the tip is to make.
    Scale(f64),
    /// Within which angle of its instrument a tracked controller is to engage, degrees.
    Align(f64),
    /// The policy is to drive again.
    HandBack(bool),
    /// What is to become of the demonstration.
    Episode(EpisodeCommand),
    /// How the run went, or that this is not said any more.
    Mark(Option<RunMark>),
    /// What the demonstration under way, or the run that asks for a mark, is called; nothing takes
    /// its label away.
    Label(String),
    /// Where in a log, or an episode of a dataset, to look, s from its beginning.
    At(f64),
    /// Which episode of a dataset to look at, from 0.
    Open(usize),
}

/// Why a message is none.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub(super) enum BadRequest {
    /// It is no JSON of ours.
    #[error("no message of the console: {0}")]
    Form(String),
    /// It asks for too much.
    #[error("{0} streams, allowed are up to {STREAMS_MAX}")]
    Streams(usize),
    /// It is nowhere.
    #[error("a place in a log is a finite number")]
    Place,
    /// It is of no time.
    #[error("a frame's time is a finite number, not negative")]
    Time,
}

impl Request {
    /// Reads a message.
    ///
    /// # Errors
    /// [`BadRequest`], which says what is wrong with it.
    pub(super) fn parse(text: &str) -> Result<Self, BadRequest> {
        let request = serde_json::from_str(text);
        let request = request.map_err(|error| BadRequest::Form(error.to_string()))?;
        match &request {
            Self::Show(streams) if streams.len() > STREAMS_MAX => {
                Err(BadRequest::Streams(streams.len()))
            }
            Self::At(seconds) if !seconds.is_finite() => Err(BadRequest::Place),
            Self::Shown((_, seconds)) if !(0.0..f64::INFINITY).contains(seconds) => {
                Err(BadRequest::Time)
            }
            // Hands, scale, alignment and label are checked where they are used.
            Self::Seen(_)
            | Self::Steer(_)
            | Self::Command(_)
            | Self::Show(_)
            | Self::Shown(_)
            | Self::Hands(_)
            | Self::HandsOff(_)
            | Self::Scale(_)
            | Self::Align(_)
            | Self::HandBack(_)
            | Self::Episode(_)
            | Self::Label(_)
            | Self::Mark(_)
            | Self::At(_)
            | Self::Open(_) => Ok(request),
        }
    }
}

/// The operator's command in `text`, which is exactly what the verbs of the command line say.
///
/// # Errors
/// What is wrong with it.
pub(super) fn command(text: &str) -> Result<Command, String> {
    text.parse()
        .map_err(|error: crate::session::operator::UnknownCommand| error.to_string())
}

/// A token bucket: it bounds the rate of messages.
#[derive(Clone, Copy, Debug)]
pub(super) struct TokenBucket {
    left: u64,
    filled: TimeNs,
}

/// What the store holds, and the time in which one message's worth comes back, ns: 400 a second. A
/// page sends hand poses at 125 Hz and, of six cameras, about 100 acknowledgements a second.
const STORE: u64 = 300;
const REFILL_NS: u64 = 2_500_000;

impl TokenBucket {
    /// A full store.
    pub(super) const fn new(now: TimeNs) -> Self {
        Self {
            left: STORE,
            filled: now,
        }
    }

    /// Takes one message's worth; `false` if there is none.
    pub(super) fn take(&mut self, now: TimeNs) -> bool {
        let more = now.since(self.filled) / REFILL_NS;
        self.filled = self.filled.plus_ns(more * REFILL_NS);
        self.left = self.left.saturating_add(more).min(STORE);
        let enough = self.left > 0;
        self.left = self.left.saturating_sub(1);
        enough
    }
}

#[cfg(test)]
mod tests {
    use super::super::drawn::Plane;
    use super::*;

    #[test]
    fn messages_are_read_and_nonsense_is_refused() {
        let stream = Stream {
            camera: 1,
            plane: Plane::Depth,
        };
        for (text, expected) in [
            (r#"{"seen":3}"#, Request::Seen(3)),
            (r#"{"steer":true}"#, Request::Steer(true)),
            (
                r#"{"command":"pause"}"#,
                Request::Command("pause".to_owned()),
            ),
            (r#"{"show":[[1,"depth"]]}"#, Request::Show(vec![stream])),
            (r#"{"at":1.5}"#, Request::At(1.5)),
            (r#"{"open":12}"#, Request::Open(12)),
            (r#"{"shown":[2,7.25]}"#, Request::Shown((2, 7.25))),
            (r#"{"mark":null}"#, Request::Mark(None)),
            (
                r#"{"mark":"discard"}"#,
                Request::Mark(Some(RunMark::Discard)),
            ),
            (
                r#"{"label":"third try"}"#,
                Request::Label("third try".to_owned()),
            ),
        ] {
            assert_eq!(Request::parse(text), Ok(expected), "{text}");
        }
        for text in [
            "",
            "{}",
            "[]",
            "null",
            r#"{"seen":-1}"#,
            r#"{"steer":1}"#,
            r#"{"set":"x"}"#,
            r#"{"at":null}"#,
            r#"{"at":1e999}"#,
            r#"{"open":-1}"#,
            r#"{"open":1.5}"#,
            r#"{"shown":[0,-1]}"#,
            r#"{"mark":"good"}"#,
            r#"{"mark":1}"#,
            r#"{"shown":[256,1]}"#,
            r#"{"show":[[256,"colour"]]}"#,
            r#"{"show":[[0,"raw"]]}"#,
            r#"{"seen":1,"steer":true}"#,
        ] {
            assert!(Request::parse(text).is_err(), "{text}");
        }
        let many = format!(r#"{{"show":[{}]}}"#, vec![r#"[0,"ids"]"#; 25].join(","));
        assert_eq!(Request::parse(&many), Err(BadRequest::Streams(25)));
        assert!(many.len() < MESSAGE_BYTES_MAX);
    }

    /// The page has the operator's verbs and nothing else.
    #[test]
    fn commands_are_those_of_the_operator() {
        for text in [
            "enable", "disable", "pause", "resume", "clear", "stop", "speed 40",
        ] {
            assert_eq!(command(text).unwrap().to_string(), text);
        }
        for text in [
            "speed 101",
            "speed 0",
            "speed -5",
            "limits",
            "set x=1",
            "Pause",
            "",
        ] {
            assert!(command(text).is_err(), "{text}");
        }
    }

    #[test]
    fn messages_run_out_and_come_back_with_time() {
        let mut allowance = TokenBucket::new(TimeNs(0));
        let taken = (0..1000).filter(|_| allowance.take(TimeNs(0))).count();
        assert_eq!(taken, 300);
        assert!(allowance.take(TimeNs(REFILL_NS)));
        assert!(!allowance.take(TimeNs(REFILL_NS)));
        let taken = (0..1000)
            .filter(|_| allowance.take(TimeNs(u64::MAX / 2)))
            .count();
        assert_eq!(taken, 300);
    }

    /// Hand poses at 125 Hz and the acknowledgements of six cameras' pictures are taken for as long
    /// as they go on, a flood is not.
    #[test]
    fn a_page_with_six_cameras_is_taken_and_a_flood_is_not() {
        let all_are_taken = |each_ns: u64| {
            let mut allowance = TokenBucket::new(TimeNs(0));
            (0..20_000).all(|message| allowance.take(TimeNs(message * each_ns)))
        };
        assert!(all_are_taken(1_000_000_000 / 222));
        assert!(!all_are_taken(1_000_000_000 / 500));
    }
}
