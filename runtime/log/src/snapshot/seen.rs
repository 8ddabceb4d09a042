//! The chunks that a controller may still hold, as the writer thread has seen them.

use std::collections::VecDeque;

use hal::{ARMS_MAX, Chunk};

use super::super::item::ChunkItem;
use trocar_control::HeldChunk;
use trocar_control::snapshot::HELD_MAX;

/// The newest chunks of each arm, with their records.
#[derive(Default)]
pub(crate) struct SeenChunks([VecDeque<(u64, Chunk)>; ARMS_MAX]);

impl SeenChunks {
    /// Keeps a chunk that the controller may have accepted.
    pub(crate) fn add(&mut self, item: &ChunkItem) {
        if let Some(chunks) = self.0.get_mut(item.arm) {
            if chunks.len() == HELD_MAX {
                chunks.pop_front();
            }
            chunks.push_back((item.record, item.chunk));
        }
    }

    /// The chunk that `held` names: of several the newest.
    pub(crate) fn find(&self, held: &HeldChunk) -> Option<&(u64, Chunk)> {
        let newest_first = self.0.get(held.arm)?.iter().rev();
        let mut same = newest_first.filter(|(_, chunk)| {
            (chunk.sequence, chunk.observed_at) == (held.sequence, held.observed_at)
        });
        same.next()
    }
}
