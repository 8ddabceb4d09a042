//! As fast as possible from one far corner to another.

use hal::chunk::CHUNK_STEPS_MAX;
use hal::{Chunk, TICK_NS};

use super::{Adversary, View, chunk, ticks, wild_target};
use hal::random::SplitMix64;

/// Two corners, one after the other, each for 1 to 500 ms.
#[derive(Default)]
pub(super) struct BangBang {
    patience: u32,
}

impl Adversary for BangBang {
    fn next(&mut self, random: &mut SplitMix64, view: &View<'_>) -> Option<Chunk> {
        if self.patience > 0 {
            self.patience -= 1;
            return None;
        }
        self.patience = ticks(random, 1, 900);
        let reach_m = random.between(0.05, 0.3);
        let corners = [wild_target(random, reach_m), wild_target(random, reach_m)];
        let mut targets = [corners[0]; CHUNK_STEPS_MAX];
        let period = if random.happens(0.5) { 1 } else { 2 };
        for (index, target) in targets.iter_mut().enumerate() {
            *target = corners[(index / period) % 2];
        }
        let step = u64::from(ticks(random, 1, 500));
        Some(chunk(view.now, TICK_NS * step, &targets))
    }
}
