//! A place or an angle that the instrument must stay within, as a bound on one side of a number.

use super::ledger::{Ledger, LimitId};

/// What a value may exceed its bound by, m or rad; a speed, m/s or rad/s.
pub(super) const TOLERANCE: f64 = 1e-6;

/// What is checked: the command itself, or the stop that travels with it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Moment {
    Command,
    Tail,
}

impl Moment {
    /// Of a command's limit and its tail's, the one for this moment.
    pub(super) const fn of(self, [command, tail]: [LimitId; 2]) -> LimitId {
        match self {
            Self::Command => command,
            Self::Tail => tail,
        }
    }
}

/// A bound on one side of a value.
///
/// An arm that gets its torque beyond a boundary may stay there and get no worse than by
/// `recovery`. As it comes back the bound comes back with it: to go out again is a violation of
/// another name, so that it can be told from the worse one.
#[derive(Clone, Debug)]
pub(super) struct Boundary {
    /// For commands and for their tails.
    limits: [LimitId; 2],
    /// The same for the bound that came back.
    again: [LimitId; 2],
    /// In the unit of the value: m, or rad of an axis that turns.
    bound: f64,
    /// 1 if the value must be at least the bound, -1 if at most.
    side: f64,
    /// Same unit; 0 of axes.
    recovery: f64,
    /// How far outside a value may be; `None` before the first command with torque.
    allowance: Option<Allowance>,
}

/// How far outside a value may be.
#[derive(Clone, Copy, Debug)]
struct Allowance {
    /// Since the arm got its torque.
    first: f64,
    /// Since it came back as far as it did.
    left: f64,
}

impl Boundary {
    /// Opens four limits: `name`, `tail.name`, and both with `.again`.
    pub(super) fn at_least(
        ledger: &mut Ledger,
        arm: &str,
        name: &str,
        bound: f64,
        recovery: f64,
    ) -> Self {
        Self {
            limits: ["", "tail."].map(|of| ledger.open(arm, format!("{of}{name}"))),
            again: ["", "tail."].map(|of| ledger.open(arm, format!("{of}{name}.again"))),
            bound,
            side: 1.0,
            recovery,
            allowance: None,
        }
    }

    pub(super) fn at_most(
        ledger: &mut Ledger,
        arm: &str,
        name: &str,
        bound: f64,
        recovery: f64,
    ) -> Self {
        Self {
            side: -1.0,
            ..Self::at_least(ledger, arm, name, bound, recovery)
        }
    }

    /// Checks `value`; the commands' own values set and tighten the allowance.
    pub(super) fn check(&mut self, ledger: &mut Ledger, moment: Moment, value: f64) {
        let fresh = self.allowance_of(value);
        let Allowance { first, left } = self.allowance.unwrap_or(Allowance {
            first: fresh,
            left: fresh,
        });
        if moment == Moment::Command {
            let left = left.min(fresh);
            self.allowance = Some(Allowance { first, left });
        }
        self.judge(ledger, moment.of(self.limits), value, first);
        if left < first {
            self.judge(ledger, moment.of(self.again), value, left);
        }
    }

    /// The bound in a violation is the one that was allowed.
    fn judge(&self, ledger: &mut Ledger, limit: LimitId, value: f64, allowance: f64) {
        let bound = self.bound - self.side * allowance;
        let excess = self.side * (bound - value);
        ledger.judge(limit, excess, TOLERANCE, value, bound);
    }

    /// A value that must be at least the bound and is known to be more than this needs no check: it
    /// is neither outside nor nearer to the bound than any value before it.
    pub(super) fn enough(&self, ledger: &Ledger, moment: Moment) -> f64 {
        self.bound + (-ledger.worst_excess(moment.of(self.limits))).max(0.0)
    }

    /// Takes note of a command's value that is beyond [`Self::enough`].
    pub(super) fn is_clear(&mut self, moment: Moment) {
        if moment == Moment::Command {
            let first = self.allowance.map_or(0.0, |allowance| allowance.first);
            self.allowance = Some(Allowance { first, left: 0.0 });
        }
    }

    /// Forgets what was allowed: the next value of a command may be outside.
    pub(super) fn forget(&mut self) {
        self.allowance = None;
    }

    /// Something else than a command took the value from `before` to `after`; where that is
    /// outward, the bound moves with it.
    pub(super) fn was_moved(&mut self, before: f64, after: f64) {
        let worse = self.outside(after) - self.outside(before);
        if let Some(Allowance { first, left }) = &mut self.allowance
            && worse > 0.0
        {
            for allowed in [first, left] {
                *allowed += if *allowed > 0.0 {
                    worse
                } else {
                    worse + self.recovery
                };
            }
        }
    }

    /// 0 within.
    fn outside(&self, value: f64) -> f64 {
        (self.side * (self.bound - value)).max(0.0)
    }

    /// How far outside an arm that is at `value` may be.
    fn allowance_of(&self, value: f64) -> f64 {
        let outside = self.outside(value);
        if outside > 0.0 {
            outside + self.recovery
        } else {
            0.0
        }
    }
}
