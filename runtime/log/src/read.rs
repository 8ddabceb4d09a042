//! Reads a run's log back: every tick with the chunks that it was given, bit for bit, step by step
//! or as a whole.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufReader, Read};
use std::path::Path;

use hal::{ARMS_MAX, Chunk, PerArm, files};

use super::assembly::{Assembly, Event, Facts};
use super::error::LogError;
use super::header::{LogCounts, RunHeader, RunOutcome};
use super::record::LoggedTick;
use super::snapshot::LoggedSnapshot;
use super::step::{LogEnd, Step};

/// A log in memory: 1 kB a tick. [`read_steps`] reads one of any length.
#[derive(Clone, Debug, Default)]
pub struct RunLog {
    /// How the run was set up.
    pub header: RunHeader,
    /// How it ended; `None` if it was not closed properly.
    pub outcome: Option<RunOutcome>,
    /// What was written; `None` if the file was cut.
    pub counts: Option<LogCounts>,
    /// Hash over everything that the controller was given, taken while it ran; `None` if the file
    /// was cut or the run goes on in another.
    pub input_hash: Option<u64>,
    /// Where the logger had to leave something out; empty if nothing is missing.
    pub losses: Vec<Loss>,
    /// What happened in words, in order; for people, and no part of what a replay needs.
    pub events: Vec<String>,
    unknown_mark: Option<String>,
    cut: Option<String>,
    bounded: bool,
    altered: bool,
    ticks: Vec<LoggedTick>,
    /// By the position of their tick, for each arm.
    chunks: [BTreeMap<usize, Chunk>; ARMS_MAX],
    /// Each arm's safety report in each tick, as it was written.
    reports: Vec<PerArm<Option<Box<[u8]>>>>,
    /// By the position of the tick that follows.
    snapshots: BTreeMap<usize, LoggedSnapshot>,
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

/// Reads the log at `path` tick by tick, up to the cut if it was cut: each tick goes to `each` with
/// the run's header. No more than a tick is in memory at a time.
///
/// # Errors
/// [`LogError`] when there is no such file, it is no log of ours, or bytes in it have changed; what
/// `each` says.
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
    files::open(path).map_err(unreadable)
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
        let facts = assembly.facts;
        if end.dropped_at_end > 0 {
            log.losses.push(Loss::Ticks {
                position: log.ticks.len(),
                count: end.dropped_at_end,
            });
        }
        log.close(facts, end);
        Ok(log)
    }

    /// Keeps what is known at the end.
    fn close(&mut self, facts: Facts, end: LogEnd) {
        self.header = facts.header;
        self.counts = facts.counts;
        self.outcome = end.outcome;
        self.unknown_mark = end.unknown_mark;
        self.input_hash = end.input_hash;
        self.cut = end.cut;
        self.bounded = end.bounded;
        self.altered = end.altered;
        let at_end = end.snapshot.map(|snapshot| (self.ticks.len(), snapshot));
        self.snapshots.extend(at_end);
    }

    /// Adds a tick with all that belongs to it.
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
        if let Some(snapshot) = step.snapshot {
            self.snapshots.insert(position, snapshot.clone());
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
                snapshot: self.snapshots.get(&index),
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
            unknown_mark: self.unknown_mark.clone(),
            input_hash: self.input_hash,
            dropped_at_end: at_end.sum(),
            cut: self.cut.clone(),
            bounded: self.bounded,
            altered: self.altered,
            snapshot: self.snapshots.get(&self.ticks.len()).cloned(),
        }
    }

    /// Why the file ends before its end, if it does.
    #[must_use]
    pub fn cut(&self) -> Option<&str> {
        self.cut.as_deref()
    }

    /// Whether the log is not what the run wrote: something was changed, put in or taken away, and
    /// the checksums computed again.
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
