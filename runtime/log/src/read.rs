//! Reads a run's log back: every tick with the chunks that it was given, bit for bit.

use std::collections::BTreeMap;
use std::fs;
use std::path::Path;

use hal::{Chunk, TimeNs};
use mcap::records::MessageHeader;
use prost::Message;
use serde::de::DeserializeOwned;

use super::container::{self, Visitor};
use super::error::LogError;
use super::header::{self, Closing, LogCounts, RunHeader, RunOutcome};
use super::joints;
use super::json::{ChunkMessage, TickMessage, TimingMessage};
use super::messages::{JointStates, Log};
use super::record::{LoggedArm, LoggedTick, TickTiming};
use super::topic::Topic;
use hal::{ARMS_MAX, PerArm};
use trocar_control::OperatorEvent;

/// A log in memory.
#[derive(Clone, Debug, Default)]
pub struct RunLog {
    /// How the run was set up.
    pub header: RunHeader,
    /// How it ended; `None` if it was not closed properly.
    pub outcome: Option<RunOutcome>,
    /// What was written; `None` if the file was cut.
    pub counts: Option<LogCounts>,
    /// Hash over everything that the controller was given, taken while it ran; `None` if the file was cut.
    pub input_hash: Option<u64>,
    /// Where the logger had to leave something out; empty if nothing is missing.
    pub losses: Vec<Loss>,
    /// What happened in words, in order; for people, and no part of what a replay needs.
    pub events: Vec<String>,
    cut: Option<String>,
    ticks: Vec<LoggedTick>,
    /// By the position of their tick, for each arm.
    chunks: [BTreeMap<usize, Chunk>; ARMS_MAX],
}

/// Something that the controller saw and the log lacks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Loss {
    /// Ticks were dropped.
    Ticks {
        /// How many ticks of the log come before them.
        position: usize,
        /// How many were dropped.
        count: u64,
    },
    /// The chunk of a tick was dropped.
    Chunk {
        /// The tick that was given it.
        tick: u64,
    },
}

impl RunLog {
    /// Reads the log at `path`, up to the cut if it was cut.
    ///
    /// # Errors
    /// [`LogError`] when there is no such file, it is no log of ours, or bytes in it have changed.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        let bytes = fs::read(path).map_err(|source| LogError::Read {
            path: path.to_owned(),
            source,
        })?;
        Self::from_bytes(path, &bytes)
    }

    /// Reads a log from memory; `path` is for messages.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self, LogError> {
        let mut assembly = Assembly::default();
        let cut = container::walk(path, bytes, &mut assembly)?;
        if !assembly.has_header {
            return Err(LogError::NotOurs {
                path: path.to_owned(),
                missing: "the metadata record `run`".to_owned(),
            });
        }
        let mut log = assembly.log;
        let unclosed = || "the data end, but the record of how the run ended is missing".to_owned();
        log.cut = cut.or_else(|| log.counts.is_none().then(unclosed));
        if let Some(counts) = log.counts {
            let handed_over = counts.ticks.saturating_add(counts.ticks_dropped);
            let count = handed_over.saturating_sub(assembly.next_record);
            if count > 0 {
                log.losses.push(Loss::Ticks {
                    position: log.ticks.len(),
                    count,
                });
            }
        }
        Ok(log)
    }

    /// The ticks in order, each with the chunks that its arms were given.
    pub fn ticks(&self) -> impl ExactSizeIterator<Item = (&LoggedTick, PerArm<Option<&Chunk>>)> {
        let [first, second] = &self.chunks;
        self.ticks.iter().enumerate().map(|(index, tick)| {
            let mut chunks = [first.get(&index), second.get(&index)].into_iter();
            let given = tick.arms.as_ref().map(|_| chunks.next().flatten());
            (tick, given)
        })
    }

    /// Why the file ends before its end, if it does.
    #[must_use]
    pub fn cut(&self) -> Option<&str> {
        self.cut.as_deref()
    }

    /// How many ticks there are.
    #[must_use]
    pub fn tick_count(&self) -> usize {
        self.ticks.len()
    }

    /// Text of the configuration file `name`, as the run used it.
    #[must_use]
    pub fn text(&self, name: &str) -> Option<&str> {
        self.header.texts.get(name).map(String::as_str)
    }
}

/// The log as it grows, and the messages of the tick that is not complete yet.
#[derive(Default)]
struct Assembly {
    log: RunLog,
    has_header: bool,
    next_record: u64,
    parts: [ArmParts; ARMS_MAX],
    /// The second arm, whose messages come before the first one's.
    second: Option<(TickMessage, LoggedArm)>,
    timing: Option<TimingMessage>,
}

