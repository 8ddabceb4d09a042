//! A controller's complete state between two ticks, in words: what a replay goes on from where the
//! beginning of a log was not kept. Taking it is hot path: bounded, no allocation, no I/O, no lock.
//!
//! State is whatever a tick leaves behind and a later one looks at. What is built from the
//! configuration and what each tick computes anew before it is used are none. Each part names all
//! of its fields, so that one that comes to it later must be put on either side.

mod values;

use hal::chunk::CHUNK_STEPS_MAX;
use hal::{ARMS_MAX, Chunk, TimeNs};

pub(crate) use values::{Reader, Stateful, Words, layout, possible, state, words};

/// Room for the state of any controller, in words.
pub const STATE_WORDS_MAX: usize = 2560;

/// Room for the chunks that any controller holds.
pub const HELD_MAX: usize = ARMS_MAX * CHUNK_STEPS_MAX;

/// A controller's complete state between two ticks.
///
/// Of the chunks that it still blends it says which they are. They are large, and whoever takes the
/// snapshot has seen them.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Snapshot {
    layout: u64,
    state: Vec<u64>,
    held: Vec<HeldChunk>,
}

/// A chunk that a controller holds, and where.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct HeldChunk {
    /// The arm, from 0.
    pub arm: usize,
    /// The place among the arm's chunks.
    pub slot: usize,
    /// [`Chunk::sequence`].
    pub sequence: u64,
    /// [`Chunk::observed_at`].
    pub observed_at: TimeNs,
}

/// Why a controller can't go on from a snapshot.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum SnapshotError {
    /// Another version of the program, or a controller of another number of arms, made it.
    #[error("it has another layout: another version of the program wrote it")]
    Layout,
    /// It holds what no controller's state is.
    #[error("it holds what the state of a controller can't be")]
    Impossible,
}

impl Snapshot {
    /// An empty one, with room for the state of any controller: filling it allocates nothing and,
    /// since the room has been written to, takes no page fault.
    #[must_use]
    pub fn new() -> Self {
        let nowhere = HeldChunk {
            arm: usize::MAX,
            slot: usize::MAX,
            sequence: u64::MAX,
            observed_at: TimeNs(u64::MAX),
        };
        let mut state = vec![u64::MAX; STATE_WORDS_MAX];
        let mut held = vec![nowhere; HELD_MAX];
        state.clear();
        held.clear();
        Self {
            layout: 0,
            state,
            held,
        }
    }

    /// The one that has these parts.
    #[must_use]
    pub const fn from_parts(layout: u64, state: Vec<u64>, held: Vec<HeldChunk>) -> Self {
        Self {
            layout,
            state,
            held,
        }
    }

    /// A hash over names and order of all that is in [`Self::state`], and over most types.
    #[must_use]
    pub const fn layout(&self) -> u64 {
        self.layout
    }

    /// The state, apart from chunks.
    #[must_use]
    pub fn state(&self) -> &[u64] {
        &self.state
    }

    /// The chunks that may still count, arm by arm.
    #[must_use]
    pub fn held(&self) -> &[HeldChunk] {
        &self.held
    }

    /// Begins anew.
    pub(super) fn begin(&mut self, layout: u64) {
        self.layout = layout;
        self.state.clear();
        self.held.clear();
    }

    /// Adds a word.
    pub(crate) fn push(&mut self, word: u64) {
        self.state.push(word);
    }

    /// Adds a chunk that the arm `arm` holds at `slot`.
    pub(crate) fn hold(&mut self, arm: usize, slot: usize, chunk: &Chunk) {
        self.held.push(HeldChunk {
            arm,
            slot,
            sequence: chunk.sequence,
            observed_at: chunk.observed_at,
        });
    }

    /// Begins to read the state of a controller whose layout is `layout`; `chunks` are those of
    /// [`Self::held`].
    pub(super) fn read<'a>(
        &'a self,
        layout: u64,
        chunks: &'a [Chunk],
    ) -> Result<Reader<'a>, SnapshotError> {
        if self.layout != layout {
            return Err(SnapshotError::Layout);
        }
        let is = |(held, chunk): (&HeldChunk, &Chunk)| {
            (held.sequence, held.observed_at) == (chunk.sequence, chunk.observed_at)
        };
        if self.held.len() != chunks.len() || !self.held.iter().zip(chunks).all(is) {
            return Err(SnapshotError::Impossible);
        }
        Ok(Reader::new(&self.state, &self.held, chunks))
    }
}

impl Default for Snapshot {
    fn default() -> Self {
        Self::new()
    }
}

#[cfg(test)]
mod tests;
