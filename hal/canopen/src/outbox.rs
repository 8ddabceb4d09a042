//! What a state machine wants to send: a bounded queue.

use crate::{CanId, Frame, Payload};

/// Frames that an outbox holds.
const CAPACITY: usize = 64;

/// Frames to send, oldest first. What does not fit is counted and lost.
#[derive(Clone, Debug)]
pub struct Outbox {
    frames: [Frame; CAPACITY],
    length: usize,
    lost: u64,
}

impl Default for Outbox {
    fn default() -> Self {
        Self {
            frames: [Frame::new(CanId::truncated(0), Payload::EMPTY); CAPACITY],
            length: 0,
            lost: 0,
        }
    }
}

impl Outbox {
    /// Adds a frame.
    pub fn push(&mut self, frame: Frame) {
        if let Some(place) = self.frames.get_mut(self.length) {
            *place = frame;
            self.length += 1;
        } else {
            self.lost += 1;
        }
    }

    /// The frames.
    #[must_use]
    pub fn frames(&self) -> &[Frame] {
        &self.frames[..self.length]
    }

    /// Forgets the frames.
    pub fn clear(&mut self) {
        self.length = 0;
    }

    /// How many frames found no room, ever.
    #[must_use]
    pub const fn lost(&self) -> u64 {
        self.lost
    }
}
