//! How far a point can move between two samples of a stop, and what a distance does not fall below
//! meanwhile. Hot path: bounded, no allocation, no I/O, no lock.
//!
//! A clearance is the least of `|p(t) - c| - r`, or of `n . p(t) - d` for a plane, over the points
//! `p` of a link and `c` of the boundary. Two bounds hold between samples that are `gap` apart:
//!
//! * **By the way.** Each of these changes no faster than its point moves, so it lies at most half
//!   the way that the point can go in the gap below the mean of its ends.
//! * **By the bend.** Each of these has a second derivative of at most `K = |p''| + |p'|² / |p -
//!   c|` (`|p''|` for a plane), so that less `K t² / 2` all of them are concave, hence so is the
//!   least of them; a concave function lies above its chord, and `K t² / 2` is at most `K gap² / 8`
//!   below its own. `|p - c|` is at least what the first bound leaves of it.

use crate::snapshot::words;

/// How the points of one link can move in a gap.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Way {
    /// Half of how far they can go, m.
    pub(super) half_m: f64,
    /// Acceleration times the gap squared over eight, m.
    pub(super) bend_m: f64,
    /// Speed squared times the gap squared over eight, m²: what curvature makes of it.
    pub(super) turn_m2: f64,
    /// What a jaw that meets its end adds, m.
    pub(super) kink_m: f64,
}

words!(Way {
    half_m: f64,
    bend_m: f64,
    turn_m2: f64,
    kink_m: f64,
});

impl Way {
    /// The worse of two.
    pub(super) fn worse(&self, other: &Self) -> Self {
        Self {
            half_m: self.half_m.max(other.half_m),
            bend_m: self.bend_m.max(other.bend_m),
            turn_m2: self.turn_m2.max(other.turn_m2),
            kink_m: self.kink_m.max(other.kink_m),
        }
    }

    /// What the distance to a plane that is `h.0` and `h.1` at the ends does not fall below, m.
    pub(super) fn lowest_linear(&self, start: f64, end: f64) -> f64 {
        let by_bend = lowest(start, end, self.bend_m) - self.kink_m;
        by_bend.max(f64::midpoint(start, end) - self.half_m)
    }

    /// The same for the distance to something round, `core_m` being from the surface's level to the
    /// centre's.
    pub(super) fn lowest_round(&self, start: f64, end: f64, core_m: f64) -> f64 {
        let by_way = f64::midpoint(start, end) - self.half_m;
        let to_core_m = by_way + core_m;
        if to_core_m > 0.0 {
            let bend_m = self.bend_m + self.turn_m2 / to_core_m;
            by_way.max(lowest(start, end, bend_m) - self.kink_m)
        } else {
            by_way
        }
    }
}

/// The least value between `start` and `end` of a function whose second derivative is at most `8
/// bend / gap²`, where a parabola of that bend through both ends is least.
pub(super) fn lowest(start: f64, end: f64, bend: f64) -> f64 {
    let low = start.min(end);
    let left = 4.0 * bend - (end - start).abs();
    if left > 0.0 {
        low - left * left / (16.0 * bend)
    } else {
        low
    }
}
