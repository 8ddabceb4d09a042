//! Hands records from the control thread to the writer thread, without ever blocking a real-time
//! loop.
//!
//! Two bounded wait-free queues carry ticks and chunks, a third one what other threads have to say.
//! Under [`Pressure::Drop`] a full queue costs the record, which is counted and shows in the file
//! as a gap in the record numbers; under [`Pressure::Block`] the caller waits.

use std::fs::File;
use std::io::BufWriter;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::sync::mpsc::{self, SyncSender};
use std::thread::{self, JoinHandle, Thread};

use hal::{CameraFrame, Chunk, TimeNs};
use rtrb::{Producer, PushError, RingBuffer};

use super::bound::{Bound, Bounded};
use super::buses::BusesRecord;
use super::camera::FrameItem;
use super::drain::{Drain, OnFailure, Shared};
use super::error::LogError;
use super::happened::StateChanges;
use super::header::{LogCounts, RunHeader, RunOutcome};
use super::item::{ChunkItem, SceneItem, SideItem, TickItem};
use super::level::Level;
use super::record::TickRecord;
use super::ring::pre_faulted_queue;
use super::scene::SceneRecord;
use super::snapshot::{QUEUED_TICKS, SeenChunks, SnapshotFeed, snapshot_queue};
use super::sync::Syncing;
use super::writer::LogWriter;
use hal::ARMS_MAX;
use trocar_control::{AnyController, InputHash};

/// What happens when a queue is full.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Pressure {
    /// The record is dropped and counted: for real-time runs.
    Drop,
    /// The caller waits, and nothing is lost: for lockstep.
    Block,
}

/// How a log is written.
pub struct Writing {
    /// What happens when a queue is full.
    pub pressure: Pressure,
    /// Hears at once of what can't be written, and not only at the end.
    pub on_failure: OnFailure,
    /// Bytes that the log takes at most on its disk, if it has a bound. It keeps the last part, in
    /// `run.mcap` and what came before it in `run.earlier.mcap`, each of half the size at most.
    pub bytes_max: Option<u64>,
}

impl Writing {
    /// Without a bound; failures are reported at the end.
    #[must_use]
    pub fn new(pressure: Pressure) -> Self {
        Self {
            pressure,
            on_failure: Box::new(|_| ()),
            bytes_max: None,
        }
    }
}

/// Ticks that the queue holds: four seconds at 1 kHz.
const TICKS: usize = 4096;
/// Chunks that the queue holds.
const CHUNKS: usize = 64;
/// Frames and events that the queue holds.
const SIDE_ITEMS: usize = 64;
/// Scenes that the queue holds: four seconds of policy steps.
const SCENES: usize = 100;

/// Both ends of what a log with that bound has besides.
fn bounded(bound: Bound) -> (SnapshotFeed, Bounded) {
    const { assert!(TICKS as u64 <= QUEUED_TICKS) };
    let (feed, snapshots) = snapshot_queue();
    let bounded = Bounded {
        bound,
        snapshots,
        seen: SeenChunks::default(),
        has_snapshots: false,
    };
    (feed, bounded)
}

/// One end of a queue to the writer thread.
///
/// Wait-free on the producer's side under [`Pressure::Drop`]; the writer is woken only where a
/// caller waits, since that takes a system call.
struct Feed<T> {
    queue: Producer<T>,
    pressure: Pressure,
    writer: Thread,
}

impl<T> Feed<T> {
    fn new(queue: Producer<T>, pressure: Pressure, writer: &Thread) -> Self {
        Self {
            queue,
            pressure,
            writer: writer.clone(),
        }
    }

    /// Whether the writer will get `item`. Never blocks under [`Pressure::Drop`].
    fn push(&mut self, mut item: T) -> bool {
        loop {
            match self.queue.push(item) {
                Ok(()) => return true,
                Err(PushError::Full(back)) => item = back,
            }
            if self.pressure == Pressure::Drop || self.queue.is_abandoned() {
                return false;
            }
            self.writer.unpark();
            thread::yield_now();
        }
    }
}

/// The control thread's end of the log. It neither allocates nor, under [`Pressure::Drop`], waits.
pub struct TickLog {
    ticks: Feed<TickItem>,
    chunks: Feed<ChunkItem>,
    shared: Arc<Shared>,
    /// Number of the next tick's record.
    tick_count: u64,
    /// Number of the next chunk's record, over both arms.
    chunk_count: u64,
    /// Each arm's chunk for the coming tick.
    pending_chunks: [Option<u64>; ARMS_MAX],
    /// Over everything that was handed over, dropped or not: in a log with a gap the replay's hash
    /// differs.
    inputs: InputHash,
    /// Of a log with a bound.
    snapshots: Option<SnapshotFeed>,
}

impl TickLog {
    fn new(
        ticks: Feed<TickItem>,
        chunks: Feed<ChunkItem>,
        snapshots: Option<SnapshotFeed>,
        shared: &Arc<Shared>,
    ) -> Self {
        Self {
            ticks,
            chunks,
            shared: Arc::clone(shared),
            tick_count: 0,
            chunk_count: 0,
            pending_chunks: [None; ARMS_MAX],
            inputs: InputHash::new(),
            snapshots,
        }
    }

