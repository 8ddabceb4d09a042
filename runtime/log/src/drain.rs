//! The writer thread: takes records from the queues and puts them into the file.
//!
//! One loop: all ticks with their chunks, all scenes, then one frame, event or state of the buses,
//! and again; 2 ms of sleep when nothing has come. It is the only thread that writes the file;
//! `sync` brings it to the disk from another. It allocates and blocks; all that the control thread
//! can notice of it is a full queue.

use std::fs::File;
use std::io::BufWriter;
use std::path::PathBuf;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::Receiver;
use std::thread;
use std::time::Duration;

use hal::TimeNs;
use rtrb::Consumer;

use super::bound::{Bounded, Fill};
use super::error::LogError;
use super::happened::StateChanges;
use super::header::{Closing, LogCounts, RunOutcome};
use super::item::{ChunkItem, SceneItem, SideItem, TickItem};
use super::level::Level;
use super::snapshot::SnapshotMessage;
use super::sync::Syncing;
use super::writer::LogWriter;
use trocar_control::{GateDecision, InputHash};

/// Pause of the writer thread when it has caught up.
const IDLE: Duration = Duration::from_millis(2);

/// What all ends of the queues know.
pub(super) struct Shared {
    /// Whether the writer thread is to end once the queues are empty.
    pub(super) stop: AtomicBool,
    /// Ticks that found the queue full.
    pub(super) ticks_dropped: AtomicU64,
    /// Chunks that found the queue full.
    pub(super) chunks_dropped: AtomicU64,
    /// Camera frames that found the queue full.
    pub(super) frames_dropped: AtomicU64,
    /// Events, scenes and states of buses that found their queue full.
    pub(super) events_dropped: AtomicU64,
    /// Hash of all inputs that were handed over, dropped ones included.
    ///
    /// Stored by the control thread once a tick, read when a file is closed.
    pub(super) input_hash: AtomicU64,
}

impl Default for Shared {
    fn default() -> Self {
        Self {
            stop: AtomicBool::new(false),
            ticks_dropped: AtomicU64::new(0),
            chunks_dropped: AtomicU64::new(0),
            frames_dropped: AtomicU64::new(0),
            events_dropped: AtomicU64::new(0),
            input_hash: AtomicU64::new(InputHash::new().value()),
        }
    }
}

/// The writer thread.
pub(super) struct Drain {
    pub(super) path: PathBuf,
    pub(super) writer: LogWriter<BufWriter<File>>,
    pub(super) ticks: Consumer<TickItem>,
    pub(super) chunks: Consumer<ChunkItem>,
    pub(super) side: Consumer<SideItem>,
    pub(super) scenes: Consumer<SceneItem>,
    /// The outcome, sent when the run ends.
    pub(super) outcome: Receiver<RunOutcome>,
    pub(super) shared: Arc<Shared>,
    /// Of the whole run, not of one file; dropped ones are put in at the end.
    pub(super) counts: LogCounts,
    /// What was reported of each arm.
    pub(super) happened: StateChanges,
    /// When the newest tick was.
    pub(super) now: TimeNs,
    /// The first failure; nothing is written after it.
    pub(super) failure: Option<LogError>,
    /// Called at the first failure.
    pub(super) on_failure: OnFailure,
    /// The bound of the file's size, if it has one.
    pub(super) bounded: Option<Bounded>,
    /// While this lives the file is brought to its disk, if it is.
    pub(super) _syncing: Option<Syncing>,
}

/// Whether the controller may hold `chunk`, which comes with the tick `item` or with one before it
/// that was dropped.
fn may_be_held(chunk: &ChunkItem, item: &TickItem) -> bool {
    let of_tick = item.chunk_records.get(chunk.arm).copied().flatten() == Some(chunk.record);
    let report = item.tick.arms.get(chunk.arm).map(|arm| arm.report);
    !of_tick || report.is_some_and(|report| report.gate == Some(GateDecision::Accepted))
}

/// Called on the writer thread at the first write that fails.
pub type OnFailure = Box<dyn Fn(&LogError) + Send>;

