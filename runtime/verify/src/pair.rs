//! The gaps between two instruments: their shafts, and the tips of either from the shaft of the
//! other. Tips may meet.
//!
//! Each part is a capsule of radius [`SHAFT_RADIUS_M`]. The gaps are checked at each tick for both
//! arms as commanded, at each millisecond of both tails, and for both as measured.

use hal::psm::SHAFT_RADIUS_M;
use nalgebra::Point3;

use super::arm::Newest;
use super::boundary::{Boundary, Moment};
use super::chain::{Instrument, LINK_NAMES};
use super::distance::{Shape, least_gap_m};
use super::ledger::Ledger;
use super::limits::{BetweenArms, Limits};
use super::measured::{MeasuredClearance, Nearest};

/// Shaft from shaft, three parts of either from the other's shaft.
const GAPS: usize = 7;

/// The boundaries between two arms.
#[derive(Clone, Debug)]
pub(super) struct Pair {
    /// In the order of [`gap_names`]: shafts, the first arm's three parts, the second's.
    gaps: [Boundary; GAPS],
    /// Where the arms were.
    before: Option<[Instrument; 2]>,
    /// From surface to surface.
    keep_m: [f64; GAPS],
    measured: Nearest,
    within_m: f64,
}

/// Such as `psm1_wrist.psm2_shaft`.
fn gap_names(first: &str, second: &str) -> [String; GAPS] {
    core::array::from_fn(|index| match index {
        0 => "shaft.shaft".to_owned(),
        1..4 => format!("{first}_{}.{second}_shaft", LINK_NAMES[index]),
        _ => format!("{second}_{}.{first}_shaft", LINK_NAMES[index - 3]),
    })
}

impl Pair {
    /// None unless there are two arms.
    pub(super) fn new(ledger: &mut Ledger, limits: &Limits, between: &BetweenArms) -> Option<Self> {
        let [first, second] = limits.arms.as_slice() else {
            return None;
        };
        let (first, second) = (first.name.as_str(), second.name.as_str());
        let both = format!("{first}+{second}");
        let names = gap_names(first, second);
        let keep_m = core::array::from_fn(|index| match index {
            0 => between.shaft_to_shaft_m,
            _ => between.tip_to_shaft_m,
        });
        let gaps = core::array::from_fn(|index| {
            let name = format!("between_arms.{}", names[index]);
            Boundary::at_least(ledger, &both, &name, keep_m[index], limits.recovery_m)
        });
        let measured = Nearest::new(ledger, &both, "between_arms", names.into_iter());
        Some(Self {
            gaps,
            before: None,
            keep_m,
            measured,
            within_m: limits.guard_m,
        })
    }

    /// How near the measured arms came to one another.
    pub(super) fn measured(&self) -> Option<MeasuredClearance> {
        self.measured.found()
    }

    /// Takes in where both arms are measured, if both hold torque.
    fn seen(&mut self, ledger: &mut Ledger, newest: [&Newest; 2]) {
        if newest.iter().any(|arm| arm.gained) {
            self.measured.begin();
        }
        let [Some(first), Some(second)] = newest.map(|arm| arm.measured) else {
            return;
        };
        let (lines, keep_m) = (lines(&[first, second]), self.keep_m);
        self.measured
            .tick(ledger, self.within_m, |index, enough_m| {
                let gap_m = lines[index].gap_m(enough_m + keep_m[index])?;
                Some(gap_m - keep_m[index])
            });
    }

    /// Checks the newest commands of both arms, unless neither has torque.
    ///
    /// What an arm without torque is pushed to is not the other one's doing: the bounds move with
    /// it.
    pub(super) fn tick(&mut self, ledger: &mut Ledger, newest: [&Newest; 2]) {
        self.seen(ledger, newest);
        let now = newest.map(|newest| newest.at);
        let before = self.before.replace(now);
        if newest.iter().any(|arm| arm.gained) || !newest.iter().any(|arm| arm.powered) {
            self.gaps.iter_mut().for_each(Boundary::forget);
        }
        if !newest.iter().any(|arm| arm.powered) {
            return;
        }
        if let Some(before) = before {
            let mut pushed = before;
            for ((place, arm), now) in pushed.iter_mut().zip(newest).zip(now) {
                if !arm.powered {
                    *place = now;
                }
            }
            if pushed != before {
                self.pushed(&before, &pushed);
            }
        }
        self.check(ledger, Moment::Command, &now);
    }

    /// Takes note of what an arm without torque was pushed to.
    fn pushed(&mut self, before: &[Instrument; 2], after: &[Instrument; 2]) {
        let lines = lines(before).into_iter().zip(lines(after));
        for (gap, (before, after)) in self.gaps.iter_mut().zip(lines) {
            let measure = |line: &Line| line.gap_m(f64::INFINITY).unwrap_or(f64::INFINITY);
            gap.was_moved(measure(&before), measure(&after));
        }
    }

    /// Checks the gaps between two instruments.
    pub(super) fn check(&mut self, ledger: &mut Ledger, moment: Moment, at: &[Instrument; 2]) {
        for (gap, line) in self.gaps.iter_mut().zip(lines(at)) {
            match line.gap_m(gap.enough(ledger, moment)) {
                Some(gap_m) => gap.check(ledger, moment, gap_m),
                None => gap.is_clear(moment),
            }
        }
    }

    /// Forgets where the arms were and what they were allowed.
    pub(super) fn forget(&mut self) {
        self.before = None;
        self.measured.begin();
        self.gaps.iter_mut().for_each(Boundary::forget);
    }
}

/// A shaft, and the centre line of a part of the other instrument.
struct Line {
    shaft: Shape,
    start: Point3<f64>,
    end: Point3<f64>,
}

impl Line {
    fn gap_m(&self, enough_m: f64) -> Option<f64> {
        least_gap_m(&self.shaft, &self.start, &self.end, enough_m)
    }
}

/// What must keep away from what, in the order of the gaps.
fn lines(at: &[Instrument; 2]) -> [Line; GAPS] {
    let links = at.each_ref().map(Instrument::links);
    core::array::from_fn(|index| {
        let (of, link) = match index {
            0 => (0, 0),
            1..4 => (0, index),
            _ => (1, index - 3),
        };
        let (start, end) = links[of][link];
        let (shaft_start, shaft_end) = links[1 - of][0];
        Line {
            shaft: Shape::Capsule {
                start: shaft_start,
                end: shaft_end,
                radius_m: SHAFT_RADIUS_M,
            },
            start,
            end,
        }
    })
}