    /// Hands over one tick; to be called in every tick, after [`Self::chunk`].
    pub fn tick(&mut self, tick: &TickRecord) {
        let mut chunks = core::mem::take(&mut self.pending_chunks).into_iter();
        let item = TickItem {
            record: self.tick_count,
            chunk_records: tick.arms.as_ref().map(|_| chunks.next().flatten()),
            tick: *tick,
        };
        self.tick_count += 1;
        for arm in tick.arms.iter() {
            self.inputs.tick(tick.now, &arm.measured, arm.operator);
        }
        let hash = self.inputs.value();
        self.shared.input_hash.store(hash, Ordering::Relaxed);
        if let Some(snapshots) = &mut self.snapshots {
            for arm in tick.arms.iter() {
                snapshots.commands.add(&arm.command);
            }
        }
        if !self.ticks.push(item) {
            self.shared.ticks_dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Hands over the state of `controller` now and then, if the log has a bound: from there a
    /// replay goes on once what came before is left out. To be called in every tick, after
    /// [`Self::tick`].
    pub fn snapshot(&mut self, controller: &AnyController) {
        if let Some(snapshots) = &mut self.snapshots {
            snapshots.put(self.tick_count, self.inputs, controller);
        }
    }

    /// Hands over the chunk that the controller is given for the arm `arm` in the coming tick, the
    /// first arm's first.
    pub fn chunk(&mut self, arm: usize, chunk: &Chunk) {
        let record = self.chunk_count;
        self.chunk_count += 1;
        self.inputs.chunk(arm, chunk);
        let item = ChunkItem {
            record,
            arm,
            chunk: *chunk,
        };
        let pending = self.pending_chunks.get_mut(arm);
        let pushed = pending.is_some() && self.chunks.push(item);
        if !pushed {
            self.shared.chunks_dropped.fetch_add(1, Ordering::Relaxed);
        }
        if let Some(pending) = pending {
            *pending = pushed.then_some(record);
        }
    }

    /// Ticks and chunks dropped so far.
    #[must_use]
    pub fn dropped(&self) -> u64 {
        self.shared.ticks_dropped.load(Ordering::Relaxed)
            + self.shared.chunks_dropped.load(Ordering::Relaxed)
    }
}

/// The other threads' end of the log; it allocates.
pub struct SideLog {
    queue: Feed<SideItem>,
    shared: Arc<Shared>,
}

impl SideLog {
    /// Writes a line of text.
    pub fn event(&mut self, at: TimeNs, level: Level, text: &str) {
        if !self.queue.push(SideItem::Event {
            at,
            level,
            text: text.to_owned(),
        }) {
            self.shared.events_dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Writes the load and the error counters of the buses at `at`.
    pub fn buses(&mut self, at: TimeNs, buses: BusesRecord) {
        if !self.queue.push(SideItem::Buses { at, buses }) {
            self.shared.events_dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Writes a camera's colour image, with its lens, under `/camera/<name>`.
    pub fn frame(&mut self, name: &str, frame: &CameraFrame) {
        if self.queue.pressure == Pressure::Drop && self.queue.queue.is_full() {
            // Saves the copy.
            self.shared.frames_dropped.fetch_add(1, Ordering::Relaxed);
        } else if !self
            .queue
            .push(SideItem::Frame(Box::new(FrameItem::new(name, frame))))
        {
            self.shared.frames_dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// The simulation's end of the log. Under [`Pressure::Drop`] it never waits.
pub struct SceneLog {
    queue: Feed<SceneItem>,
    shared: Arc<Shared>,
}

impl SceneLog {
    /// Writes where everything in the scene was at `at`, and how its task stood.
    pub fn scene(&mut self, at: TimeNs, scene: SceneRecord) {
        if !self.queue.push(SceneItem { at, scene }) {
            self.shared.events_dropped.fetch_add(1, Ordering::Relaxed);
        }
    }
}

/// The file and the thread that writes it.
pub struct LogFile {
    path: PathBuf,
    shared: Arc<Shared>,
    thread: JoinHandle<Result<LogCounts, LogError>>,
    outcome: SyncSender<RunOutcome>,
}

impl LogFile {
    /// Writes everything that was handed over, then `outcome` if there is one, and closes the file.
    ///
    /// Drop or idle the other ends first: what they hand over afterwards may be lost.
    ///
    /// # Errors
    /// [`LogError`] when anything could not be written.
    pub fn finish(self, outcome: Option<&RunOutcome>) -> Result<LogCounts, LogError> {
        let Self {
            path,
            shared,
            thread,
            outcome: sender,
        } = self;
        if let Some(outcome) = outcome {
            // There is room for one; if the writer has died, `join` says so.
            let _delivered = sender.try_send(outcome.clone());
        }
        shared.stop.store(true, Ordering::Release);
        thread.thread().unpark();
        thread.join().unwrap_or(Err(LogError::WriterDied { path }))
    }
}

/// A log being written, for callers that do everything in one thread.
pub struct Recorder {
    ticks: TickLog,
    side: SideLog,
    scenes: SceneLog,
    file: LogFile,
}

impl Recorder {
    /// Creates the file at `path` and starts its writer thread.
    ///
    /// Call this before raising the caller's scheduling priority, which the thread would inherit.
    /// If the recorder is dropped without [`Self::finish`], the file is closed without an outcome.
    ///
    /// # Errors
    /// [`LogError`] when the file cannot be created or the header not be written.
    pub fn create(path: &Path, run: &RunHeader, pressure: Pressure) -> Result<Self, LogError> {
        Self::create_with(path, run, Writing::new(pressure))
    }

    /// The same, written as `writing` says.
    ///
    /// # Errors
    /// As [`Self::create`].
    pub fn create_with(path: &Path, run: &RunHeader, writing: Writing) -> Result<Self, LogError> {
        let Writing {
            pressure,
            on_failure,
            bytes_max,
        } = writing;
        let io = |source| LogError::Create {
            path: path.to_owned(),
            source,
        };
        let sink = BufWriter::new(File::create(path).map_err(io)?);
        let writer = LogWriter::new(sink, run).map_err(|source| LogError::Write {
            path: path.to_owned(),
            source,
        })?;
        let (tick_end, ticks) = pre_faulted_queue(TICKS);
        let (chunk_end, chunks) = pre_faulted_queue(CHUNKS);
        let (side_end, side) = RingBuffer::new(SIDE_ITEMS);
        let (scene_end, scenes) = RingBuffer::new(SCENES);
        let bound = bytes_max.map(|bytes_max| Bound::new(bytes_max, run, path));
        let (snapshots, bounded) = bound.map(bounded).unzip();
        let shared = Arc::new(Shared::default());
        let (outcome_sender, outcome) = mpsc::sync_channel(1);
        let drain = Drain {
            path: path.to_owned(),
            writer,
            ticks,
            chunks,
            side,
            scenes,
            outcome,
            shared: Arc::clone(&shared),
            counts: LogCounts::default(),
            happened: StateChanges::new(),
            now: TimeNs(0),
            failure: None,
            on_failure,
            bounded,
            // What is done in virtual time can be done again.
            _syncing: match pressure {
                Pressure::Drop => Some(Syncing::start(path).map_err(io)?),
                Pressure::Block => None,
            },
        };
        let thread = thread::Builder::new()
            .name("log".to_owned())
            .spawn(|| drain.run())
            .map_err(io)?;
        let writer = thread.thread().clone();
        Ok(Self {
            ticks: TickLog::new(
                Feed::new(tick_end, pressure, &writer),
                Feed::new(chunk_end, pressure, &writer),
                snapshots,
                &shared,
            ),
            side: SideLog {
                queue: Feed::new(side_end, pressure, &writer),
                shared: Arc::clone(&shared),
            },
            scenes: SceneLog {
                queue: Feed::new(scene_end, pressure, &writer),
                shared: Arc::clone(&shared),
            },
            file: LogFile {
                path: path.to_owned(),
                shared,
                thread,
                outcome: outcome_sender,
            },
        })
    }

    /// See [`TickLog::tick`].
    pub fn tick(&mut self, tick: &TickRecord) {
        self.ticks.tick(tick);
    }

    /// See [`TickLog::snapshot`].
    pub fn snapshot(&mut self, controller: &AnyController) {
        self.ticks.snapshot(controller);
    }

    /// See [`TickLog::chunk`].
    pub fn chunk(&mut self, arm: usize, chunk: &Chunk) {
        self.ticks.chunk(arm, chunk);
    }

    /// See [`SideLog::event`].
    pub fn event(&mut self, at: TimeNs, level: Level, text: &str) {
        self.side.event(at, level, text);
    }

    /// See [`SideLog::frame`].
    pub fn frame(&mut self, name: &str, frame: &CameraFrame) {
        self.side.frame(name, frame);
    }

    /// See [`SideLog::buses`].
    pub fn buses(&mut self, at: TimeNs, buses: BusesRecord) {
        self.side.buses(at, buses);
    }

    /// See [`SceneLog::scene`].
    pub fn scene(&mut self, at: TimeNs, scene: SceneRecord) {
        self.scenes.scene(at, scene);
    }

    /// Takes the recorder apart, one end for each thread.
    #[must_use]
    pub fn split(self) -> (TickLog, SideLog, SceneLog, LogFile) {
        (self.ticks, self.side, self.scenes, self.file)
    }

    /// See [`LogFile::finish`].
    ///
    /// # Errors
    /// [`LogError`] when anything could not be written.
    pub fn finish(self, outcome: Option<&RunOutcome>) -> Result<LogCounts, LogError> {
        self.file.finish(outcome)
    }
}
