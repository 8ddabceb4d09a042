//! The run of a log as a controller of the logged configuration computes it again: states of its
//! ticks, and when guard, filter and gate acted.

use hal::config::Source;
use hal::{ARM_NAMES, Chunk, PerArm, TimeNs};
use rtrb::RingBuffer;
use trocar_control::{AnyController, ControlConfig, OperatingState};
use trocar_log::replay::ReplayError;
use trocar_log::{BusesRecord, LogEnd, RunHeader, Step, TickRecord};

use super::super::facts::{EndFacts, EventFacts, Facts};
use super::super::log_images::Images;
use super::super::log_messages::LogMessages;
use super::super::log_scene::LogScene;
use super::super::log_states::States;
use super::super::path::paths;
use super::super::state::{State, refusal};
use super::super::tap::{ControlTap, seconds};
use super::{LogView, Seen};
use crate::mailbox::mailbox;
use crate::session::teleop::LoggedHands;
use crate::session::{PolicyChoice, SessionError};

/// Events that are told.
const EVENTS_MAX: usize = 2000;

/// After so long without, an intervention is another one, ticks. So that a run in contact for a
/// minute has one event and not sixty thousand.
const APART_TICKS: u64 = 500;

/// The run as a controller computes it again: what the second pass has come to.
pub(super) struct Recomputed {
    facts: Facts,
    controller: AnyController,
    tap: ControlTap,
    states: States,
    images: Images,
    scene: LogScene,
    buses: States,
    hands: Option<LoggedHands>,
    /// The newest that the controller was given.
    chunks: Option<PerArm<Chunk>>,
    events: Vec<EventFacts>,
    first: Option<(u64, TimeNs)>,
    last: Option<u64>,
    /// Periods that the control thread skipped, which are gaps in the ticks that no dropped record
    /// explains.
    skipped: u64,
    /// Sequence number of the newest chunk, by which a new one is known.
    sequences: Option<u64>,
    /// The arms' operating states in the tick that was kept last; one in which they differ is kept
    /// too.
    was: Vec<OperatingState>,
    /// The last tick in which the guard intervened; `corrected` is the same of the filter.
    intervened: Option<u64>,
    corrected: Option<u64>,
}

impl Recomputed {
    /// # Errors
    /// A log whose configuration is missing or gives no controller.
    pub(super) fn new(header: &RunHeader, seen: Seen) -> Result<Self, SessionError> {
        let config = config(header)?;
        let controller = AnyController::new(&config)
            .map_err(|error| ReplayError::Controller(error.to_string()))?;
        let title = if header.task.is_empty() {
            "robot"
        } else {
            &header.task
        };
        let Seen {
            images,
            scenes,
            buses,
            hands,
        } = seen;
        let by_hand = header.policy == PolicyChoice::Teleop.name();
        let names = images.cameras();
        let at_first = (names.as_slice(), &images.lenses(TimeNs(0)));
        let (scene, problem) = LogScene::new(header, scenes, &config.arms, at_first);
        let mut facts = Facts::new(title, &header.policy, header.seed, &config, names);
        facts = facts.drawn(scene.cameras());
        if let Some(seconds) = scene.time_limit_s() {
            facts = facts.within_s(seconds);
        }
        let unshown = problem.map(|problem| EventFacts {
            seconds: 0.0,
            text: format!("its scene can't be shown: {problem}"),
        });
        Ok(Self {
            facts,
            images,
            scene,
            buses,
            hands: LoggedHands::new(config.arms.len(), by_hand, hands),
            chunks: None,
            controller,
            tap: ControlTap::new(mailbox().0, mailbox().0, mailbox().0, RingBuffer::new(1).0),
            states: States::default(),
            events: unshown.into_iter().collect(),
            first: None,
            last: None,
            skipped: 0,
            sequences: None,
            was: Vec::new(),
            intervened: None,
            corrected: None,
        })
    }

    /// Computes one tick again. Commands are those of the log, whatever is computed, so that a log
    /// that differs shows what was sent. At a snapshot the controller takes the logged state over.
    pub(super) fn step(&mut self, step: &Step<'_>) -> Result<(), ReplayError> {
        let (logged, inputs) = (step.tick, step.inputs());
        // A log may hold other arms than its configuration.
        if inputs.count() != self.controller.arm_count() {
            return Ok(());
        }
        if let Some(snapshot) = step.snapshot {
            snapshot.restore(&mut self.controller)?;
        }
        let outputs = self.controller.tick(&inputs);
        let mut record = TickRecord::new(logged.tick, inputs, outputs, logged.timing);
        for (arm, logged) in record.arms.iter_mut().zip(logged.arms.iter()) {
            // What was sent, whatever this controller makes of it.
            arm.command = logged.command;
        }
        let before = self.last.replace(logged.tick);
        let next = before.map_or(logged.tick, |before| before.saturating_add(1));
        let gap = logged.tick.saturating_sub(next);
        self.skipped += gap.saturating_sub(step.dropped_before);
        if let Some(chunk) = step
            .chunks
            .first
            .filter(|chunk| self.sequences != Some(chunk.sequence))
        {
            self.sequences = Some(chunk.sequence);
            let chunks = PerArm {
                first: *chunk,
                second: step.chunks.second.flatten().copied(),
            };
            self.tap.chunk(&chunks, logged.now.since(chunk.observed_at));
            self.chunks = Some(chunks);
        }
        self.tap.tick(&record, &self.controller, self.skipped);
        self.keep(&record);
        Ok(())
    }

