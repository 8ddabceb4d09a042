//! Two arms: no part of one's stop comes near the other's, whenever either stops. Hot path:
//! bounded, no allocation, no I/O, no lock.
//!
//! Two stops are compared at all pairs of times, not only at equal ones: each arm may be late, or
//! stop while the other goes on. What is between the samples is bounded as for one arm, once in the
//! time of either: a point of the one stop at any time and all of the other at a sample first, then
//! both.

use hal::psm::SHAFT_RADIUS_M;
use nalgebra::Vector3;

use super::floor::Floor;
use super::gaps::{Gaps, KINDS};
use super::measured::Nearest;
#[cfg(test)]
use super::planted::{Check, Padding, PlantedGuardFault};
use super::sweep::Rest;
use super::way::Way;
use crate::config::{BetweenArms, Margins};
use crate::distance::distance_between_m;
use crate::instrument::Instrument;
use crate::snapshot::state;

/// What two arms keep between them.
#[derive(Clone, Debug)]
pub(super) struct Pair {
    /// From centre line to centre line: the configured gap and two radii.
    keep_m: Gaps,
    floor: Floor,
    /// What verified stops must keep of each gap beyond that, m: the margin, or less where arms
    /// were enabled too near.
    floors: Gaps,
    /// What the stops up to now kept of margin and deviations together.
    kept: Gaps,
    /// How near the measured arms came to one another.
    pub(super) nearest: Nearest,
    #[cfg(test)]
    pub(super) planted: Option<PlantedGuardFault>,
}

state!(Pair {
    floors: Gaps,
    kept: Gaps,
    nearest: Nearest,
} beside {
    keep_m,
    floor,
    #[cfg(test)]
    planted,
});

impl Pair {
    pub(super) fn new(between: &BetweenArms, margins: &Margins) -> Self {
        Self {
            keep_m: KINDS.map(|kind| {
                let gap_m = if kind == (0, 0) {
                    between.shaft_to_shaft_m
                } else {
                    between.tip_to_shaft_m
                };
                gap_m + 2.0 * SHAFT_RADIUS_M
            }),
            floor: Floor::new(margins),
            floors: [margins.guard_m; KINDS.len()],
            kept: [margins.guard_m; KINDS.len()],
            nearest: Nearest::NEVER,
            #[cfg(test)]
            planted: None,
        }
    }

    /// What two stops leave of each gap at least, as far as it matters.
    pub(super) fn gaps(&self, first: &Rest<'_>, second: &Rest<'_>) -> Gaps {
        let enough_m = self.floor.enough_m();
        core::array::from_fn(|kind| {
            self.least(kind, first, second, f64::NEG_INFINITY, enough_m)
                .min(enough_m)
        })
    }

    /// Stores the clearances of both measured arms.
    pub(super) fn observe(&mut self, first: &Instrument, second: &Instrument) {
        let gaps: Gaps = core::array::from_fn(|kind| self.gap_m(kind, first, second));
        self.nearest.add(&gaps);
    }

    /// What two instruments leave of a gap, m.
    fn gap_m(&self, kind: usize, first: &Instrument, second: &Instrument) -> f64 {
        let (link_a, link_b) = KINDS[kind];
        distance_m(first, link_a, &second.links()[link_b]) - self.keep_m[kind]
    }

    /// Starts anew with two stops, one of which may be under way. Arms that are too near to one
    /// another already may come no nearer, as one that is beyond a boundary.
    pub(super) fn seed(&mut self, first: &Rest<'_>, second: &Rest<'_>) {
        let gaps = self.gaps(first, second);
        self.floors = gaps.map(|gap_m| self.floor.below(gap_m));
        self.kept = self.floors;
    }

