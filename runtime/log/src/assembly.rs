//! Puts the messages of a log together into ticks, and the metadata into what is known of the run.
//!
//! Messages of one tick come in this order: chunks and what happened, the second arm's measurement,
//! set-point and report with its tick message, the first arm's with timing and coordinate frames,
//! and last the first arm's tick message, which completes the tick. A message that a tick must have
//! once and has twice, or not at all, is an error: the bytes have changed, since a cut file ends
//! between whole chunks of the file.

use std::collections::{BTreeMap, BTreeSet};
use std::io::Read;
use std::path::Path;

use hal::{ARMS_MAX, Chunk, PerArm, TimeNs};
use mcap::records::MessageHeader;
use prost::Message;
use serde::de::DeserializeOwned;

use super::container::{self, Visitor};
use super::contents::ContentHash;
use super::error::LogError;
use super::header::{self, Closing, LogCounts, RunHeader, RunOutcome};
use super::joints;
use super::json::{ChunkMessage, TickMessage, TimingMessage};
use super::messages::{JointStates, Log};
use super::record::{LoggedArm, LoggedTick, TickTiming};
use super::snapshot::LoggedSnapshot;
use super::step::{LogEnd, Step};
use super::topic::Topic;
use trocar_control::OperatorEvent;

/// What a log holds, in order.
pub(super) enum Event<'a> {
    /// A tick.
    Step(Step<'a>),
    /// What happened in words.
    Text(String),
}

/// The metadata as they come.
#[derive(Default)]
pub(super) struct Facts {
    pub(super) header: RunHeader,
    /// Names of the metadata records that there were.
    seen: BTreeSet<String>,
    outcome: Option<RunOutcome>,
    pub(super) counts: Option<LogCounts>,
    /// Of the whole run; none of a file that another follows, whose hash is that of a moment.
    input_hash: Option<u64>,
    /// Whether the run goes on in another file.
    goes_on: bool,
    unknown_mark: Option<String>,
    /// The closing record's hash over the contents is missing or is not that of what was read.
    altered: bool,
}

impl Facts {
    /// Why a file that could be read to its end is not the whole run, if so.
    fn incomplete(&self) -> Option<String> {
        let left_out = self.header.left_out;
        if self.counts.is_none() {
            Some("the data end, but the record of how the run ended is missing".to_owned())
        } else if left_out > 0 {
            Some(format!("its bound left out the first {left_out} ticks"))
        } else if self.goes_on {
            Some("the run goes on in another file: its log was bounded".to_owned())
        } else {
            None
        }
    }
}

/// The messages of the tick that is not complete yet, and what is known of the whole.
pub(super) struct Assembly<F> {
    to: F,
    pub(super) facts: Facts,
    contents: ContentHash,
    /// What the next tick's number is if nothing was dropped; at first the ticks that a bound has
    /// left out.
    next_record: u64,
    /// Whether there was a tick.
    begun: bool,
    parts: [ArmParts; ARMS_MAX],
    /// The second arm, whose messages come before the first one's.
    second: Option<(TickMessage, LoggedArm)>,
    timing: Option<TimingMessage>,
    /// The controller's state since the last tick.
    snapshot: Option<LoggedSnapshot>,
}

/// An arm's messages of the tick that is not complete yet.
///
/// Filled by topic, emptied by the arm's tick message.
#[derive(Default)]
struct ArmParts {
    measured: Option<JointStates>,
    setpoint: Option<JointStates>,
    jaw: Option<JointStates>,
    chunk: Option<ChunkMessage>,
    report: Option<Box<[u8]>>,
}

