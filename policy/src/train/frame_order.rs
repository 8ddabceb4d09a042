//! Which frames a step trains on.

use crate::rng::SplitMix64;

/// Frames in random order, each once before any comes again.
pub(super) struct FrameOrder {
    frames: Vec<usize>,
    next: usize,
}

impl FrameOrder {
    pub(super) fn new(frames: &[usize]) -> Self {
        Self {
            frames: frames.to_vec(),
            next: frames.len(),
        }
    }

    pub(super) fn next(&mut self, count: usize, random: &mut SplitMix64) -> Vec<usize> {
        let mut drawn = Vec::with_capacity(count);
        while drawn.len() < count {
            if self.next >= self.frames.len() {
                random.shuffle(&mut self.frames);
                self.next = 0;
            }
            drawn.push(self.frames[self.next]);
            self.next += 1;
        }
        drawn
    }
}
