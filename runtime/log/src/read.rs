//! Reads a run's log back: every tick with the chunks that it was given, bit for bit, step by step or as a whole.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{self, File};
use std::io::{self, BufReader, Read};
use std::path::Path;

use hal::{Chunk, TimeNs};
use mcap::records::MessageHeader;
use prost::Message;
use serde::de::DeserializeOwned;

use super::container::{self, Visitor};
use super::contents::Contents;
use super::error::LogError;
use super::header::{self, Closing, LogCounts, RunHeader, RunOutcome};
use super::joints;
use super::json::{ChunkMessage, TickMessage, TimingMessage};
use super::messages::{JointStates, Log};
use super::record::{LoggedArm, LoggedTick, TickTiming};
use super::topic::Topic;
use hal::{ARMS_MAX, PerArm};
use trocar_control::OperatorEvent;

/// A log in memory: 1 kB a tick. [`read_steps`] reads one of any length.
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
    altered: bool,
    ticks: Vec<LoggedTick>,
    /// By the position of their tick, for each arm.
    chunks: [BTreeMap<usize, Chunk>; ARMS_MAX],
    /// Each arm's safety report in each tick, as it was written.
    reports: Vec<PerArm<Option<Box<[u8]>>>>,
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

/// One tick of a log with all that belongs to it.
#[derive(Clone, Copy, Debug)]
pub struct Step<'a> {
    /// What the controller was given and answered.
    pub tick: &'a LoggedTick,
    /// The chunk that each arm was given.
    pub chunks: PerArm<Option<&'a Chunk>>,
    /// Each arm's safety report, the JSON of its message.
    pub reports: PerArm<Option<&'a [u8]>>,
    /// Ticks just before it that the logger dropped.
    pub dropped_before: u64,
    /// Whether the logger dropped a chunk that it was given.
    pub chunk_dropped: bool,
}

/// What is known at the end of a log.
#[derive(Clone, Debug, Default)]
pub struct LogEnd {
    /// How the run ended; `None` if the log was not closed properly.
    pub outcome: Option<RunOutcome>,
    /// Hash over everything that the controller was given, taken while it ran; `None` if the file was cut.
    pub input_hash: Option<u64>,
    /// Ticks that the logger dropped after the last one that it wrote.
    pub dropped_at_end: u64,
    /// Why the file ends before its end, if it does.
    pub cut: Option<String>,
    /// Whether the log is not what the run wrote: something was changed, put in or taken away.
    pub altered: bool,
}

/// Reads the log at `path` tick by tick, up to the cut if it was cut: each tick goes to `each` with the run's header. No more than a tick
/// is in memory at a time.
///
/// # Errors
/// [`LogError`] when there is no such file, it is no log of ours, or bytes in it have changed; what `each` says.
pub fn read_steps<E: From<LogError>>(
    path: &Path,
    mut each: impl FnMut(&RunHeader, &Step<'_>) -> Result<(), E>,
) -> Result<(RunHeader, LogEnd), E> {
    let (mut failure, file) = (None, open(path)?);
    let mut assembly = Assembly::new(|header: &RunHeader, event: Event<'_>| {
        let Event::Step(step) = event else {
            return Ok(());
        };
        each(header, &step).map_err(|error| {
            failure = Some(error);
            String::new()
        })
    });
    let read = assembly.read(path, BufReader::new(file));
    let facts = assembly.facts;
    match (failure, read) {
        (Some(error), _) => Err(error),
        (None, Err(error)) => Err(error.into()),
        (None, Ok(end)) => Ok((facts.header, end)),
    }
}

/// Opens a file to be read from its beginning to its end.
pub(super) fn buffered(path: &Path) -> Result<BufReader<File>, LogError> {
    open(path).map(BufReader::new)
}

/// Opens a file; a device or a pipe may never end.
fn open(path: &Path) -> Result<File, LogError> {
    let unreadable = |source| LogError::Read {
        path: path.to_owned(),
        source,
    };
    let found = fs::metadata(path).map_err(unreadable)?;
    if !found.is_file() && !found.is_dir() {
        let reason = "it is a device, a pipe or a socket, not a file";
        return Err(unreadable(io::Error::other(reason)));
    }
    File::open(path).map_err(unreadable)
}