    /// One arm was moved; the gaps were `before`.
    ///
    /// A floor moves by as much as its gap did, so that a hand on an arm without torque may bring
    /// it near, and what is measured of it may tremble, without the other arm ever gaining a way
    /// towards it.
    pub(super) fn put(&mut self, before: &Gaps, first: &Rest<'_>, second: &Rest<'_>) {
        let after = self.gaps(first, second);
        for (floor, (before_m, after_m)) in self.floors.iter_mut().zip(before.iter().zip(after)) {
            let moved_m = *floor + (after_m - before_m);
            // At most the margin, and at most the gap itself.
            *floor = self
                .floor
                .below(after_m)
                .max(moved_m.min(self.floor.margin_m()).min(after_m));
        }
        self.kept = self.floors;
    }

    /// What two stops leave of each gap at least, if that is enough while the measured arms deviate
    /// by `allowances`.
    pub(super) fn verify(
        &self,
        first: &Rest<'_>,
        second: &Rest<'_>,
        allowances: &Gaps,
    ) -> Option<Gaps> {
        let mut gaps = [0.0; KINDS.len()];
        for (kind, gap) in gaps.iter_mut().enumerate() {
            let (kept_m, allowance_m) = (self.kept[kind], allowances[kind]);
            let floor_m = self.floor.widened(self.floors[kind], kept_m, allowance_m);
            let enough_m = self.floor.enough_m() + allowance_m;
            *gap = self.least(kind, first, second, floor_m, enough_m);
            #[cfg(test)]
            self.spoil(kind, first, second, gap);
            let keeps = *gap >= floor_m;
            #[cfg(test)]
            let keeps = self
                .planted
                .map_or(keeps, |planted| planted.judge(Check::Pair(kind), keeps));
            if !keeps {
                return None;
            }
        }
        Some(gaps)
    }

    /// Takes back what verified stops with these gaps leave behind, while the measured arms deviate
    /// by `allowances`.
    pub(super) fn tighten(&mut self, gaps: &Gaps, allowances: &Gaps) {
        for ((kept, &gap_m), allowance_m) in self.kept.iter_mut().zip(gaps).zip(allowances) {
            *kept = self.floor.kept(*kept, gap_m, *allowance_m);
        }
        for (floor, &gap_m) in self.floors.iter_mut().zip(gaps) {
            *floor = floor.max(self.floor.below(gap_m));
        }
    }

    /// What two stops leave of a gap at least, or `enough_m` of it, which does not matter, m; or
    /// something that is less than `floor_m`.
    ///
    /// In the common case one distance decides: the arms are further apart than both can travel.
    /// Otherwise it looks at the pairs of samples, at most 21 times 21, but for those that the
    /// triangle inequality rules out.
    fn least(
        &self,
        kind: usize,
        first: &Rest<'_>,
        second: &Rest<'_>,
        floor_m: f64,
        enough_m: f64,
    ) -> f64 {
        let (link_a, link_b) = KINDS[kind];
        let keep_m = self.keep_m[kind];
        let (Some(a), Some(b)) = (first.instruments.first(), second.instruments.first()) else {
            return f64::NEG_INFINITY;
        };
        let b_start = b.links()[link_b];
        let travel_b_m = second.travel_m[link_b];
        let now_m = distance_m(a, link_a, &b_start) - keep_m;
        let far_m = now_m - first.travel_m[link_a] - travel_b_m;
        #[cfg(test)]
        let far_m = self.planted.map_or(far_m, |planted| {
            planted.pad(Padding::PairTravel, now_m, far_m)
        });
        if far_m >= enough_m {
            return far_m;
        }
        let worst_b = second
            .ways
            .iter()
            .fold(Way::default(), |worst, ways| worst.worse(&ways[link_b]));
        let mut low = Low {
            by_way_m: enough_m,
            by_bend_m: enough_m,
        };
        for (a, ways_a) in first.instruments.iter().zip(first.ways) {
            let way_a = &ways_a[link_a];
            let certain_m = certain_m(way_a, &worst_b, keep_m + enough_m);
            // None of the other stop's samples is nearer than this.
            if distance_m(a, link_a, &b_start) - travel_b_m >= certain_m {
                continue;
            }
            let (mut spare_m, mut step_m) = (f64::NEG_INFINITY, 0.0);
            for (b, ways_b) in second.instruments.iter().zip(second.ways) {
                let way_b = &ways_b[link_b];
                spare_m -= step_m;
                step_m = 2.0 * way_b.half_m;
                // The other stop can't have come near enough to matter since the sample before.
                if spare_m >= 0.0 {
                    continue;
                }
                let apart_m = distance_m(a, link_a, &b.links()[link_b]);
                spare_m = apart_m - certain_m;
                low = low.with(&Low::of(apart_m, way_a, way_b, keep_m));
                if low.least_m() < floor_m {
                    return low.least_m();
                }
            }
        }
        low.least_m()
    }