impl Drain {
    /// Writes until it is stopped or all producers are gone.
    pub(super) fn run(mut self) -> Result<LogCounts, LogError> {
        loop {
            // Read before draining: whatever was handed over before it was set is then still
            // written.
            let stop = self.shared.stop.load(Ordering::Acquire) || self.is_alone();
            let mut idle = true;
            while let Ok(item) = self.ticks.pop() {
                idle = false;
                self.write_tick(&item);
            }
            while let Ok(SceneItem { at, scene }) = self.scenes.pop() {
                idle = false;
                let result = self.writer.scene(at, &scene);
                self.note(result);
            }
            // One at a time: compressing a frame takes a while, and ticks must not pile up behind a
            // row of them.
            while let Ok(item) = self.side.pop() {
                idle = false;
                self.write_side(item);
                if !stop {
                    break;
                }
            }
            if stop {
                return self.close();
            }
            if idle {
                thread::park_timeout(IDLE);
            }
        }
    }

    /// Whether all producers are gone: the queues' other ends, and the
    /// [`super::recorder::LogFile`], which brings the outcome.
    fn is_alone(&self) -> bool {
        self.ticks.is_abandoned()
            && self.side.is_abandoned()
            && self.scenes.is_abandoned()
            && Arc::strong_count(&self.shared) == 1
    }

    /// Writes the chunks up to those of `item`. Chunks of ticks that were dropped come out here as
    /// well: they are written, under their own number.
    fn write_chunks(&mut self, item: &TickItem) {
        let newest = item.chunk_records.iter().copied().flatten().max();
        while let Some(wanted) = newest
            && let Ok(head) = self.chunks.peek().map(|head| head.record)
            && head <= wanted
        {
            if let Ok(chunk) = self.chunks.pop() {
                let result = self.writer.chunk(&chunk, item.tick.now);
                self.counts.chunks += 1;
                self.note(result);
                if let Some(bounded) = &mut self.bounded
                    && may_be_held(&chunk, item)
                {
                    bounded.seen.add(&chunk);
                }
            }
        }
    }

    /// Writes a tick with its chunks and events, and begins the next file where the bound is
    /// reached: before it, where the controller's state came with it, and after it in a log without
    /// any.
    fn write_tick(&mut self, item: &TickItem) {
        self.turn_at_snapshot(item.record);
        self.write_chunks(item);
        self.now = item.tick.now;
        for (level, text) in self.happened.since(&item.tick) {
            let result = self.writer.event(item.tick.now, level, text);
            self.note(result);
        }
        let result = self.writer.tick(item);
        self.counts.ticks += 1;
        self.note(result);
        if let Some(bounded) = &mut self.bounded
            && !bounded.has_snapshots
            && self.failure.is_none()
            && self.writer.has_flushed(item.tick.now)
            && bounded.bound.check(&self.path, 0) != Fill::HasRoom
        {
            let next = bounded
                .bound
                .next(&self.path, item.record.saturating_add(1));
            self.go_on(next, None);
        }
    }

    /// Where the controller's state has come for a tick up to that of `record`, which is to be
    /// written: begins the next file there if the bound is reached, counting the state that ends
    /// the file. A state that lacks a chunk, or is not of this very tick since ticks between were
    /// dropped, begins a file only where no more can be waited for another: that file can't be
    /// replayed.
    fn turn_at_snapshot(&mut self, record: u64) {
        let bounded = self.bounded.as_mut();
        let Some(item) = bounded.and_then(|bounded| bounded.snapshots.take(record)) else {
            return;
        };
        let flushed = self.writer.flush(self.now);
        self.note(flushed);
        let Some(bounded) = self.bounded.as_mut().filter(|_| self.failure.is_none()) else {
            return;
        };
        bounded.has_snapshots = true;
        let end_bytes = SnapshotMessage::bytes_max(&item, &bounded.seen);
        let fill = bounded.bound.check(&self.path, end_bytes);
        let snapshot = (fill != Fill::HasRoom && item.record == record)
            .then(|| SnapshotMessage::new(&item, &bounded.seen))
            .flatten();
        if snapshot.is_some() || fill == Fill::Overdue {
            let next = bounded.bound.next(&self.path, record);
            self.go_on(next, snapshot.as_ref());
        }
    }

