//! A log as pages see it: states of all its ticks, recomputed by a controller of the logged configuration, its images, and what happened.

use std::collections::BTreeMap;
use std::path::Path;

use axum::body::Bytes;
use hal::config::Source;
use hal::{ARM_NAMES, PerArm, TimeNs};
use rtrb::RingBuffer;
use trocar_control::{AnyController, ControlConfig, OperatingState, TickInput};
use trocar_log::live;
use trocar_log::replay::ReplayError;
use trocar_log::{LogEnd, LoggedItem, RunHeader, Step, TickRecord, read_items, read_steps};

use super::encode;
use super::facts::{EndFacts, EventFacts, Facts};
use super::log_messages::LogMessages;
use super::pictures::{Plane, Stream};
use super::state::{State, refusal};
use super::tap::{ControlTap, seconds};
use super::viewers::Message;
use crate::mailbox::mailbox;
use crate::session::SessionError;

/// Ticks from one state that is kept to the next, at first.
const EVERY_TICKS: u64 = 20;

/// Bytes of states that are kept, of some twenty minutes of one arm; of longer logs they are further apart.
const STATE_BYTES_MAX: usize = 64 << 20;

/// Bytes of images that are kept; of more, every second one goes.
const IMAGE_BYTES_MAX: usize = 256 << 20;

/// Events that are told.
const EVENTS_MAX: usize = 2000;

/// How a JPEG begins.
const JPEG: &[u8] = &[0xff, 0xd8];

/// After so long without, an intervention is another one, ticks.
const APART_TICKS: u64 = 500;

/// A log in memory.
#[derive(Debug)]
pub(super) struct LogView {
    facts: Facts,
    /// By tick.
    states: BTreeMap<u64, Box<str>>,
    first: u64,
    images: Images,
    messages: LogMessages,
}

impl LogView {
    /// Reads the log at `path`, with its messages for viewers if `views`.
    ///
    /// # Errors
    /// [`SessionError::Log`] or [`SessionError::Replay`].
    pub(super) fn read(path: &Path, views: bool) -> Result<Self, SessionError> {
        let mut images = Images::default();
        let mut events = Vec::new();
        let mut messages = LogMessages::default();
        read_items(path, |shown| match shown {
            LoggedItem::Image { camera, at, image } => images.keep(camera, at, image),
            LoggedItem::Event { at, text } => events.push((at, text.to_owned())),
            LoggedItem::Message { topic, at, data }
                if views && live::camera_of(topic).is_none() =>
            {
                messages.keep(topic, at, data);
            }
            LoggedItem::Message { .. } => {}
        })?;
        let mut recomputed = None;
        let (header, end) = read_steps(path, |header, step| -> Result<(), SessionError> {
            let recomputed = match &mut recomputed {
                Some(recomputed) => recomputed,
                None => recomputed.insert(Recomputed::new(header, images.cameras())?),
            };
            recomputed.step(step);
            Ok(())
        })?;
        let recomputed = recomputed.ok_or(ReplayError::Empty)?;
        let view = recomputed.view(&header, &end, images, events);
        Ok(Self { messages, ..view })
    }

    /// How many arms it is of, and the cameras that it has images of.
    pub(super) fn arms_and_cameras(&self) -> (usize, Vec<String>) {
        (self.facts.arms.len(), self.facts.cameras.clone())
    }

    /// How long it is, s.
    pub(super) fn seconds(&self) -> f64 {
        self.facts.seconds.unwrap_or_default()
    }

    /// The log's own time `seconds` after its first tick.
    pub(super) fn time(&self, seconds: f64) -> TimeNs {
        TimeNs::from_tick(self.tick(seconds))
    }

    /// What `topic` says as the time goes from `before` to `at`: its newest message, or all of a topic of which each counts.
    pub(super) fn messages(&self, topic: &str, before: Option<TimeNs>, at: TimeNs) -> Vec<Message> {
        let Some(camera) = live::camera_of(topic) else {
            return self.messages.at(topic, before, at);
        };
        let cameras = self.facts.cameras.iter();
        let index = cameras.zip(0..).find(|(name, _)| *name == camera);
        let found = index.and_then(|(_, index)| self.images.at(index, at));
        let image = found.map(|(number, message)| {
            let at = TimeNs(number - 1);
            let image = message.get(encode::HEAD..).unwrap_or_default();
            let format = if image.starts_with(JPEG) {
                "jpeg"
            } else {
                "png"
            };
            Message {
                topic: topic.to_owned().into(),
                at,
                data: live::image(at, camera, format, image).into(),
            }
        });
        image.into_iter().collect()
    }

    /// What a page is told first.
    pub(super) fn facts(&self) -> String {
        self.facts.json()
    }

