//! Wild chunks of many kinds, one after the other.

use hal::chunk::CHUNK_STEPS_MAX;
use hal::{Chunk, TICK_NS, TimeNs};

use super::{Adversary, View, below, chunk, ticks, wild_target};
use hal::random::SplitMix64;

/// Each chunk of another kind of malice.
#[derive(Default)]
pub(super) struct Walk {
    patience: u32,
}

impl Adversary for Walk {
    fn next(&mut self, random: &mut SplitMix64, view: &View<'_>) -> Option<Chunk> {
        if self.patience > 0 {
            self.patience -= 1;
            return None;
        }
        let patient = random.happens(0.5);
        self.patience = ticks(random, 1, if patient { 600 } else { 40 });
        Some(hostile(random, view.now))
    }
}

fn hostile(random: &mut SplitMix64, now: TimeNs) -> Chunk {
    let reach_m = random.between(0.01, 0.3);
    let goal = wild_target(random, reach_m);
    let mut wild = chunk(now, super::STEP_NS, &[goal; CHUNK_STEPS_MAX]);
    match below(random, 9) {
        // One far target.
        0 | 1 => {}
        // Another one every step.
        2 | 3 => wild
            .targets
            .iter_mut()
            .for_each(|target| *target = wild_target(random, reach_m)),
        // Back and forth as fast as a chunk can say it.
        4 => {
            let other = wild_target(random, reach_m);
            wild.step_ns = TICK_NS * u64::from(ticks(random, 1, 100));
            wild.targets
                .iter_mut()
                .step_by(2)
                .for_each(|target| *target = other);
        }
        5 => wild.targets[below(random, CHUNK_STEPS_MAX)].position_m[1] = f64::NAN,
        6 => {
            wild.targets[below(random, CHUNK_STEPS_MAX)].rotation_xyzw =
                [1e308, f64::INFINITY, 0.0, 5e-324];
        }
        7 => {
            wild.observed_at = TimeNs(random.next_u64());
            wild.step_ns = random.next_u64();
            wild.len = u32::try_from(random.next_u64() >> 32).unwrap();
        }
        // Whatever follows is out of order until the arm is enabled anew.
        _ if random.happens(0.1) => wild.sequence = random.next_u64(),
        _ => wild.sequence = 1,
    }
    wild
}
