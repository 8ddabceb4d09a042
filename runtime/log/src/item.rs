//! Records on their way from the threads of a run to the writer thread.

use hal::{Chunk, PerArm, TimeNs};

use super::buses::BusesRecord;
use super::camera::FrameItem;
use super::level::Level;
use super::record::TickRecord;
use super::scene::SceneRecord;

/// A tick on its way.
pub(super) struct TickItem {
    pub(super) record: u64,
    /// The record of each arm's chunk.
    pub(super) chunk_records: PerArm<Option<u64>>,
    pub(super) tick: TickRecord,
}

/// A chunk on its way.
pub(super) struct ChunkItem {
    pub(super) record: u64,
    /// The arm that was given it, from 0.
    pub(super) arm: usize,
    pub(super) chunk: Chunk,
}

/// A scene on its way.
pub(super) struct SceneItem {
    pub(super) at: TimeNs,
    pub(super) scene: SceneRecord,
}

/// An event, a frame or the state of the buses on its way.
pub(super) enum SideItem {
    Event {
        at: TimeNs,
        level: Level,
        text: String,
    },
    Frame(Box<FrameItem>),
    Buses {
        at: TimeNs,
        buses: BusesRecord,
    },
}