/// An arm's messages of the tick that is not complete yet.
#[derive(Default)]
struct ArmParts {
    measured: Option<JointStates>,
    setpoint: Option<JointStates>,
    jaw: Option<JointStates>,
    chunk: Option<ChunkMessage>,
}

impl Visitor for Assembly {
    fn message(&mut self, topic: &str, _: &MessageHeader, data: &[u8]) -> Result<(), String> {
        let Some((topic, arm)) = Topic::find(topic) else {
            return Ok(());
        };
        let Some(parts) = self.parts.get_mut(arm) else {
            return Ok(());
        };
        match topic {
            Topic::MeasuredJs => parts.measured = Some(protobuf(data)?),
            Topic::SetpointJs => parts.setpoint = Some(protobuf(data)?),
            Topic::Jaw => parts.jaw = Some(protobuf(data)?),
            Topic::Chunk => parts.chunk = Some(json(data)?),
            Topic::Timing => self.timing = Some(json(data)?),
            Topic::Tick if arm == 0 => self.complete(&json(data)?)?,
            Topic::Tick => self.keep_second(json(data)?)?,
            // For people; not part of what the controller was given or answered.
            Topic::Events => self.log.events.push(protobuf::<Log>(data)?.message),
            Topic::MeasuredCp | Topic::Safety => {}
        }
        Ok(())
    }

    fn metadata(&mut self, name: &str, map: BTreeMap<String, String>) -> Result<(), String> {
        if name == header::OUTCOME {
            let closing = Closing::parse(&map).ok_or("the outcome lacks a count or a hash")?;
            self.log.outcome = closing.outcome;
            self.log.counts = Some(closing.counts);
            self.log.input_hash = Some(closing.input_hash);
            return Ok(());
        }
        self.has_header |= name == header::RUN;
        if self.log.header.absorb(name, map) {
            Ok(())
        } else {
            Err(format!("metadata `{name}` lacks an entry"))
        }
    }
}

impl Assembly {
    /// Puts a tick together from the messages since the one before.
    fn complete(&mut self, message: &TickMessage) -> Result<(), String> {
        let [first, _] = &mut self.parts;
        let first = first.arm(message)?;
        let timing = self
            .timing
            .take()
            .filter(|timing| timing.tick == message.tick)
            .ok_or_else(|| lacks(message, "timing"))?;
        self.note_gap(message)?;
        self.take_chunk(0, message)?;
        let second = self.second.take();
        if let Some((beside, _)) = &second {
            let key = |message: &TickMessage| (message.record, message.tick, message.now_ns);
            if key(beside) != key(message) {
                return Err(format!(
                    "tick {} comes with the second arm of tick {}",
                    message.tick, beside.tick
                ));
            }
            self.take_chunk(1, beside)?;
        }
        self.log.ticks.push(LoggedTick {
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
        });
        Ok(())
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

    fn note_gap(&mut self, message: &TickMessage) -> Result<(), String> {
        let count = message
            .record
            .checked_sub(self.next_record)
            .ok_or("the record numbers go backwards")?;
        if count > 0 {
            self.log.losses.push(Loss::Ticks {
                position: self.log.ticks.len(),
                count,
            });
        }
        self.next_record = message
            .record
            .checked_add(1)
            .ok_or("the record number is out of range")?;
        Ok(())
    }

    fn take_chunk(&mut self, arm: usize, message: &TickMessage) -> Result<(), String> {
        let chunk = self.parts[arm].chunk.take();
        let Some(wanted) = message.chunk else {
            return Ok(());
        };
        match chunk.filter(|chunk| Some(chunk.record) == wanted.record) {
            Some(found) => {
                let chunk = found
                    .chunk()
                    .ok_or("a chunk has more targets than a chunk can hold")?;
                self.log.chunks[arm].insert(self.log.ticks.len(), chunk);
            }
            None => self.log.losses.push(Loss::Chunk { tick: message.tick }),
        }
        Ok(())
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

fn lacks(message: &TickMessage, what: &str) -> String {
    format!("tick {} lacks its {what}", message.tick)
}

fn protobuf<T: Message + Default>(data: &[u8]) -> Result<T, String> {
    T::decode(data).map_err(|error| error.to_string())
}

fn json<T: DeserializeOwned>(data: &[u8]) -> Result<T, String> {
    serde_json::from_slice(data).map_err(|error| error.to_string())
}