    /// Lets a planted fault change the least gap.
    #[cfg(test)]
    fn spoil(&self, kind: usize, first: &Rest<'_>, second: &Rest<'_>, least_m: &mut f64) {
        let Some(planted) = self.planted else { return };
        let (link_a, link_b) = KINDS[kind];
        let gap = |a: &Instrument, b: &Instrument| {
            distance_m(a, link_a, &b.links()[link_b]) - self.keep_m[kind]
        };
        if planted == PlantedGuardFault::EqualTimesOnly {
            let pairs = first.instruments.iter().zip(second.instruments);
            *least_m = pairs.fold(f64::INFINITY, |least, (a, b)| least.min(gap(a, b)));
            return;
        }
        if planted != PlantedGuardFault::NoPadding(Padding::Pair)
            && planted != PlantedGuardFault::NegatedPadding(Padding::Pair)
        {
            return;
        }
        let mut plain_m = f64::INFINITY;
        for a in first.instruments {
            for b in second.instruments {
                plain_m = plain_m.min(gap(a, b));
            }
        }
        *least_m = planted.pad(Padding::Pair, plain_m, *least_m);
    }
}

/// Two lower bounds of what is left of a gap around two samples, m; of each the least over all
/// samples is one for the stops.
#[derive(Clone, Copy)]
struct Low {
    /// By the way: less how far both links can go from their nearer sample.
    by_way_m: f64,
    /// By the bend: less how far acceleration and curvature can bend the distance below its chord;
    /// minus infinity where the arms may touch.
    by_bend_m: f64,
}

impl Low {
    /// The bounds around two samples that are `apart_m` apart, centre line to centre line.
    fn of(apart_m: f64, a: &Way, b: &Way, keep_m: f64) -> Self {
        let way_m = a.half_m + b.half_m;
        // Nearer than this the links do not come before the next samples, or since the last ones.
        let nearest_m = apart_m - 2.0 * way_m;
        let bend_m = a.bend_m + a.kink_m + b.bend_m + b.kink_m;
        let by_bend_m = if nearest_m > 0.0 {
            apart_m - keep_m - bend_m - (a.turn_m2 + b.turn_m2) / nearest_m
        } else {
            f64::NEG_INFINITY
        };
        Self {
            by_way_m: apart_m - keep_m - way_m,
            by_bend_m,
        }
    }

    /// The better of both.
    fn least_m(&self) -> f64 {
        self.by_way_m.max(self.by_bend_m)
    }

    fn with(&self, other: &Self) -> Self {
        Self {
            by_way_m: self.by_way_m.min(other.by_way_m),
            by_bend_m: self.by_bend_m.min(other.by_bend_m),
        }
    }
}

/// How far apart two samples must be for both bounds around them to be `level_m` at least, centre
/// line to centre line.
fn certain_m(a: &Way, b: &Way, level_m: f64) -> f64 {
    let way_m = a.half_m + b.half_m;
    let nearest_m = level_m - way_m;
    if nearest_m > 0.0 {
        let bend_m = a.bend_m + a.kink_m + b.bend_m + b.kink_m;
        level_m + way_m.max(bend_m + (a.turn_m2 + b.turn_m2) / nearest_m)
    } else {
        f64::INFINITY
    }
}

/// From a link of `a` to a segment, centre line to centre line, m.
fn distance_m(a: &Instrument, link: usize, other: &(Vector3<f64>, Vector3<f64>)) -> f64 {
    let (from_m, to_m) = &a.links()[link];
    distance_between_m(from_m, to_m, &other.0, &other.1)
}
