//! A good motion with NaN, infinities, denormal and huge numbers in it.

use hal::{Chunk, TimeNs};

use super::{Adversary, View, below, good_chunk, ticks};
use hal::random::SplitMix64;

const NUMBERS: [f64; 12] = [
    f64::NAN,
    f64::INFINITY,
    f64::NEG_INFINITY,
    5e-324,
    -2.2e-308,
    1e-310,
    1e308,
    -1e308,
    f64::MAX,
    f64::EPSILON,
    -0.0,
    1e16,
];

/// One to twenty numbers of a good chunk replaced.
#[derive(Default)]
pub(super) struct Nonsense {
    patience: u32,
}

impl Adversary for Nonsense {
    fn next(&mut self, random: &mut SplitMix64, view: &View<'_>) -> Option<Chunk> {
        if self.patience > 0 {
            self.patience -= 1;
            return None;
        }
        self.patience = ticks(random, 1, 80);
        let mut chunk = good_chunk(view.now);
        if random.happens(0.3) {
            return Some(chunk);
        }
        // Only the middle of the chunk, or all of it with the same nonsense.
        let everywhere = random.happens(0.3);
        let number = NUMBERS[below(random, NUMBERS.len())];
        let field = below(random, 10);
        for _ in 0..ticks(random, 1, 20) {
            let index = below(random, 100);
            let own = NUMBERS[below(random, NUMBERS.len())];
            put(&mut chunk, index, below(random, 10), own);
        }
        if everywhere {
            for index in 0..100 {
                put(&mut chunk, index, field, number);
            }
        }
        if random.happens(0.1) {
            corrupt_header(random, &mut chunk);
        }
        Some(chunk)
    }
}

fn put(chunk: &mut Chunk, index: usize, field: usize, number: f64) {
    let target = &mut chunk.targets[index];
    match field {
        0..3 => target.position_m[field] = number,
        3..7 => target.rotation_xyzw[field - 3] = number,
        7 => target.jaw = number,
        // A rotation of no length, and one that is barely none.
        8 => target.rotation_xyzw = [number * 1e-300; 4],
        _ => target.position_m = [number; 3],
    }
}

fn corrupt_header(random: &mut SplitMix64, chunk: &mut Chunk) {
    match below(random, 5) {
        0 => chunk.len = u32::MAX,
        1 => chunk.len = 0,
        2 => chunk.step_ns = 0,
        3 => chunk.step_ns = u64::MAX,
        _ => chunk.observed_at = TimeNs(u64::MAX),
    }
}