impl<F: FnMut(&RunHeader, Event<'_>) -> Result<(), String>> Visitor for Assembly<F> {
    fn message(&mut self, topic: &str, header: &MessageHeader, data: &[u8]) -> Result<(), String> {
        if self.facts.counts.is_some() {
            return Err("a message after the record of how the run ended".to_owned());
        }
        self.contents.message(topic, header, data);
        let Some((topic, arm)) = Topic::find(topic) else {
            return Ok(());
        };
        let Some(parts) = self.parts.get_mut(arm) else {
            return Ok(());
        };
        match topic {
            Topic::MeasuredJs => fill(&mut parts.measured, protobuf(data)?)?,
            Topic::SetpointJs => fill(&mut parts.setpoint, protobuf(data)?)?,
            Topic::Jaw => fill(&mut parts.jaw, protobuf(data)?)?,
            // A chunk of a tick that was dropped may come before.
            Topic::Chunk => parts.chunk = Some(json(data)?),
            Topic::Safety => fill(&mut parts.report, data.into())?,
            Topic::Timing => fill(&mut self.timing, json(data)?)?,
            Topic::Tick => self.tick(arm, header.log_time, json(data)?)?,
            // For people; not part of what the controller was given or answered.
            Topic::Events => {
                let text = protobuf::<Log>(data)?.message;
                (self.to)(&self.facts.header, Event::Text(text))?;
            }
            Topic::Snapshot => self.snapshot(LoggedSnapshot::read(data)?)?,
            Topic::MeasuredCp | Topic::Transforms | Topic::Task | Topic::Buses => {}
        }
        Ok(())
    }

    fn metadata(&mut self, name: &str, map: BTreeMap<String, String>) -> Result<(), String> {
        if !self.facts.seen.insert(name.to_owned()) {
            return Err(format!("a second metadata record `{name}`"));
        }
        if name == header::OUTCOME {
            let closing = Closing::parse(&map).ok_or("the outcome lacks a count or a hash")?;
            self.facts.altered =
                closing.contents != Some(header::contents_after(&self.contents, &map));
            self.facts.unknown_mark = header::unknown_mark(&map);
            self.facts.outcome = closing.outcome;
            self.facts.counts = Some(closing.counts);
            self.facts.input_hash = Some(closing.input_hash).filter(|_| !closing.goes_on);
            self.facts.goes_on = closing.goes_on;
            return Ok(());
        }
        if self.begun {
            return Err(format!("metadata `{name}` after the first tick"));
        }
        self.contents.metadata(name, &map);
        if self.facts.header.absorb(name, map) {
            self.next_record = self.facts.header.left_out;
            Ok(())
        } else {
            Err(format!("metadata `{name}` lacks an entry"))
        }
    }
}

impl<F: FnMut(&RunHeader, Event<'_>) -> Result<(), String>> Assembly<F> {
    pub(super) fn new(to: F) -> Self {
        Self {
            to,
            facts: Facts::default(),
            contents: ContentHash::default(),
            next_record: 0,
            begun: false,
            parts: Default::default(),
            second: None,
            timing: None,
            snapshot: None,
        }
    }

    /// Reads a whole log.
    pub(super) fn read(&mut self, path: &Path, input: impl Read) -> Result<LogEnd, LogError> {
        let cut = container::walk(path, input, self)?;
        if !self.facts.seen.contains(header::RUN) {
            return Err(LogError::NotOurs {
                path: path.to_owned(),
                missing: "the metadata record `run`".to_owned(),
            });
        }
        let whole = cut.is_none() && self.facts.counts.is_some();
        Ok(LogEnd {
            outcome: self.facts.outcome.take(),
            unknown_mark: self.facts.unknown_mark.take(),
            input_hash: self.facts.input_hash,
            dropped_at_end: self.dropped_at_end(),
            cut: cut.or_else(|| self.facts.incomplete()),
            bounded: whole && (self.facts.header.left_out > 0 || self.facts.goes_on),
            altered: self.facts.altered,
            snapshot: self.snapshot.take(),
        })
    }

    /// Ticks that the logger dropped after the last one of the file.
    ///
    /// From the state that ends the file, if there is one, else from the counts of the closing
    /// record.
    fn dropped_at_end(&self) -> u64 {
        if let Some(snapshot) = &self.snapshot {
            return snapshot.record.saturating_sub(self.next_record);
        }
        if self.facts.goes_on {
            return 0;
        }
        let handed_over = self.facts.counts.map_or(0, |counts| {
            counts.ticks.saturating_add(counts.ticks_dropped)
        });
        handed_over.saturating_sub(self.next_record)
    }

    /// Keeps the controller's state for the tick that follows it.
    fn snapshot(&mut self, snapshot: LoggedSnapshot) -> Result<(), String> {
        if snapshot.record < self.next_record {
            return Err("the record numbers go backwards".to_owned());
        }
        fill(&mut self.snapshot, snapshot)
    }

    /// Takes the tick message of the arm `arm`, logged at `at_ns`: the first arm's completes the
    /// tick.
    fn tick(&mut self, arm: usize, at_ns: u64, message: TickMessage) -> Result<(), String> {
        if message.now_ns != at_ns {
            return Err(format!("tick {} has another time", message.tick));
        }
        if arm == 0 {
            self.complete(&message)
        } else {
            self.keep_second(message)
        }
    }

    /// Puts a tick together from the messages since the one before.
    fn complete(&mut self, message: &TickMessage) -> Result<(), String> {
        let [first, _] = &mut self.parts;
        let first = first.arm(message)?;
        let timing = self
            .timing
            .take()
            .filter(|timing| timing.tick == message.tick)
            .ok_or_else(|| lacks(message, "timing"))?;
        let dropped_before = self.gap(message)?;
        let (chunk, mut chunk_dropped) = self.take_chunk(0, message)?;
        let second = self.second.take();
        let mut second_chunk = None;
        if let Some((beside, _)) = &second {
            check_same_tick(message, beside)?;
            let (chunk, dropped) = self.take_chunk(1, beside)?;
            second_chunk = chunk;
            chunk_dropped |= dropped;
        }
        let tick = LoggedTick {
            tick: message.tick,
            now: TimeNs(message.now_ns),
            arms: PerArm {
                first,
                second: second.map(|(_, arm)| arm),
            },
            timing: TickTiming {
                wake_ns: timing.wake_ns,
                compute_ns: timing.compute_ns,
            },
        };
        let reports = self.parts.each_mut().map(|parts| parts.report.take());
        let mut chunks = [chunk.as_ref(), second_chunk.as_ref()].into_iter();
        let mut of_arm = reports.iter().map(Option::as_deref);
        let snapshot = self.snapshot.take();
        let step = Step {
            tick: &tick,
            chunks: tick.arms.as_ref().map(|_| chunks.next().flatten()),
            reports: tick.arms.as_ref().map(|_| of_arm.next().flatten()),
            dropped_before,
            chunk_dropped,
            snapshot: snapshot.as_ref(),
        };
        (self.to)(&self.facts.header, Event::Step(step))
    }

    /// Keeps the second arm until the first one completes the tick.
    fn keep_second(&mut self, message: TickMessage) -> Result<(), String> {
        let [_, second] = &mut self.parts;
        let arm = second.arm(&message)?;
        if let Some((before, _)) = self.second.replace((message, arm)) {
            return Err(format!("tick {} lacks its first arm", before.tick));
        }
        Ok(())
    }

    /// Ticks that were dropped before this one.
    ///
    /// The logger numbers every tick that it is handed, also those that it drops: a step of more
    /// than 1 is a loss.
    fn gap(&mut self, message: &TickMessage) -> Result<u64, String> {
        let count = message
            .record
            .checked_sub(self.next_record)
            .ok_or("the record numbers go backwards")?;
        self.begun = true;
        self.next_record = message
            .record
            .checked_add(1)
            .ok_or("the record number is out of range")?;
        Ok(count)
    }

    /// The chunk that an arm was given, and whether it was and is lost.
    ///
    /// A chunk whose record is not the one that the tick names belongs to a tick that was dropped;
    /// it is thrown away.
    fn take_chunk(
        &mut self,
        arm: usize,
        message: &TickMessage,
    ) -> Result<(Option<Chunk>, bool), String> {
        let chunk = self.parts[arm].chunk.take();
        let Some(wanted) = message.chunk else {
            return Ok((None, false));
        };
        match chunk.filter(|chunk| Some(chunk.record) == wanted.record) {
            Some(found) => {
                let chunk = found
                    .chunk()
                    .ok_or("a chunk has more targets than a chunk can hold")?;
                Ok((Some(chunk), false))
            }
            None => Ok((None, true)),
        }
    }
}

