//! A run in real time as pages see it.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use super::facts::Facts;
use super::state::State;
use super::tap::Sample;
use crate::mailbox::MailboxReader;
use crate::rt::MonotonicClock;
use crate::session::operator::{Command, exchange};
use crate::session::teleop::Hands;
use hal::TimeNs;

/// The reading ends of a run.
#[derive(Debug)]
pub(super) struct Live {
    facts: Facts,
    samples: Mutex<Newest>,
    clock: MonotonicClock,
    /// Where the run listens for its operator, if it does.
    operator: Option<PathBuf>,
    hands: Arc<Hands>,
}

#[derive(Debug)]
struct Newest {
    from: MailboxReader<Sample>,
    newest: Option<(Sample, TimeNs)>,
    task: MailboxReader<&'static str>,
    missing: Option<&'static str>,
}

impl Live {
    pub(super) fn new(
        facts: Facts,
        (from, task): (MailboxReader<Sample>, MailboxReader<&'static str>),
        operator: Option<PathBuf>,
        hands: Arc<Hands>,
    ) -> Self {
        Self {
            facts,
            samples: Mutex::new(Newest {
                from,
                newest: None,
                task,
                missing: None,
            }),
            clock: MonotonicClock::new(),
            operator,
            hands,
        }
    }

    pub(super) fn facts(&self) -> String {
        self.facts.json()
    }

    /// The newest state; none before the first tick.
    pub(super) fn state(&self) -> Option<String> {
        let now = self.clock.now();
        let mut samples = self.samples.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(sample) = samples.from.take() {
            samples.newest = Some((sample, now));
        }
        samples.missing = samples.task.take().or(samples.missing);
        let (sample, since) = samples.newest.as_ref()?;
        let silent_s = TimeNs(now.since(*since)).seconds();
        let state = State::new(sample, &self.facts, silent_s, samples.missing);
        Some(state.by_hand(self.hands.status()).json())
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
