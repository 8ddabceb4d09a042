//! The controller's state at the edge of two files of a bounded log, from which a replay goes on:
//! as a message, and read back.

mod queue;
mod seen;

use hal::Chunk;
use hal::chunk::CHUNK_STEPS_MAX;
use serde::{Deserialize, Serialize};

use super::json::{ChunkMessage, TARGET_BYTES_MAX};
use trocar_control::{AnyController, CommandHash, HeldChunk, InputHash, Snapshot, SnapshotError};

pub(super) use queue::{QUEUED_TICKS, SnapshotFeed, SnapshotItem, SnapshotQueue, snapshot_queue};
pub(super) use seen::SeenChunks;

/// Hexadecimal digits of a word.
const WORD_DIGITS: usize = 16;

/// Bytes of a message without state and chunks, and of a chunk without its targets: names,
/// punctuation, and numbers of 20 digits at most.
const HEAD_BYTES_MAX: usize = 256;
const HELD_BYTES_MAX: usize = 256;

/// `/snapshot`.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct SnapshotMessage {
    /// Record of the tick that follows it.
    record: u64,
    /// Hashes of all inputs and of all commands before it.
    ///
    /// 16 hexadecimal digits each, as is `layout`.
    input_hash: String,
    command_hash: String,
    layout: String,
    /// 16 hexadecimal digits a word, without anything between.
    state: String,
    chunks: Vec<HeldMessage>,
}

/// A chunk that the controller holds, and where.
#[derive(Debug, Serialize, Deserialize)]
pub(super) struct HeldMessage {
    arm: usize,
    /// Of the arm's ring of chunks.
    slot: usize,
    chunk: ChunkMessage,
}

impl SnapshotMessage {
    /// Of `item`, whose chunks are in `seen`; none if one was dropped on its way.
    pub(super) fn new(item: &SnapshotItem, seen: &SeenChunks) -> Option<Self> {
        let snapshot = &item.snapshot;
        let held = snapshot.held().iter().map(|held| {
            let (record, chunk) = seen.find(held)?;
            Some(HeldMessage {
                arm: held.arm,
                slot: held.slot,
                chunk: ChunkMessage::new(*record, chunk),
            })
        });
        Some(Self {
            record: item.record,
            input_hash: hexadecimal(item.inputs.value()),
            command_hash: hexadecimal(item.commands.value()),
            layout: hexadecimal(snapshot.layout()),
            state: snapshot.state().iter().copied().map(hexadecimal).collect(),
            chunks: held.collect::<Option<_>>()?,
        })
    }

    /// Bytes that the message of `item` takes in a file at most; of a chunk that was dropped on its
    /// way the length is unknown.
    pub(super) fn bytes_max(item: &SnapshotItem, seen: &SeenChunks) -> u64 {
        let held = item.snapshot.held().iter().map(|held| {
            let chunk = seen.find(held);
            let steps = chunk.map_or(CHUNK_STEPS_MAX, |(_, chunk)| chunk.valid_targets().len());
            HELD_BYTES_MAX + TARGET_BYTES_MAX * steps
        });
        let state = WORD_DIGITS * item.snapshot.state().len();
        (HEAD_BYTES_MAX + state + held.sum::<usize>()) as u64
    }
}

/// The controller's state between two ticks, as it is read back.
#[derive(Clone, Debug)]
pub struct LoggedSnapshot {
    /// Record of the tick that follows it.
    pub(super) record: u64,
    /// Hash of all inputs before it.
    pub(super) inputs: InputHash,
    /// Hash of all commands before it.
    pub(super) commands: CommandHash,
    pub(super) snapshot: Snapshot,
    /// Those of [`Snapshot::held`].
    pub(super) chunks: Vec<Chunk>,
}

impl LoggedSnapshot {
    /// Makes `controller`, built from the log's configuration, go on from here.
    ///
    /// # Errors
    /// [`SnapshotError`]; the controller is of no use then.
    pub fn restore(&self, controller: &mut AnyController) -> Result<(), SnapshotError> {
        controller.restore(&self.snapshot, &self.chunks)
    }

