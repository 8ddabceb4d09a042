//! Targets that are elsewhere in every tick, and single ticks that are very far away.

use hal::chunk::CHUNK_STEPS_MAX;
use hal::{Chunk, TICK_NS, TipTarget};

use super::{Adversary, View, below, chunk, good_target, hold, ticks, wild_target};
use hal::random::SplitMix64;

/// Spikes in a good motion, another wild target every tick, or a new chunk every tick.
#[derive(Default)]
pub(super) struct Jumps {
    patience: u32,
    storm: bool,
}

impl Adversary for Jumps {
    fn next(&mut self, random: &mut SplitMix64, view: &View<'_>) -> Option<Chunk> {
        if self.patience > 0 {
            self.patience -= 1;
            let reach_m = random.between(0.001, 0.2);
            return self
                .storm
                .then(|| hold(view.now, wild_target(random, reach_m)));
        }
        self.patience = ticks(random, 5, 250);
        self.storm = random.happens(0.2);
        let mut targets = [good_target(0.0); CHUNK_STEPS_MAX];
        let spikes = random.happens(0.5);
        let reach_m = random.between(0.01, 0.3);
        for (index, target) in targets.iter_mut().enumerate() {
            *target = if spikes {
                good_target(view.now.seconds() + 1e-3 * index as f64)
            } else {
                wild_target(random, reach_m)
            };
        }
        for _ in 0..if spikes { 6 } else { 0 } {
            targets[below(random, CHUNK_STEPS_MAX)] = spike(random);
        }
        Some(chunk(view.now, TICK_NS, &targets))
    }
}

fn spike(random: &mut SplitMix64) -> TipTarget {
    let far_m = [0.02, 0.1, 1.0, 1e3, 1e6][below(random, 5)];
    wild_target(random, far_m)
}