impl RunLog {
    /// Reads the log at `path`, up to the cut if it was cut.
    ///
    /// # Errors
    /// [`LogError`] when there is no such file, it is no log of ours, or bytes in it have changed.
    pub fn open(path: &Path) -> Result<Self, LogError> {
        Self::read(path, buffered(path)?)
    }

    /// Reads a log from memory; `path` is for messages.
    ///
    /// # Errors
    /// As [`Self::open`].
    pub fn from_bytes(path: &Path, bytes: &[u8]) -> Result<Self, LogError> {
        Self::read(path, bytes)
    }

    fn read(path: &Path, input: impl Read) -> Result<Self, LogError> {
        let mut log = Self::default();
        let mut assembly = Assembly::new(|_: &RunHeader, event: Event<'_>| {
            match event {
                Event::Step(step) => log.keep(&step),
                Event::Text(text) => log.events.push(text),
            }
            Ok(())
        });
        let end = assembly.read(path, input)?;
        let Facts { header, counts, .. } = assembly.facts;
        if end.dropped_at_end > 0 {
            log.losses.push(Loss::Ticks {
                position: log.ticks.len(),
                count: end.dropped_at_end,
            });
        }
        log.header = header;
        log.counts = counts;
        log.outcome = end.outcome;
        log.input_hash = end.input_hash;
        log.cut = end.cut;
        log.altered = end.altered;
        Ok(log)
    }

    fn keep(&mut self, step: &Step<'_>) {
        let position = self.ticks.len();
        if step.dropped_before > 0 {
            let count = step.dropped_before;
            self.losses.push(Loss::Ticks { position, count });
        }
        if step.chunk_dropped {
            let tick = step.tick.tick;
            self.losses.push(Loss::Chunk { tick });
        }
        for (chunks, chunk) in self.chunks.iter_mut().zip(step.chunks.iter()) {
            if let Some(chunk) = chunk {
                chunks.insert(position, **chunk);
            }
        }
        self.reports
            .push(step.reports.map(|report| report.map(Box::from)));
        self.ticks.push(*step.tick);
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

    /// The ticks in order, each with all that belongs to it.
    pub fn steps(&self) -> impl Iterator<Item = Step<'_>> {
        let mut losses = self.losses.iter().peekable();
        let ticks = self.ticks().zip(&self.reports).enumerate();
        ticks.map(move |(index, ((tick, chunks), reports))| {
            let mut step = Step {
                tick,
                chunks,
                reports: reports.as_ref().map(Option::as_deref),
                dropped_before: 0,
                chunk_dropped: false,
            };
            while let Some(loss) = losses.next_if(|loss| match loss {
                Loss::Ticks { position, .. } => *position == index,
                Loss::Chunk { tick: of } => *of == tick.tick,
            }) {
                match loss {
                    Loss::Ticks { count, .. } => step.dropped_before += count,
                    Loss::Chunk { .. } => step.chunk_dropped = true,
                }
            }
            step
        })
    }

    /// What is known at the end.
    #[must_use]
    pub fn end(&self) -> LogEnd {
        let at_end = self.losses.iter().filter_map(|loss| match loss {
            Loss::Ticks { position, count } if *position == self.ticks.len() => Some(*count),
            Loss::Ticks { .. } | Loss::Chunk { .. } => None,
        });
        LogEnd {
            outcome: self.outcome.clone(),
            input_hash: self.input_hash,
            dropped_at_end: at_end.sum(),
            cut: self.cut.clone(),
            altered: self.altered,
        }
    }

    /// Why the file ends before its end, if it does.
    #[must_use]
    pub fn cut(&self) -> Option<&str> {
        self.cut.as_deref()
    }

    /// Whether the log is not what the run wrote: something was changed, put in or taken away, and the checksums computed again.
    #[must_use]
    pub const fn altered(&self) -> bool {
        self.altered
    }

    /// How many ticks there are.
    #[must_use]
    pub fn tick_count(&self) -> usize {
        self.ticks.len()
    }

    /// Text of the configuration file `name`, as the run used it.
    #[must_use]
    pub fn text(&self, name: &str) -> Option<&str> {
        self.header.text(name)
    }
}