    /// The state of `controller` before the tick of `record`.
    pub(super) fn of(
        controller: &AnyController,
        record: u64,
        (inputs, commands): (InputHash, CommandHash),
    ) -> Self {
        let mut snapshot = Snapshot::new();
        controller.save(&mut snapshot);
        let held = snapshot.held().iter();
        let chunks = held.filter_map(|held| controller.held(held).copied());
        Self {
            record,
            inputs,
            commands,
            chunks: chunks.collect(),
            snapshot,
        }
    }

    /// The first thing that this state and the `other` have otherwise, as each has it; nothing if
    /// they are the same to the bit.
    pub(super) fn difference(&self, other: &Self) -> Option<(&'static str, [String; 2])> {
        let hashes = [
            ("inputs", self.inputs.value(), other.inputs.value()),
            (
                "command_hash",
                self.commands.value(),
                other.commands.value(),
            ),
        ];
        for (what, own, its) in hashes {
            if own != its {
                return Some((what, [own, its].map(hexadecimal)));
            }
        }
        let (own, its) = (&self.snapshot, &other.snapshot);
        let mut words = own.state().iter().zip(its.state()).enumerate();
        if let Some((place, (own, its))) = words.find(|(_, (own, its))| own != its) {
            let word = |word: u64| format!("{} as its word {place}", hexadecimal(word));
            return Some(("state", [*own, *its].map(word)));
        }
        let contents = |chunks: &[Chunk]| chunks.iter().map(hash).collect::<Vec<_>>();
        let same = own == its && contents(&self.chunks) == contents(&other.chunks);
        let differ = ["other chunks", "its own"].map(str::to_owned);
        (!same).then_some(("state", differ))
    }

    /// Reads a message of `/snapshot`. An error names what is wrong with it.
    pub(super) fn read(message: &[u8]) -> Result<Self, String> {
        let SnapshotMessage {
            record,
            input_hash,
            command_hash,
            layout,
            state,
            chunks: held,
        } = serde_json::from_slice(message).map_err(|error| error.to_string())?;
        let (words, rest) = state.as_bytes().as_chunks::<WORD_DIGITS>();
        let state: Option<Vec<u64>> = words.iter().map(|digits| word(digits)).collect();
        let state = state.filter(|_| rest.is_empty());
        let chunks: Option<Vec<Chunk>> = held.iter().map(|held| held.chunk.chunk()).collect();
        let chunks = chunks.ok_or("a chunk has more targets than a chunk can hold")?;
        let places = held.iter().zip(&chunks).map(|(held, chunk)| HeldChunk {
            arm: held.arm,
            slot: held.slot,
            sequence: chunk.sequence,
            observed_at: chunk.observed_at,
        });
        let number = |text: &str| word(text.as_bytes()).ok_or("a hash is no hexadecimal number");
        let state = state.ok_or("the state is not made of hexadecimal words")?;
        Ok(Self {
            record,
            inputs: InputHash::resumed(number(&input_hash)?),
            commands: CommandHash::resumed(number(&command_hash)?),
            snapshot: Snapshot::from_parts(number(&layout)?, state, places.collect()),
            chunks,
        })
    }
}

/// A hash over what counts of a chunk.
fn hash(chunk: &Chunk) -> u64 {
    let mut hash = InputHash::new();
    hash.chunk(0, chunk);
    hash.value()
}

/// The digits of a word.
fn hexadecimal(word: u64) -> String {
    format!("{word:016x}")
}

/// The word with these digits.
fn word(digits: &[u8]) -> Option<u64> {
    let text = core::str::from_utf8(digits).ok()?;
    let plain = text.len() == WORD_DIGITS && !text.starts_with('+');
    plain.then(|| u64::from_str_radix(text, 16).ok()).flatten()
}
