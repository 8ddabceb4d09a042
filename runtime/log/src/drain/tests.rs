//! Where a log with a bound goes on in another file, if ticks or chunks were dropped just before.

use std::fs;

use rtrb::{Producer, RingBuffer};

use super::*;
use crate::bound::{Bound, SPARE_BYTES, earlier};
use crate::replay::{ReplayError, replay};
use crate::snapshot::{SeenChunks, SnapshotFeed, snapshot_queue};
use crate::tests::{Scratch, chunk_of_run, run_controller};
use crate::{Loss, RunHeader, RunLog, TickRecord};
use hal::PerArm;
use trocar_control::{AnyController, ControlConfig, TickInput};

/// Ticks of a run; of the first file there are far fewer.
const TICKS: u64 = 9000;

/// Bytes of both files at most.
const BYTES_MAX: u64 = 2 * (SPARE_BYTES + 400_000);

/// What the writer thread never gets.
#[derive(Clone, Copy, PartialEq)]
enum Dropped {
    Tick,
    Chunk,
}

/// The control thread's ends of the queues, and what it adds up.
struct Feeds {
    chunks: Producer<ChunkItem>,
    snapshots: SnapshotFeed,
    inputs: InputHash,
    chunk_count: u64,
}

/// A writer thread that is not running, with a log at `path`.
fn idle(path: &std::path::Path, run: &RunHeader) -> (Drain, Feeds) {
    let sink = BufWriter::new(File::create(path).unwrap());
    let writer = LogWriter::new(sink, run).unwrap();
    let (chunks_end, chunks) = RingBuffer::new(64);
    let (feed, snapshots) = snapshot_queue();
    let (_, outcome) = std::sync::mpsc::sync_channel(1);
    let drain = Drain {
        path: path.to_owned(),
        writer,
        ticks: RingBuffer::new(1).1,
        chunks,
        side: RingBuffer::new(1).1,
        scenes: RingBuffer::new(1).1,
        outcome,
        shared: Arc::new(Shared::default()),
        counts: LogCounts::default(),
        happened: StateChanges::new(),
        now: TimeNs(0),
        failure: None,
        on_failure: Box::new(|_| ()),
        bounded: Some(Bounded {
            bound: Bound::new(BYTES_MAX, run, path),
            snapshots,
            seen: SeenChunks::default(),
            has_snapshots: false,
        }),
        _syncing: None,
    };
    let feeds = Feeds {
        chunks: chunks_end,
        snapshots: feed,
        inputs: InputHash::new(),
        chunk_count: 0,
    };
    (drain, feeds)
}

impl Feeds {
    /// Hands over a tick with its chunk, but for what is dropped.
    fn tick(&mut self, drain: &mut Drain, tick: &TickRecord, dropped: Option<Dropped>) {
        let arm = &tick.arms.first;
        let record = arm.chunk_sequence.map(|_| self.chunk_count);
        if let Some((sequence, record)) = arm.chunk_sequence.zip(record) {
            let chunk = chunk_of_run(sequence);
            self.inputs.chunk(0, &chunk);
            self.chunk_count += 1;
            if dropped != Some(Dropped::Chunk) {
                let item = ChunkItem {
                    record,
                    arm: 0,
                    chunk,
                };
                assert!(self.chunks.push(item).is_ok());
            }
        }
        self.inputs.tick(tick.now, &arm.measured, arm.operator);
        self.snapshots.commands.add(&arm.command);
        let hash = self.inputs.value();
        drain.shared.input_hash.store(hash, Ordering::Relaxed);
        if dropped == Some(Dropped::Tick) {
            drain.shared.ticks_dropped.fetch_add(1, Ordering::Relaxed);
            return;
        }
        drain.write_tick(&TickItem {
            record: tick.tick,
            chunk_records: PerArm::one(record.filter(|_| dropped != Some(Dropped::Chunk))),
            tick: *tick,
        });
    }
}

