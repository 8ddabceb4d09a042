//! One axis of an arm: its range, and how it moves from command to command.

use super::boundary::{Boundary, Moment};
use super::differences::History;
use super::ledger::{Ledger, LimitId};
use super::limits::AxisLimits;

/// What a derivative may exceed its bound by, as a fraction of it.
pub(super) const SHARE: f64 = 1e-6;

/// Speed below which an arm counts as resting, rad/s (m/s), and what the command of an arm without
/// torque may be away from the arm, rad (m): it is a copy.
pub(super) const REST: f64 = 1e-9;

/// Time between two commands, s.
pub(super) const PERIOD_S: f64 = 1e-3;

/// What the derivatives are called, by order.
pub(super) const DERIVATIVES: [&str; 3] = ["velocity", "acceleration", "jerk"];

/// What a rate is of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Order {
    /// Of a position.
    Velocity,
    /// Of a velocity.
    Acceleration,
}

/// The checks of one axis.
#[derive(Clone, Debug)]
pub(super) struct Axis {
    /// Which one it is.
    index: usize,
    /// Velocity, acceleration and jerk, rad (m) and s.
    bounds: [f64; 3],
    /// Low and high. Beyond its range an axis gets no recovery margin.
    range: [Boundary; 2],
    derivatives: [LimitId; 3],
    commanded_velocity: LimitId,
    commanded_acceleration: LimitId,
    /// Velocity against the positions, acceleration against the velocities.
    mismatches: [LimitId; 2],
    disabled_acceleration: LimitId,
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
            commanded_acceleration: ledger.open(arm, name("commanded_acceleration")),
            mismatches: ["velocity_mismatch", "acceleration_mismatch"]
                .map(|what| ledger.open(arm, name(what))),
            disabled_acceleration: ledger.open(arm, name("disabled_acceleration")),
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

    /// Checks how the newest setpoint of `history` was reached.
    pub(super) fn motion(&self, ledger: &mut Ledger, history: &History) {
        let limits = self.derivatives.into_iter().zip(self.bounds).zip(1..);
        for ((limit, bound), order) in limits {
            if let Some(quotient) = history.quotient(self.index, order, PERIOD_S) {
                let tolerance = SHARE * bound + quotient.rounding;
                let excess = quotient.value.abs() - bound;
                ledger.judge(limit, excess, tolerance, quotient.value, bound);
            }
        }
    }

    /// Checks the velocity that goes to the drives along with a setpoint, and a joint's
    /// acceleration.
    pub(super) fn commanded(&self, ledger: &mut Ledger, velocity: f64, acceleration: Option<f64>) {
        let [velocity_max, acceleration_max, _] = self.bounds;
        let values = [
            (self.commanded_velocity, Some(velocity), velocity_max),
            (self.commanded_acceleration, acceleration, acceleration_max),
        ];
        for (limit, value, bound) in values {
            if let Some(value) = value {
                ledger.judge(limit, value.abs() - bound, SHARE * bound, value, bound);
            }
        }
    }

    /// Checks that a rate is that of the value that it is said to be of: `change` is what came of
    /// `rates`, before and now, in `elapsed_s`.
    ///
    /// With at most the highest jerk between, the mean of both rates is no further from the mean
    /// rate.
    ///
    /// This is the error of the trapezoidal rule: of a rate whose second derivative is at most `j`
    /// it is `j h^2 / 12`, of one whose first derivative is at most `j` it is `j h / 4`.
    pub(super) fn agrees(
        &self,
        ledger: &mut Ledger,
        order: Order,
        change: f64,
        rates: [f64; 2],
        elapsed_s: f64,
    ) {
        let [.., jerk] = self.bounds;
        let bound = match order {
            Order::Velocity => jerk * elapsed_s * elapsed_s / 12.0,
            Order::Acceleration => jerk * elapsed_s / 4.0,
        };
        let [before, now] = rates;
        let off = change / elapsed_s - f64::midpoint(before, now);
        let rounding = REST / elapsed_s * SHARE;
        let excess = off.abs() - bound;
        let limit = self.mismatches[order as usize];
        ledger.judge(limit, excess, SHARE * bound + rounding, off, bound);
    }

    /// Checks that the commanded position of an axis without torque is the measured one.
    pub(super) fn limp_place(&self, ledger: &mut Ledger, position: f64, expected: f64) {
        let excess = (position - expected).abs();
        ledger.judge(self.disabled_position, excess, REST, position, expected);
    }

    /// Checks that the commanded velocity of an axis without torque is zero.
    pub(super) fn limp_velocity(&self, ledger: &mut Ledger, velocity: f64) {
        ledger.judge(self.disabled_velocity, velocity.abs(), REST, velocity, 0.0);
    }

    /// Checks that the commanded acceleration of an axis without torque is zero.
    pub(super) fn limp_acceleration(&self, ledger: &mut Ledger, acceleration: f64) {
        let limit = self.disabled_acceleration;
        ledger.judge(limit, acceleration.abs(), REST, acceleration, 0.0);
    }

    /// The next command may be out of range, and sets how far out later ones may be.
    pub(super) fn forget(&mut self) {
        self.range.iter_mut().for_each(Boundary::forget);
    }
}
