//! A good motion whose messages come late, twice, in the wrong order or not at all.

use hal::chunk::CHUNK_STEPS_MAX;
use hal::{Chunk, TimeNs};
use nalgebra::Vector3;

use super::{Adversary, View, below, good_chunk, ticks};
use hal::random::SplitMix64;

/// Chunks on their way.
#[derive(Default)]
pub(super) struct Messages {
    under_way: Vec<(u64, Box<Chunk>)>,
    seen: Vec<Box<Chunk>>,
    patience: u32,
    silence: u32,
}

impl Adversary for Messages {
    fn next(&mut self, random: &mut SplitMix64, view: &View<'_>) -> Option<Chunk> {
        let now_ns = view.now.0;
        if self.patience == 0 {
            self.patience = ticks(random, 1, 120);
            self.send(random, now_ns);
        }
        self.patience -= 1;
        if self.silence > 0 {
            self.silence -= 1;
            return None;
        }
        if random.happens(5e-4) {
            self.silence = ticks(random, 50, 6000);
        }
        if random.happens(0.01) && !self.seen.is_empty() {
            let again = below(random, self.seen.len());
            return Some(*self.seen[again]);
        }
        let due = self.under_way.iter().position(|(at, _)| *at <= now_ns)?;
        let (_, chunk) = self.under_way.swap_remove(due);
        if self.seen.len() == 8 {
            self.seen.remove(0);
        }
        self.seen.push(chunk.clone());
        Some(*chunk)
    }
}

impl Messages {
    /// Sends off a chunk, unless it is lost; it is late by up to 3 s, so that it is overtaken.
    fn send(&mut self, random: &mut SplitMix64, now_ns: u64) {
        if random.happens(0.25) || self.under_way.len() >= 16 {
            return;
        }
        let mut chunk = good_chunk(TimeNs(now_ns));
        // The policies behind the chunks disagree about where the motion is.
        let aside_m = Vector3::new(
            random.between(-0.02, 0.02),
            random.between(-0.02, 0.02),
            0.0,
        );
        let short = below(random, CHUNK_STEPS_MAX) + 1;
        for target in &mut chunk.targets[..short] {
            for axis in 0..3 {
                target.position_m[axis] += aside_m[axis];
            }
        }
        chunk.len = chunk.len.min(ticks(random, 1, 120));
        let late_ns = match below(random, 4) {
            0 => 0,
            1 => random.next_u64() % 100_000_000,
            2 => random.next_u64() % 700_000_000,
            _ => random.next_u64() % 3_000_000_000,
        };
        self.under_way.push((now_ns + late_ns, Box::new(chunk)));
    }
}