    /// Closes the file and goes on in the `next`; the controller's state ends the one and begins
    /// the other.
    fn go_on(
        &mut self,
        next: Result<LogWriter<BufWriter<File>>, LogError>,
        snapshot: Option<&SnapshotMessage>,
    ) {
        match next {
            Ok(mut next) => {
                next.go_on_from(&self.writer);
                let mut full = core::mem::replace(&mut self.writer, next);
                if let Some(snapshot) = snapshot {
                    let written = full.snapshot(self.now, snapshot);
                    self.note(written);
                    let written = self.writer.snapshot(self.now, snapshot);
                    self.note(written);
                    let flushed = self.writer.flush(self.now);
                    self.note(flushed);
                }
                let closing = Closing {
                    goes_on: true,
                    ..self.closing(None)
                };
                let result = full.finish(closing);
                self.note(result);
                if let Some(bounded) = &mut self.bounded {
                    bounded.bound.begin(&self.path);
                }
            }
            Err(error) => self.fail(error),
        }
    }

    /// The end of a file, with `outcome` if it is the run's.
    fn closing(&mut self, outcome: Option<RunOutcome>) -> Closing {
        let dropped = |count: &AtomicU64| count.load(Ordering::Relaxed);
        self.counts.ticks_dropped = dropped(&self.shared.ticks_dropped);
        self.counts.chunks_dropped = dropped(&self.shared.chunks_dropped);
        self.counts.frames_dropped = dropped(&self.shared.frames_dropped);
        self.counts.events_dropped = dropped(&self.shared.events_dropped);
        Closing {
            outcome,
            goes_on: false,
            counts: self.counts,
            input_hash: self.shared.input_hash.load(Ordering::Relaxed),
            contents: None,
        }
    }

    /// Writes an event, a frame or the state of the buses.
    ///
    /// An image is compressed here, which is the longest thing that this thread does.
    fn write_side(&mut self, item: SideItem) {
        match item {
            SideItem::Event { at, level, text } => {
                let result = self.writer.event(at, level, text);
                self.note(result);
            }
            SideItem::Buses { at, buses } => {
                let result = self.writer.buses(at, &buses);
                self.note(result);
            }
            SideItem::Frame(frame) => match frame.encode() {
                Ok(encoded) => {
                    let result = self.writer.frame(frame.name(), frame.stamp(), &encoded);
                    self.counts.frames += 1;
                    self.note(result);
                }
                Err(error) => self.fail(error),
            },
        }
    }

    /// Stores the first failure; the queues are still emptied, so that no producer blocks for ever.
    fn note(&mut self, result: mcap::McapResult<()>) {
        if let Err(source) = result {
            let path = self.path.clone();
            self.fail(LogError::Write { path, source });
        }
    }

    /// Reports and keeps the first failure.
    fn fail(&mut self, error: LogError) {
        if self.failure.is_none() {
            (self.on_failure)(&error);
            self.failure = Some(error);
        }
    }

    /// Writes the outcome and closes the file.
    ///
    /// # Errors
    /// The first failure of the run, or what the last write says.
    fn close(mut self) -> Result<LogCounts, LogError> {
        let outcome = self.outcome.try_recv().ok();
        if let Some(RunOutcome { reason, said, .. }) = &outcome {
            let text = format!("the run ended: {reason}{}", said.clause());
            let result = self.writer.event(self.now, Level::Info, text);
            self.note(result);
        }
        let closing = self.closing(outcome);
        if let Some(failure) = self.failure {
            return Err(failure);
        }
        self.writer
            .finish(closing)
            .map_err(|source| LogError::Write {
                path: self.path,
                source,
            })?;
        Ok(self.counts)
    }
}

#[cfg(test)]
mod tests;
