//! What the perception promises, against geometry worked out here in double precision and against
//! the plain algorithms.

mod drawn;
mod frames;
mod sampling;

use hal::random::SplitMix64;

use super::Point;

/// A number of `random` from `low` to `high`.
#[expect(clippy::cast_possible_truncation, reason = "coordinates")]
fn between(random: &mut SplitMix64, low: f64, high: f64) -> f32 {
    (low + 0.5 * (random.signed_unit() + 1.0) * (high - low)) as f32
}

/// `count` points in the box of `sides` around the origin.
fn scattered(random: &mut SplitMix64, count: usize, sides: [f64; 3]) -> Vec<Point> {
    (0..count)
        .map(|_| sides.map(|side| between(random, -0.5 * side, 0.5 * side)))
        .collect()
}