    /// The state `seconds` after the log's first tick, or the nearest before it.
    pub(super) fn state(&self, seconds: f64) -> Option<String> {
        let tick = self.tick(seconds);
        let at = self.states.range(..=tick).next_back();
        let (_, state) = at.or_else(|| self.states.first_key_value())?;
        Some(state.to_string())
    }

    /// The image of `stream` at that time, and a number that is its own.
    pub(super) fn picture(&self, stream: Stream, seconds: f64) -> Option<(u64, Bytes)> {
        if stream.plane != Plane::Colour {
            return None;
        }
        self.images
            .at(stream.camera, TimeNs::from_tick(self.tick(seconds)))
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "saturates, which is the log's end or its beginning"
    )]
    fn tick(&self, seconds: f64) -> u64 {
        self.first.saturating_add((seconds * 1e3).round() as u64)
    }
}

/// Images by camera, in the order in which cameras first come.
#[derive(Debug, Default)]
struct Images {
    cameras: Vec<(String, BTreeMap<TimeNs, Bytes>)>,
    bytes: usize,
    /// Of so many images one is kept.
    stride: u64,
    seen: u64,
}

impl Images {
    fn cameras(&self) -> Vec<String> {
        self.cameras.iter().map(|(name, _)| name.clone()).collect()
    }

    fn keep(&mut self, camera: &str, at: TimeNs, image: &[u8]) {
        let known = self.cameras.iter().position(|(name, _)| name == camera);
        let index = known.unwrap_or(self.cameras.len());
        if known.is_none() {
            self.cameras.push((camera.to_owned(), BTreeMap::new()));
        }
        self.seen += 1;
        let (Ok(number), Some((_, kept))) = (u8::try_from(index), self.cameras.get_mut(index))
        else {
            return;
        };
        if !kept.is_empty() && !self.seen.is_multiple_of(self.stride.max(1)) {
            return;
        }
        let stream = Stream {
            camera: number,
            plane: Plane::Colour,
        };
        let mut message = encode::head(stream, at);
        message.extend_from_slice(image);
        self.bytes += message.len();
        kept.insert(at, message.into());
        if self.bytes > IMAGE_BYTES_MAX {
            self.thin_out();
        }
    }

    /// Lets every second image go.
    fn thin_out(&mut self) {
        self.stride = 2 * self.stride.max(1);
        for (_, kept) in &mut self.cameras {
            let mut index = 0;
            kept.retain(|_, _| {
                index += 1;
                index % 2 == 1
            });
        }
        let sizes = self.cameras.iter().flat_map(|(_, kept)| kept.values());
        self.bytes = sizes.map(Bytes::len).sum();
    }

    fn at(&self, camera: u8, at: TimeNs) -> Option<(u64, Bytes)> {
        let (_, kept) = self.cameras.get(usize::from(camera))?;
        let before = kept.range(..=at).next_back();
        let (stamp, image) = before.or_else(|| kept.first_key_value())?;
        Some((stamp.0 + 1, image.clone()))
    }
}

/// States by tick, a bounded number of bytes.
#[derive(Debug)]
struct States {
    kept: BTreeMap<u64, Box<str>>,
    bytes: usize,
    every_ticks: u64,
}

impl Default for States {
    fn default() -> Self {
        Self {
            kept: BTreeMap::new(),
            bytes: 0,
            every_ticks: EVERY_TICKS,
        }
    }
}

impl States {
    fn wants(&self, tick: u64) -> bool {
        let newest = self.kept.last_key_value();
        newest.is_none_or(|(newest, _)| tick >= newest + self.every_ticks)
    }

    fn keep(&mut self, tick: u64, state: Box<str>) {
        self.bytes += state.len();
        self.kept.insert(tick, state);
        if self.bytes > STATE_BYTES_MAX {
            self.thin_out();
        }
    }

    /// Lets those go that are less than twice as far apart as before.
    fn thin_out(&mut self) {
        self.every_ticks *= 2;
        let (every_ticks, mut newest) = (self.every_ticks, None);
        self.kept.retain(|tick, _| {
            let keeps = newest.is_none_or(|newest| *tick >= newest + every_ticks);
            newest = if keeps { Some(*tick) } else { newest };
            keeps
        });
        self.bytes = self.kept.values().map(|state| state.len()).sum();
    }
}

/// The run as a controller computes it again.
struct Recomputed {
    facts: Facts,
    controller: AnyController,
    tap: ControlTap,
    states: States,
    events: Vec<EventFacts>,
    first: Option<u64>,
    last: Option<u64>,
    skipped: u64,
    sequences: Option<u64>,
    was: Vec<OperatingState>,
    intervened: Option<u64>,
    corrected: Option<u64>,
}

