//! The gaps between two instruments: their shafts, and the tips of either from the shaft of the other. Tips may meet.

use hal::psm::SHAFT_RADIUS_M;
use nalgebra::Point3;

use super::arm::Newest;
use super::boundary::{Boundary, Moment};
use super::chain::{Instrument, LINK_NAMES};
use super::distance::{Shape, least_gap_m};
use super::ledger::Ledger;
use super::limits::{BetweenArms, Limits};

/// Shaft from shaft, three parts of either from the other's shaft.
const GAPS: usize = 7;

/// The boundaries between two arms.
#[derive(Clone, Debug)]
pub(super) struct Pair {
    gaps: [Boundary; GAPS],
    /// Where the arms were.
    before: Option<[Instrument; 2]>,
}

impl Pair {
    pub(super) fn new(ledger: &mut Ledger, limits: &Limits, between: &BetweenArms) -> Option<Self> {
        let [first, second] = limits.arms.as_slice() else {
            return None;
        };
        let (first, second) = (first.name.as_str(), second.name.as_str());
        let both = format!("{first}+{second}");
        let gaps = core::array::from_fn(|index| {
            let (name, gap_m) = match index {
                0 => ("shaft.shaft".to_owned(), between.shaft_to_shaft_m),
                1..4 => {
                    let link = LINK_NAMES[index];
                    (
                        format!("{first}_{link}.{second}_shaft"),
                        between.tip_to_shaft_m,
                    )
                }
                _ => {
                    let link = LINK_NAMES[index - 3];
                    (
                        format!("{second}_{link}.{first}_shaft"),
                        between.tip_to_shaft_m,
                    )
                }
            };
            let name = format!("between_arms.{name}");
            Boundary::at_least(ledger, &both, &name, gap_m, limits.recovery_m)
        });
        Some(Self { gaps, before: None })
    }

    /// Checks the newest commands of both arms, unless neither has torque.
    ///
    /// What an arm without torque is pushed to is not the other one's doing: the bounds move with it.
    pub(super) fn tick(&mut self, ledger: &mut Ledger, newest: [&Newest; 2]) {
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
