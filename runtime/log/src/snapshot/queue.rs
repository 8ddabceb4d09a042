//! Snapshots on their way from the control thread to the writer thread. The control thread's end
//! neither allocates nor waits.
//!
//! A snapshot is a row of words: record, hash of the inputs, hash of the commands, layout, number
//! of chunks, number of words of state; then arm, slot, sequence and observation time (ns) of each
//! chunk; then the state. It is pushed in one piece or not at all.

use hal::{TimeNs, count};
use rtrb::{Consumer, Producer};

use super::super::ring::pre_faulted_queue;
use trocar_control::snapshot::{HELD_MAX, STATE_WORDS_MAX};
use trocar_control::{AnyController, CommandHash, HeldChunk, InputHash, Snapshot};

/// Ticks from one snapshot to the next: as many as a flush brings to the file.
const EVERY_TICKS: u64 = 250;

/// Words that the queue holds.
const WORDS: usize = 1 << 16;

/// Words before a snapshot's chunks, and words of a chunk.
const HEAD: usize = 6;
const HELD: usize = 4;

/// Words of a snapshot at most.
const SNAPSHOT_WORDS_MAX: usize = HEAD + HELD * HELD_MAX + STATE_WORDS_MAX;

/// Ticks of which the queue holds all snapshots, wherever they begin.
pub(crate) const QUEUED_TICKS: u64 = (WORDS / SNAPSHOT_WORDS_MAX - 1) as u64 * EVERY_TICKS;

/// A queue for snapshots, whose memory the system has mapped already.
pub(crate) fn snapshot_queue() -> (SnapshotFeed, SnapshotQueue) {
    let (words, queue) = pre_faulted_queue(WORDS);
    let feed = SnapshotFeed {
        words,
        commands: CommandHash::new(),
        snapshot: Snapshot::new(),
    };
    (feed, SnapshotQueue(queue))
}

/// The control thread's end.
pub(crate) struct SnapshotFeed {
    words: Producer<u64>,
    /// Of all commands so far.
    pub(crate) commands: CommandHash,
    snapshot: Snapshot,
}

impl SnapshotFeed {
    /// Hands over the state of `controller` before the tick of that record, if it is time, after
    /// all that is in `inputs`. A full queue costs the snapshot; another one follows.
    pub(crate) fn put(&mut self, record: u64, inputs: InputHash, controller: &AnyController) {
        if !record.is_multiple_of(EVERY_TICKS) {
            return;
        }
        controller.save(&mut self.snapshot);
        let (held, state) = (self.snapshot.held(), self.snapshot.state());
        let head: [u64; HEAD] = [
            record,
            inputs.value(),
            self.commands.value(),
            self.snapshot.layout(),
            held.len() as u64,
            state.len() as u64,
        ];
        let count = HEAD + HELD * held.len() + state.len();
        let Ok(room) = self.words.write_chunk_uninit(count) else {
            return;
        };
        let held = held.iter().flat_map(|held| -> [u64; HELD] {
            let HeldChunk {
                arm,
                slot,
                sequence,
                observed_at: TimeNs(observed_at_ns),
            } = *held;
            [arm as u64, slot as u64, sequence, observed_at_ns]
        });
        let state = state.iter().copied();
        room.fill_from_iter(head.into_iter().chain(held).chain(state));
    }
}

/// A snapshot that has arrived.
pub(crate) struct SnapshotItem {
    /// Record of the tick that follows it.
    pub(crate) record: u64,
    pub(crate) inputs: InputHash,
    pub(crate) commands: CommandHash,
    pub(crate) snapshot: Snapshot,
}

/// The writer thread's end.
pub(crate) struct SnapshotQueue(Consumer<u64>);

impl SnapshotQueue {
    /// The newest snapshot before the tick of that record, if one has come since the last call.
    pub(crate) fn take(&mut self, record: u64) -> Option<SnapshotItem> {
        let mut newest = None;
        while self.0.peek().is_ok_and(|its| *its <= record) {
            newest = self.pop();
        }
        newest
    }

    /// A snapshot is there as a whole or not at all.
    fn pop(&mut self) -> Option<SnapshotItem> {
        let head = self.words(HEAD)?;
        let [record, inputs, commands, layout, held, state] = head.try_into().ok()?;
        let held = self.words(HELD * count::index(held))?;
        let (held, _none) = held.as_chunks::<HELD>();
        let held = held.iter().map(|words| {
            let [arm, slot, sequence, observed_at_ns] = *words;
            HeldChunk {
                arm: count::index(arm),
                slot: count::index(slot),
                sequence,
                observed_at: TimeNs(observed_at_ns),
            }
        });
        let held = held.collect();
        let state = self.words(count::index(state))?;
        Some(SnapshotItem {
            record,
            inputs: InputHash::resumed(inputs),
            commands: CommandHash::resumed(commands),
            snapshot: Snapshot::from_parts(layout, state, held),
        })
    }

    /// The next `count` words; none if there are not so many.
    fn words(&mut self, count: usize) -> Option<Vec<u64>> {
        Some(self.0.read_chunk(count).ok()?.into_iter().collect())
    }
}