impl Recomputed {
    fn new(header: &RunHeader, cameras: Vec<String>) -> Result<Self, SessionError> {
        let config = config(header)?;
        let controller = AnyController::new(&config)
            .map_err(|error| ReplayError::Controller(error.to_string()))?;
        let title = if header.task.is_empty() {
            "robot"
        } else {
            &header.task
        };
        Ok(Self {
            facts: Facts::new(title, &header.policy, header.seed, &config, cameras),
            controller,
            tap: ControlTap::new(mailbox().0, mailbox().0, mailbox().0, RingBuffer::new(1).0),
            states: States::default(),
            events: Vec::new(),
            first: None,
            last: None,
            skipped: 0,
            sequences: None,
            was: Vec::new(),
            intervened: None,
            corrected: None,
        })
    }

    fn step(&mut self, step: &Step<'_>) {
        let logged = step.tick;
        let given = logged.arms.as_ref().zip(step.chunks);
        let inputs: PerArm<TickInput<'_>> = given.map(|(arm, chunk)| TickInput {
            now: logged.now,
            measured: arm.measured,
            chunk,
            operator: arm.operator,
        });
        let Some(outputs) = self.controller.tick(&inputs) else {
            return;
        };
        let mut record = TickRecord::new(logged.tick, inputs, outputs, logged.timing);
        for (arm, logged) in record.arms.iter_mut().zip(logged.arms.iter()) {
            // What was sent, whatever this controller makes of it.
            arm.command = logged.command;
        }
        let before = self.last.replace(logged.tick);
        let gap = before.map_or(0, |before| logged.tick.saturating_sub(before + 1));
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
        }
        self.tap.tick(&record, &self.controller, self.skipped);
        self.keep(&record);
    }

    fn keep(&mut self, record: &TickRecord) {
        let first = *self.first.get_or_insert(record.tick);
        self.note(record, first);
        let states: Vec<_> = record
            .arms
            .iter()
            .map(|arm| arm.report.mode.state)
            .collect();
        if self.states.wants(record.tick) || states != self.was {
            self.was = states;
            let sample = self.tap.sample(record);
            let state = State::new(&sample, &self.facts, 0.0, None).json();
            self.states.keep(record.tick, state.into());
        }
    }

    /// Notes when guard, filter and gate began to act.
    fn note(&mut self, record: &TickRecord, first: u64) {
        let begins = |last: &mut Option<u64>| {
            let before = last.replace(record.tick);
            before.is_none_or(|before| record.tick >= before + APART_TICKS)
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
                let seconds = seconds(record.tick - first);
                self.events.push(EventFacts { seconds, text });
            }
        }
    }

    fn view(
        mut self,
        header: &RunHeader,
        end: &LogEnd,
        images: Images,
        told: Vec<(TimeNs, String)>,
    ) -> LogView {
        let first = self.first.unwrap_or(0);
        let from = TimeNs::from_tick(first);
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
        let length = self.last.unwrap_or(first) - first;
        let mut facts = self.facts.of_log(seconds(length));
        facts.events = self.events;
        facts.outcome = end.outcome.as_ref().map(|outcome| EndFacts {
            success: outcome.success.filter(|_| !header.task.is_empty()),
            reason: outcome.reason.clone(),
        });
        LogView {
            facts,
            states: self.states.kept,
            first,
            images,
            messages: LogMessages::default(),
        }
    }
}

/// The controller's configuration of a logged run.
fn config(header: &RunHeader) -> Result<ControlConfig, SessionError> {
    let source = |file: &'static str| {
        let text = header.text(file);
        let text = text.ok_or(ReplayError::NoConfiguration { file })?;
        Ok::<_, ReplayError>(Source::embedded(file, text))
    };
    let loaded = ControlConfig::load(&source("control.toml")?, &source("safety.toml")?);
    Ok(loaded.map_err(ReplayError::from)?)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A log of hours takes no more than one of minutes: its states are further apart, from its beginning to its end.
    #[test]
    fn states_of_a_long_log_take_bounded_memory() {
        let mut states = States::default();
        let state = "x".repeat(64 << 10);
        let last = EVERY_TICKS * 5000;
        for tick in 0..=last {
            if states.wants(tick) {
                states.keep(tick, state.as_str().into());
            }
        }
        assert!(states.bytes <= STATE_BYTES_MAX && states.bytes > STATE_BYTES_MAX / 4);
        assert_eq!(states.bytes, states.kept.len() * state.len());
        let (first, newest) = (states.kept.first_key_value(), states.kept.last_key_value());
        assert_eq!(first.map(|(tick, _)| *tick), Some(0));
        assert!(newest.is_some_and(|(tick, _)| last - tick < states.every_ticks));
        let ticks: Vec<u64> = states.kept.keys().copied().collect();
        let apart = ticks.windows(2).map(|two| two[1] - two[0]);
        assert_eq!(apart.max(), Some(states.every_ticks));
    }
}