    /// States are made only for ticks that are kept, since a scene and a path are costly.
    fn keep(&mut self, record: &TickRecord) {
        let (first, _) = *self.first.get_or_insert((record.tick, record.now));
        self.note(record, first);
        let states: Vec<_> = record
            .arms
            .iter()
            .map(|arm| arm.report.mode.state)
            .collect();
        if self.states.wants(record.tick) || states != self.was {
            self.was = states;
            self.scene.measure(record);
            let state = self.state(record).json();
            self.states.keep(record.tick, state.into());
        }
    }

    /// What pages are told of this tick.
    fn state(&self, record: &TickRecord) -> State {
        let tick = record.now.tick();
        let mut lenses = self.images.lenses(record.now);
        let task = self.scene.stood(tick, &self.facts.cameras, &mut lenses);
        let bases = &self.facts.rcms_in_scene;
        let chunks = self.chunks.as_ref();
        let paths = chunks.map(|chunks| paths(chunks, record.now, bases, &lenses));
        let sample = self.tap.sample(record);
        let state = State::new(&sample, &self.facts, 0.0, task);
        let buses = self.buses.before(tick);
        let buses = buses.and_then(|message| BusesRecord::read(message.as_bytes()));
        let jaws_rad = record.arms.iter().map(|arm| arm.command.jaw_position);
        let hands = self.hands.as_ref();
        let state = state.by_hand(hands.and_then(|hands| hands.at(record.now, jaws_rad)));
        let state = state.on_buses(buses.unwrap_or_default().buses);
        state.towards(paths.unwrap_or_default())
    }

    /// Notes when guard, filter and gate began to act. An event is noted when it begins, and again
    /// after `APART_TICKS` without; refused chunks each.
    fn note(&mut self, record: &TickRecord, first: u64) {
        let begins = |last: &mut Option<u64>| {
            let before = last.replace(record.tick);
            before.is_none_or(|before| record.tick >= before.saturating_add(APART_TICKS))
        };
        for (name, arm) in ARM_NAMES.into_iter().zip(record.arms.iter()) {
            let mut text = None;
            if arm.report.guard_intervened && begins(&mut self.intervened) {
                text = Some(format!("{name}: the guard intervenes"));
            } else if arm.report.correction > 0.0 && begins(&mut self.corrected) {
                text = Some(format!("{name}: the filter limits the motion"));
            }
            if let Some(gate) = arm.report.gate.filter(|gate| !gate.is_accepted()) {
                text = Some(format!("{name}: a chunk is refused: {}", refusal(gate)));
            }
            if let Some(text) = text {
                let seconds = seconds(record.tick.saturating_sub(first));
                self.events.push(EventFacts { seconds, text });
            }
        }
    }

    /// What is left to do at the log's end: times of events, the outcome, the scene's file.
    pub(super) fn view(
        mut self,
        header: &RunHeader,
        end: &LogEnd,
        told: Vec<(TimeNs, String)>,
    ) -> LogView {
        let (first, from) = self.first.unwrap_or_default();
        self.events
            .extend(told.into_iter().map(|(at, text)| EventFacts {
                seconds: TimeNs(at.since(from)).seconds(),
                text,
            }));
        self.events
            .sort_by(|one, other| one.seconds.total_cmp(&other.seconds));
        // The end of a run is what one looks for.
        let surplus = self.events.len().saturating_sub(EVENTS_MAX);
        self.events.drain(..surplus);
        let length = self.last.unwrap_or(first).saturating_sub(first);
        let mut facts = self.facts.of_log(seconds(length));
        let scene_file = self.scene.file();
        facts.scene = scene_file.is_some();
        facts.events = self.events;
        facts.outcome = end.outcome.as_ref().map(|outcome| EndFacts {
            success: outcome.success.filter(|_| !header.task.is_empty()),
            reason: outcome.reason.clone(),
            said: (!outcome.said.is_empty()).then(|| outcome.said.to_string()),
        });
        LogView {
            facts,
            states: self.states,
            first: (first, from),
            images: self.images,
            has_buses: !self.buses.is_empty(),
            scene: self.scene,
            scene_file,
            messages: LogMessages::default(),
        }
    }
}

/// The controller's configuration of a logged run.
///
/// # Errors
/// `NoConfiguration` if the log lacks one of the two files; what is wrong with them.
fn config(header: &RunHeader) -> Result<ControlConfig, SessionError> {
    let source = |file: &'static str| {
        let text = header.text(file);
        let text = text.ok_or(ReplayError::NoConfiguration { file })?;
        Ok::<_, ReplayError>(Source::embedded(file, text))
    };
    let loaded = ControlConfig::load(&source("control.toml")?, &source("safety.toml")?);
    Ok(loaded.map_err(ReplayError::from)?)
}