/// The files of a run up to a little after the second one has begun, and the tick that it begins
/// with.
struct Turned {
    last: Scratch,
    before: Scratch,
    at: u64,
}

/// Writes the run, without what is `dropped` in a tick.
fn turned(
    name: &str,
    (records, run): &(Vec<TickRecord>, RunHeader),
    dropped: impl Fn(u64) -> Option<Dropped>,
) -> Turned {
    let config = ControlConfig::load(
        &ControlConfig::default_control(),
        &ControlConfig::needle_lift_safety(),
    );
    let mut controller = AnyController::new(&config.unwrap()).unwrap();
    let last = Scratch::new(name);
    let before = Scratch(earlier(&last.0));
    let (mut drain, mut feeds) = idle(&last.0, run);
    let mut at = None;
    for tick in records {
        let arm = &tick.arms.first;
        let chunk = arm.chunk_sequence.map(chunk_of_run);
        let outputs = controller.tick(&PerArm::one(TickInput {
            now: tick.now,
            measured: arm.measured,
            chunk: chunk.as_ref(),
            operator: arm.operator,
        }));
        assert_eq!(outputs.first.command, arm.command);
        feeds.tick(&mut drain, tick, dropped(tick.tick));
        feeds
            .snapshots
            .put(tick.tick + 1, feeds.inputs, &controller);
        if at.is_none() && before.0.exists() {
            at = Some(tick.tick);
        }
        if at.is_some_and(|at| tick.tick >= at + 600) {
            break;
        }
    }
    drain.close().unwrap();
    let at = at.unwrap();
    assert_eq!(RunLog::open(&last.0).unwrap().header.left_out, at);
    assert!(fs::metadata(&before.0).unwrap().len() <= BYTES_MAX / 2);
    Turned { last, before, at }
}

/// That the second file is identical from its first tick on.
fn is_identical(files: &Turned) {
    let replayed = replay(&RunLog::open(&files.last.0).unwrap()).unwrap();
    assert!(replayed.identical, "{:?}", replayed.first_difference);
    assert_eq!(replayed.kept_from.unwrap().left_out, files.at);
}

/// What the first file lacks.
fn losses(files: &Turned) -> Vec<Loss> {
    RunLog::open(&files.before.0).unwrap().losses
}

#[test]
fn a_file_begins_where_it_can_be_replayed() {
    let run = run_controller(TICKS);
    let whole = turned("turned-whole", &run, |_| None);
    is_identical(&whole);
    assert_eq!((losses(&whole), whole.at % 250), (Vec::new(), 0));

    // The tick that a state belongs to never comes: the next state is 250 ticks later.
    let lacks_tick = |tick| (tick == whole.at).then_some(Dropped::Tick);
    let files = turned("turned-tick", &run, lacks_tick);
    is_identical(&files);
    assert_eq!(files.at, whole.at + 250);
    let position = usize::try_from(whole.at).unwrap();
    assert_eq!(losses(&files), [Loss::Ticks { position, count: 1 }]);

    // A chunk of two seconds counts in eight states.
    let of = whole.at - 230;
    let lacks_chunk = |tick| (tick == of).then_some(Dropped::Chunk);
    let files = turned("turned-chunk", &run, lacks_chunk);
    is_identical(&files);
    let waits = files.at - whole.at;
    assert!((1500..=2000).contains(&waits), "{waits}");
    assert_eq!(losses(&files), [Loss::Chunk { tick: of }]);
}

#[test]
fn no_state_is_waited_for_beyond_the_bound() {
    let run = run_controller(TICKS);
    let whole = turned("turned-in-time", &run, |_| None);
    let of = whole.at - 230;
    let lacks_all = |tick| (tick >= of).then_some(Dropped::Chunk);
    let files = turned("turned-overdue", &run, lacks_all);
    assert!(files.at > whole.at + 2000, "{}", files.at - whole.at);
    let refused = replay(&RunLog::open(&files.last.0).unwrap()).unwrap_err();
    assert!(matches!(refused, ReplayError::LeftOut { .. }), "{refused}");
}