/// What a reader hears of, in order.
enum Event<'a> {
    /// A tick.
    Step(Step<'a>),
    /// What happened in words.
    Text(String),
}

/// The metadata as they come.
#[derive(Default)]
struct Facts {
    header: RunHeader,
    /// Names of the metadata records that there were.
    seen: BTreeSet<String>,
    outcome: Option<RunOutcome>,
    counts: Option<LogCounts>,
    input_hash: Option<u64>,
    /// Whether the run goes on in another file.
    goes_on: bool,
    altered: bool,
}

/// The messages of the tick that is not complete yet, and what is known of the whole.
struct Assembly<F> {
    to: F,
    facts: Facts,
    contents: Contents,
    next_record: u64,
    /// Whether there was a tick.
    begun: bool,
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
            Topic::Tick => {
                let message: TickMessage = json(data)?;
                if message.now_ns != header.log_time {
                    return Err(format!("tick {} has another time", message.tick));
                }
                if arm == 0 {
                    self.complete(&message)?;
                } else {
                    self.keep_second(message)?;
                }
            }
            // For people; not part of what the controller was given or answered.
            Topic::Events => {
                let text = protobuf::<Log>(data)?.message;
                (self.to)(&self.facts.header, Event::Text(text))?;
            }
            Topic::MeasuredCp => {}
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
    fn new(to: F) -> Self {
        Self {
            to,
            facts: Facts::default(),
            contents: Contents::default(),
            next_record: 0,
            begun: false,
            parts: Default::default(),
            second: None,
            timing: None,
        }
    }

    /// Reads a whole log.
    fn read(&mut self, path: &Path, input: impl Read) -> Result<LogEnd, LogError> {
        let cut = container::walk(path, input, self)?;
        if !self.facts.seen.contains(header::RUN) {
            return Err(LogError::NotOurs {
                path: path.to_owned(),
                missing: "the metadata record `run`".to_owned(),
            });
        }
        let counts = self.facts.counts;
        let unclosed = || "the data end, but the record of how the run ended is missing".to_owned();
        let continued = || "the run goes on in another file: its log was bounded".to_owned();
        let left_out = self.facts.header.left_out;
        let bounded = || format!("its bound left out the first {left_out} ticks");
        let handed_over = counts.map_or(0, |counts| {
            counts.ticks.saturating_add(counts.ticks_dropped)
        });
        Ok(LogEnd {
            outcome: self.facts.outcome.take(),
            input_hash: self.facts.input_hash,
            dropped_at_end: if self.facts.goes_on {
                0
            } else {
                handed_over.saturating_sub(self.next_record)
            },
            cut: cut
                .or_else(|| counts.is_none().then(unclosed))
                .or_else(|| (left_out > 0).then(bounded))
                .or_else(|| self.facts.goes_on.then(continued)),
            altered: self.facts.altered,
        })
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
            let key = |message: &TickMessage| (message.record, message.tick, message.now_ns);
            if key(beside) != key(message) {
                return Err(format!(
                    "tick {} comes with the second arm of tick {}",
                    message.tick, beside.tick
                ));
            }
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
        let step = Step {
            tick: &tick,
            chunks: tick.arms.as_ref().map(|_| chunks.next().flatten()),
            reports: tick.arms.as_ref().map(|_| of_arm.next().flatten()),
            dropped_before,
            chunk_dropped,
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

fn lacks(message: &TickMessage, what: &str) -> String {
    format!("tick {} lacks its {what}", message.tick)
}

fn protobuf<T: Message + Default>(data: &[u8]) -> Result<T, String> {
    T::decode(data).map_err(|error| error.to_string())
}

fn json<T: DeserializeOwned>(data: &[u8]) -> Result<T, String> {
    serde_json::from_slice(data).map_err(|error| error.to_string())
}
