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

/// A bound on one side of a value.
///
/// An arm that gets its torque beyond a boundary may stay there and get no worse than by `recovery`; the bound comes back
/// with it.
#[derive(Clone, Debug)]
pub(super) struct Boundary {
    command: LimitId,
    tail: LimitId,
    bound: f64,
    /// 1 if the value must be at least the bound, -1 if at most.
    side: f64,
    recovery: f64,
    /// How far outside a value may be; `None` before the first command with torque.
    allowance: Option<f64>,
}

impl Boundary {
    pub(super) fn at_least(
        ledger: &mut Ledger,
        arm: &str,
        name: &str,
        bound: f64,
        recovery: f64,
    ) -> Self {
        Self {
            command: ledger.open(arm, name.to_owned()),
            tail: ledger.open(arm, format!("tail.{name}")),
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

    const fn id(&self, moment: Moment) -> LimitId {
        match moment {
            Moment::Command => self.command,
            Moment::Tail => self.tail,
        }
    }

    /// Checks `value`; the commands' own values set and tighten the allowance.
    pub(super) fn check(&mut self, ledger: &mut Ledger, moment: Moment, value: f64) {
        let fresh = self.allowance_of(value);
        let allowance = self.allowance.unwrap_or(fresh);
        if moment == Moment::Command {
            self.allowance = Some(allowance.min(fresh));
        }
        let bound = self.bound - self.side * allowance;
        let excess = self.side * (bound - value);
        ledger.judge(self.id(moment), excess, TOLERANCE, value, bound);
    }

    /// A value that must be at least the bound and is known to be more than this needs no check: it is neither outside nor
    /// nearer to the bound than any value before it.
    pub(super) fn enough(&self, ledger: &Ledger, moment: Moment) -> f64 {
        self.bound + (-ledger.worst_excess(self.id(moment))).max(0.0)
    }

    /// Takes note of a command's value that is beyond [`Self::enough`].
    pub(super) fn is_clear(&mut self, moment: Moment) {
        if moment == Moment::Command {
            self.allowance = Some(0.0);
        }
    }

    /// Forgets what was allowed: the next value of a command may be outside.
    pub(super) fn forget(&mut self) {
        self.allowance = None;
    }

    /// Something else than a command took the value from `before` to `after`; where that is outward, the bound moves with it.
    pub(super) fn was_moved(&mut self, before: f64, after: f64) {
        let worse = self.outside(after) - self.outside(before);
        if let Some(allowance) = &mut self.allowance
            && worse > 0.0
        {
            *allowance += worse;
            if *allowance <= worse {
                *allowance += self.recovery;
            }
        }
    }

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
