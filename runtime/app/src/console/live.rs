//! A run in real time as pages see it.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use super::facts::Facts;
use super::path::paths;
use super::pictures::Board;
use super::state::State;
use super::tap::Sample;
use crate::mailbox::MailboxReader;
use crate::rt::MonotonicClock;
use crate::session::operator::{Command, exchange};
use crate::session::teleop::Hands;
use hal::{Chunk, PerArm, Pose, TimeNs};

/// The reading ends of a run.
#[derive(Debug)]
pub(super) struct Live {
    facts: Facts,
    samples: Mutex<Newest>,
    clock: MonotonicClock,
    /// Where the run listens for its operator, if it does.
    operator: Option<PathBuf>,
    hands: Arc<Hands>,
    board: Arc<Board>,
}

/// What a run says of itself, through mailboxes.
#[derive(Debug)]
pub(super) struct Said {
    pub(super) samples: MailboxReader<Sample>,
    pub(super) task: MailboxReader<&'static str>,
    pub(super) chunks: MailboxReader<PerArm<Chunk>>,
}

#[derive(Debug)]
struct Newest {
    said: Said,
    newest: Option<(Sample, TimeNs)>,
    chunks: Option<PerArm<Chunk>>,
    missing: Option<&'static str>,
}

impl Live {
    pub(super) fn new(
        facts: Facts,
        said: Said,
        operator: Option<PathBuf>,
        (hands, board): (Arc<Hands>, Arc<Board>),
    ) -> Self {
        Self {
            facts,
            samples: Mutex::new(Newest {
                said,
                newest: None,
                chunks: None,
                missing: None,
            }),
            clock: MonotonicClock::new(),
            operator,
            hands,
            board,
        }
    }

    /// How many arms the run has, and its cameras.
    pub(super) fn arms_and_cameras(&self) -> (usize, Vec<String>) {
        (self.facts.arms.len(), self.facts.cameras.clone())
    }

    /// The newest tick with what was counted, and where the arms' remote centres are in the scene; none before the first tick.
    pub(super) fn sample(&self) -> Option<(Sample, Vec<Pose>)> {
        let samples = self.samples.lock().unwrap_or_else(PoisonError::into_inner);
        let (sample, _) = samples.newest?;
        Some((sample, self.facts.rcms_in_scene.clone()))
    }

    pub(super) fn facts(&self) -> String {
        self.facts.json()
    }

    /// The newest state; none before the first tick.
    pub(super) fn state(&self) -> Option<String> {
        let now = self.clock.now();
        let mut samples = self.samples.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(sample) = samples.said.samples.take() {
            samples.newest = Some((sample, now));
        }
        samples.missing = samples.said.task.take().or(samples.missing);
        samples.chunks = samples.said.chunks.take().or(samples.chunks);
        let (sample, since) = samples.newest.as_ref()?;
        let silent_s = TimeNs(now.since(*since)).seconds();
        let state = State::new(sample, &self.facts, silent_s, samples.missing);
        let paths = samples.chunks.as_ref().map(|chunks| {
            let bases = &self.facts.rcms_in_scene;
            paths(chunks, sample.record.now, bases, &self.board.lenses())
        });
        let state = state.by_hand(self.hands.status());
        Some(state.towards(paths.unwrap_or_default()).json())
    }

    /// Says `command` to the run, as the operator's verbs do; waits for the answer. Whether it is a yes, and the answer.
    pub(super) fn say(&self, command: Command) -> (bool, String) {
        let Some(socket) = &self.operator else {
            return (false, "no operator reaches this run".to_owned());
        };
        match exchange(socket, command, false) {
            Ok(answer) => (answer.starts_with("ok"), answer),
            Err(error) => (false, error.to_string()),
        }
    }
}
