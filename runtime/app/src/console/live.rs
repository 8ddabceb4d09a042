//! A run in real time as pages see it. The control thread writes mailboxes and a queue (`tap`);
//! whoever asks for a state here takes the newest. States are computed on demand, and that delays
//! no tick.

use std::path::PathBuf;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use super::facts::Facts;
use super::path::paths;
use super::pictures::Board;
use super::state::State;
use super::tap::Sample;
use super::viewers::Message;
use crate::mailbox::MailboxReader;
use crate::rig::can_traffic::Buses;
use crate::rt::MonotonicClock;
use crate::session::operator::{Command, exchange};
use crate::session::scene_record;
use crate::session::teleop::Hands;
use hal::{Chunk, PerArm, TimeNs};
use rtrb::Consumer;
use trocar_log::live::{self, StateChanges};
use trocar_log::{BusRecord, TickRecord};
use trocar_topics::TaskReport;

/// The reading ends of a run.
#[derive(Debug)]
pub(super) struct Live {
    facts: Facts,
    /// Whether it has a scene that the facts do not know of.
    scene: AtomicBool,
    samples: Mutex<Newest>,
    clock: MonotonicClock,
    /// Where the run listens for its operator, if it does.
    operator: Option<PathBuf>,
    hands: Arc<Hands>,
    board: Arc<Board>,
    /// Those of arms on CAN.
    buses: Mutex<Buses>,
}

/// Mailboxes with a run's newest state.
#[derive(Debug)]
pub(super) struct RunMailboxes {
    pub(super) samples: MailboxReader<Sample>,
    pub(super) task: MailboxReader<TaskReport>,
    pub(super) chunks: MailboxReader<PerArm<Chunk>>,
    /// Ticks in which something happened.
    pub(super) noted: Consumer<TickRecord>,
}

/// What was last taken out of the mailboxes, since each value can be taken once.
#[derive(Debug)]
struct Newest {
    said: RunMailboxes,
    newest: Option<(Sample, TimeNs)>,
    chunks: Option<PerArm<Chunk>>,
    task: Option<TaskReport>,
    happened: StateChanges,
    /// When the tick was that viewers were told of last.
    previous: TimeNs,
}

impl Live {
    pub(super) fn new(
        facts: Facts,
        said: RunMailboxes,
        operator: Option<PathBuf>,
        (hands, board): (Arc<Hands>, Arc<Board>),
    ) -> Self {
        Self {
            buses: Mutex::new(Buses::named(facts.buses.0.iter())),
            facts,
            scene: AtomicBool::new(false),
            samples: Mutex::new(Newest {
                said,
                newest: None,
                chunks: None,
                task: None,
                happened: StateChanges::new(),
                previous: TimeNs(0),
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

    /// What the newest tick says in the log's form; nothing before the first.
    pub(super) fn messages(&self) -> Vec<Message> {
        let mut samples = self.samples.lock().unwrap_or_else(PoisonError::into_inner);
        let Some((Sample { record, .. }, _)) = samples.newest else {
            return Vec::new();
        };
        let previous = std::mem::replace(&mut samples.previous, record.now);
        let messages = live::tick(&record, previous, &self.facts.rcms_in_scene);
        let messages = messages.into_iter();
        messages
            .map(|(topic, data)| Message::new(topic, record.now, data))
            .collect()
    }

    /// What has happened since this was last asked: in words, and what was said of safety then.
    pub(super) fn happened(&self) -> Vec<Message> {
        let mut samples = self.samples.lock().unwrap_or_else(PoisonError::into_inner);
        let mut messages = Vec::new();
        while let Ok(record) = samples.said.noted.pop() {
            let lines = samples.happened.since(&record).into_iter();
            messages.extend(lines.map(|(level, text)| Message::event(record.now, level, &text)));
            let safety = live::safety(&record);
            messages.extend(safety.map(|(topic, data)| Message::new(topic, record.now, data)));
        }
        messages
    }

    /// When the newest tick was.
    pub(super) fn now(&self) -> TimeNs {
        let samples = self.samples.lock().unwrap_or_else(PoisonError::into_inner);
        let newest = samples.newest.as_ref();
        newest.map_or(TimeNs(0), |(sample, _)| sample.record.now)
    }

    /// From now on it has a scene.
    pub(super) fn has_scene(&self) {
        self.scene.store(true, Ordering::Relaxed);
    }

    /// The hands of whoever steers it, which say how it went too.
    pub(super) const fn hands(&self) -> &Arc<Hands> {
        &self.hands
    }

    pub(super) fn facts(&self) -> String {
        if self.scene.load(Ordering::Relaxed) {
            return self.facts.clone().with_scene().json();
        }
        self.facts.json()
    }

    /// The newest state; none before the first tick. It is computed anew for each call, from the
    /// newest tick; `silent_s` counts from when that was first seen here.
    pub(super) fn state(&self) -> Option<String> {
        let now = self.clock.now();
        let mut samples = self.samples.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(sample) = samples.said.samples.take() {
            samples.newest = Some((sample, now));
        }
        samples.task = samples.said.task.take().or(samples.task);
        samples.chunks = samples.said.chunks.take().or(samples.chunks);
        let (sample, since) = samples.newest.as_ref()?;
        let silent_s = TimeNs(now.since(*since)).seconds();
        let task = samples.task.as_ref().map(scene_record::task);
        let state = State::new(sample, &self.facts, silent_s, task);
        let paths = samples.chunks.as_ref().map(|chunks| {
            let bases = &self.facts.rcms_in_scene;
            paths(chunks, sample.record.now, bases, &self.board.lenses())
        });
        let state = state.by_hand(self.hands.status());
        let state = state.of_which(self.hands.said()).on_buses(self.buses());
        Some(state.towards(paths.unwrap_or_default()).json())
    }

    /// Counts of the kernel for the arms' interfaces; empty of arms that are not on CAN.
    fn buses(&self) -> Vec<BusRecord> {
        let mut buses = self.buses.lock().unwrap_or_else(PoisonError::into_inner);
        buses.look();
        buses.record(self.facts.buses.1).buses
    }

    /// Says `command` to the run, as the operator's verbs do; waits for the answer. Whether it is a
    /// yes, and the answer.
    pub(super) fn say(&self, command: &Command) -> (bool, String) {
        let Some(socket) = &self.operator else {
            return (false, "no operator reaches this run".to_owned());
        };
        match exchange(socket, command, false) {
            Ok(answer) => (answer.starts_with("ok"), answer),
            Err(error) => (false, error.to_string()),
        }
    }
}
