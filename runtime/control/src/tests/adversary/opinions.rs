//! The filter's answers under attack against Clarabel's.

use super::attack::{self, Attack};
use super::kinds::Kind;
use crate::second_opinion::Comparison;

/// Clarabel's solutions of a run's problems.
#[derive(Debug, Default)]
pub(super) struct ReferenceSolutions {
    problems: u64,
    /// Of these, those that it solved to 1e-9 only.
    rough: u64,
    unsolved: u64,
    change: f64,
    gap: f64,
    violation: f64,
}

impl ReferenceSolutions {
    pub(super) fn add(&mut self, found: Option<Comparison>) {
        self.problems += 1;
        let Some(found) = found else {
            self.unsolved += 1;
            return;
        };
        self.rough += u64::from(found.tolerance > 1e-10);
        self.change = self.change.max(found.change);
        self.gap = self.gap.max(found.objective.abs());
        self.violation = self.violation.max(found.violation);
    }
}

/// Every problem that the filter solved in an attack, as it was.
fn agree<const ARMS: usize>(kinds: &[Kind], seed: u64, ticks: u64, problems: u64) {
    let mut all = ReferenceSolutions::default();
    for (&kind, seed) in kinds.iter().zip(seed..) {
        let attack = Attack {
            ticks,
            second_opinion: true,
            ..Attack::new(kind, seed)
        };
        let (figures, _) = attack.play::<ARMS>();
        let found = figures.opinions;
        all.problems += found.problems;
        all.rough += found.rough;
        all.unsolved += found.unsolved;
        all.change = all.change.max(found.change);
        all.gap = all.gap.max(found.gap);
        all.violation = all.violation.max(found.violation);
    }
    println!("{ARMS} arms: {all:?}");
    assert!(all.problems >= problems, "{all:?}");
    assert!(all.unsolved + all.rough < all.problems / 100, "{all:?}");
    assert!(all.gap < 1e-8 && all.violation < 1e-9, "{all:?}");
    // Moving the joints without the tip costs a thousandth, so that answers far apart are nearly as
    // good: a gap of 1e-10 leaves room for 4e-4.
    assert!(all.change < 5e-5, "{all:?}");
}

#[test]
fn clarabel_agrees_on_recorded_problems() {
    let ticks = attack::ticks().min(70_000);
    agree::<1>(
        &[Kind::BangBang, Kind::Walk, Kind::Climber],
        401,
        ticks,
        ticks * 10 / 7,
    );
}

#[test]
fn clarabel_agrees_on_recorded_problems_of_two_arms() {
    let ticks = attack::ticks().min(60_000) / 4;
    agree::<2>(&[Kind::BangBang, Kind::Climber], 411, ticks, ticks);
}
