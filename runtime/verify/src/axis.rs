//! One axis of an arm: its range, and how it moves from command to command.

use super::boundary::{Boundary, Moment};
use super::differences::History;
use super::ledger::{Ledger, LimitId};
use super::limits::AxisLimits;

/// What a derivative may exceed its bound by, as a fraction of it.
pub(super) const SHARE: f64 = 1e-6;

/// Speed below which an arm counts as resting, rad/s (m/s), and what the command of an arm without torque may be away from
/// the arm, rad (m): it is a copy.
pub(super) const REST: f64 = 1e-9;

/// Time between two commands, s.
pub(super) const PERIOD_S: f64 = 1e-3;

/// What the derivatives are called, by order.
pub(super) const DERIVATIVES: [&str; 3] = ["velocity", "acceleration", "jerk"];

/// The checks of one axis.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    /// Which one it is.
    index: usize,
    bounds: [f64; 3],
    range: [Boundary; 2],
    derivatives: [LimitId; 3],
    commanded_velocity: LimitId,
    disabled_position: LimitId,
    disabled_velocity: LimitId,
}

impl Axis {
    pub(super) fn new(ledger: &mut Ledger, arm: &str, index: usize, limits: &AxisLimits) -> Self {
        let name = |what: &str| format!("{}.{what}", limits.name);
        Self {
            index,
            bounds: limits.derivatives,
            range: [
                Boundary::at_least(ledger, arm, &name("low"), limits.low, 0.0),
                Boundary::at_most(ledger, arm, &name("high"), limits.high, 0.0),
            ],
            derivatives: DERIVATIVES.map(|what| ledger.open(arm, name(what))),
            commanded_velocity: ledger.open(arm, name("commanded_velocity")),
            disabled_position: ledger.open(arm, name("disabled_position")),
            disabled_velocity: ledger.open(arm, name("disabled_velocity")),
        }
    }

    /// Checks where the axis is.
    pub(super) fn place(&mut self, ledger: &mut Ledger, moment: Moment, position: f64) {
        for end in &mut self.range {
            end.check(ledger, moment, position);
        }
    }

    /// Checks how the newest setpoint of `history` was reached, and the velocity that goes to the drives along with it.
    pub(super) fn motion(&self, ledger: &mut Ledger, history: &History, velocity: f64) {
        let limits = self.derivatives.into_iter().zip(self.bounds).zip(1..);
        for ((limit, bound), order) in limits {
            if let Some(quotient) = history.quotient(self.index, order, PERIOD_S) {
                let tolerance = SHARE * bound + quotient.rounding;
                let excess = quotient.value.abs() - bound;
                ledger.judge(limit, excess, tolerance, quotient.value, bound);
            }
        }
        let [bound, ..] = self.bounds;
        let excess = velocity.abs() - bound;
        ledger.judge(
            self.commanded_velocity,
            excess,
            SHARE * bound,
            velocity,
            bound,
        );
    }

    /// Checks that an axis without torque is told to be where it is.
    pub(super) fn limp_place(&self, ledger: &mut Ledger, position: f64, expected: f64) {
        let excess = (position - expected).abs();
        ledger.judge(self.disabled_position, excess, REST, position, expected);
    }

    /// Checks that an axis without torque is not told to move.
    pub(super) fn limp_velocity(&self, ledger: &mut Ledger, velocity: f64) {
        ledger.judge(self.disabled_velocity, velocity.abs(), REST, velocity, 0.0);
    }

    pub(super) fn forget(&mut self) {
        self.range.iter_mut().for_each(Boundary::forget);
    }
}