/// The second arm's message `beside` must be of the tick that the first arm's `message` completes.
fn check_same_tick(message: &TickMessage, beside: &TickMessage) -> Result<(), String> {
    let key = |message: &TickMessage| (message.record, message.tick, message.now_ns);
    if key(beside) == key(message) {
        return Ok(());
    }
    let (tick, other) = (message.tick, beside.tick);
    Err(format!(
        "tick {tick} comes with the second arm of tick {other}"
    ))
}

/// Keeps a message of which a tick has one.
fn fill<T>(slot: &mut Option<T>, message: T) -> Result<(), String> {
    match slot.replace(message) {
        None => Ok(()),
        Some(_) => Err("a second message of one tick".to_owned()),
    }
}

impl ArmParts {
    /// Puts the arm together from its messages since the tick before.
    fn arm(&mut self, message: &TickMessage) -> Result<LoggedArm, String> {
        let jaw = self.jaw.take().ok_or_else(|| lacks(message, "jaw"))?;
        let measured = match (message.error, self.measured.take()) {
            (Some(error), _) => Err(error.into()),
            (None, Some(states)) => {
                Ok(joints::state(&states, &jaw).ok_or_else(|| lacks(message, "measurement"))?)
            }
            (None, None) => return Err(lacks(message, "measurement")),
        };
        let setpoint = self.setpoint.take();
        let command = setpoint
            .and_then(|setpoint| joints::command(&setpoint, &jaw, message.enabled))
            .ok_or_else(|| lacks(message, "setpoint"))?;
        Ok(LoggedArm {
            measured,
            operator: message.operator.map(OperatorEvent::from),
            chunk_sequence: message.chunk.map(|chunk| chunk.sequence),
            command,
        })
    }
}

/// A message that belongs to each tick is missing.
fn lacks(message: &TickMessage, what: &str) -> String {
    format!("tick {} lacks its {what}", message.tick)
}

fn protobuf<T: Message + Default>(data: &[u8]) -> Result<T, String> {
    T::decode(data).map_err(|error| error.to_string())
}

fn json<T: DeserializeOwned>(data: &[u8]) -> Result<T, String> {
    serde_json::from_slice(data).map_err(|error| error.to_string())
}
