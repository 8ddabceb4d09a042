//! Checks one command after the other against the limits.

use core::fmt::Display;

use hal::psm::SHAFT_RADIUS_M;
use hal::{ArmCommand, TICK_NS};
use nalgebra::Point3;

use super::Violation;
use super::chain::{Instrument, distance_to_segment, instrument};
use super::differences::{AXES, History};
use super::limits::Limits;
use crate::log::LoggedTick;

/// What a value may exceed its bound by, in the bound's own unit and, for derivatives, as a fraction of it.
const TOLERANCE: f64 = 1e-6;

/// The arm whose commands a log holds.
const ARM: &str = "psm1";

const PERIOD_S: f64 = 1e-3;
const DERIVATIVES: [(usize, &str); 3] = [(1, "velocity"), (2, "acceleration"), (3, "jerk")];

/// The state of the check between two commands.
pub(super) struct Checker<'a> {
    limits: &'a Limits,
    history: History,
    tip: Option<Point3<f64>>,
    stamp: Option<u64>,
    /// How far outside each boundary the arm was when it was enabled, and may therefore be; empty before.
    allowances: Vec<f64>,
    tick: u64,
    pub(super) skipped_periods: u64,
    pub(super) violations: Vec<Violation>,
}

impl<'a> Checker<'a> {
    pub(super) const fn new(limits: &'a Limits) -> Self {
        Self {
            limits,
            history: History::new(),
            tip: None,
            stamp: None,
            allowances: Vec::new(),
            tick: 0,
            skipped_periods: 0,
            violations: Vec::new(),
        }
    }

    /// Checks the next command.
    pub(super) fn tick(&mut self, logged: &LoggedTick) {
        self.tick = logged.tick;
        let command = &logged.command;
        self.stamp(command);
        if !command.enabled {
            // Without torque the command moves nothing; it follows the measured arm.
            self.forget();
            return;
        }
        let at = instrument(&command.position);
        let boundaries = self.boundaries(command, &at);
        if self.allowances.is_empty() {
            self.allowances = boundaries.iter().map(Boundary::allowance).collect();
        }
        for (index, boundary) in boundaries.iter().enumerate() {
            let allowance = self.allowances.get(index).copied().unwrap_or(0.0);
            if let Some(kept) = self.allowances.get_mut(index) {
                // Boundaries come back with the arm.
                *kept = kept.min(boundary.allowance());
            }
            let bound = boundary.bound - boundary.sign * allowance;
            let excess = boundary.sign * (bound - boundary.value);
            self.judge(excess, TOLERANCE, &boundary.name, boundary.value, bound);
        }
        self.derivatives(command);
        if let Some(before) = self.tip.replace(at.control_point) {
            let speed = (at.control_point - before).norm() / PERIOD_S;
            let bound = self.limits.tip_speed_m_s;
            self.judge(speed - bound, TOLERANCE, "tip_speed", speed, bound);
        }
    }

    /// Starts afresh after a gap in the log.
    pub(super) fn forget(&mut self) {
        self.history.clear();
        self.tip = None;
        self.allowances.clear();
    }

    /// Says that `count` ticks before this one are missing.
    pub(super) fn missing(&mut self, tick: u64, count: u64) {
        self.tick = tick;
        self.forget();
        self.stamp = None;
        #[expect(clippy::cast_precision_loss, reason = "for people")]
        self.report("missing_ticks", count as f64, 0.0);
    }

    /// Stamps must rise by whole periods; more than one is a period that the driver skipped.
    fn stamp(&mut self, command: &ArmCommand) {
        let now = command.stamp.0;
        let Some(before) = self.stamp.replace(now) else {
            return;
        };
        let step = now.wrapping_sub(before);
        if now <= before || step % TICK_NS != 0 {
            #[expect(clippy::cast_precision_loss, reason = "for people")]
            self.report("stamp", now as f64 - before as f64, 1e9 * PERIOD_S);
        } else {
            self.skipped_periods += step / TICK_NS - 1;
        }
    }

    fn derivatives(&mut self, command: &ArmCommand) {
        let mut sample = [command.jaw_position; AXES];
        for (value, &joint) in sample.iter_mut().zip(command.position.iter()) {
            *value = joint;
        }
        self.history.push(sample);
        let limits = self.limits;
        for (axis, limit) in limits.axes.iter().enumerate() {
            for ((order, derivative), &bound) in DERIVATIVES.into_iter().zip(&limit.derivatives) {
                if let Some(quotient) = self.history.quotient(axis, order, PERIOD_S) {
                    let tolerance = TOLERANCE * bound + quotient.rounding;
                    let name = format_args!("{}.{derivative}", limit.name);
                    self.judge(
                        quotient.value.abs() - bound,
                        tolerance,
                        name,
                        quotient.value,
                        bound,
                    );
                }
            }
        }
        for (axis, limit) in limits.axes.iter().enumerate() {
            // The velocity that goes to the drives along with the position.
            let said = command
                .velocity
                .get(axis)
                .copied()
                .unwrap_or(command.jaw_velocity);
            let bound = limit.derivatives[0];
            let name = format_args!("{}.commanded_velocity", limit.name);
            self.judge(said.abs() - bound, TOLERANCE * bound, name, said, bound);
        }
    }

    /// Every boundary and where the command is.
    fn boundaries(&self, command: &ArmCommand, at: &Instrument) -> Vec<Boundary> {
        let mut all = Vec::new();
        for (axis, limit) in self.limits.axes.iter().enumerate() {
            let value = command
                .position
                .get(axis)
                .copied()
                .unwrap_or(command.jaw_position);
            all.push(Boundary::at_least(
                format!("{}.low", limit.name),
                value,
                limit.low,
                0.0,
            ));
            all.push(Boundary::at_most(
                format!("{}.high", limit.name),
                value,
                limit.high,
                0.0,
            ));
        }
        let recovery_m = self.limits.recovery_m;
        for (name, point) in [
            ("control_point", &at.control_point),
            ("finger_tips", &at.finger_tips),
        ] {
            for (axis, letter) in ["x", "y", "z"].into_iter().enumerate() {
                let (low, high) = (self.limits.box_low_m[axis], self.limits.box_high_m[axis]);
                let value = point[axis];
                all.push(Boundary::at_least(
                    format!("workspace.{name}.{letter}_min"),
                    value,
                    low,
                    recovery_m,
                ));
                all.push(Boundary::at_most(
                    format!("workspace.{name}.{letter}_max"),
                    value,
                    high,
                    recovery_m,
                ));
            }
        }
        for sphere in &self.limits.spheres {
            let center = Point3::from(sphere.center_m);
            let links = [
                ("shaft", Point3::origin(), at.wrist_pitch),
                ("wrist", at.wrist_pitch, at.control_point),
                ("fingers", at.control_point, at.finger_tips),
            ];
            for (part, start, end) in links {
                // Wrist and fingers are thinner than the shaft; they count as thick as it is.
                let value = distance_to_segment(&center, &start, &end) - SHAFT_RADIUS_M;
                let name = format!("forbidden.{}.{part}", sphere.name);
                all.push(Boundary::at_least(name, value, sphere.radius_m, recovery_m));
            }
        }
        all
    }

    /// Notes a violation unless `excess` is at most `tolerance`; NaN is one.
    fn judge(&mut self, excess: f64, tolerance: f64, limit: impl Display, value: f64, bound: f64) {
        let fine = excess <= tolerance;
        if !fine {
            self.report(limit, value, bound);
        }
    }

    fn report(&mut self, limit: impl Display, value: f64, bound: f64) {
        let limit = limit.to_string();
        self.violations.push(Violation {
            tick: self.tick,
            arm: ARM.to_owned(),
            limit,
            value,
            bound,
        });
    }
}

/// A bound on one side of a value.
struct Boundary {
    name: String,
    value: f64,
    bound: f64,
    /// 1 if the value must be at least the bound, -1 if at most.
    sign: f64,
    /// How much worse a value may get that was outside when the arm was enabled.
    recovery: f64,
}

impl Boundary {
    const fn at_least(name: String, value: f64, bound: f64, recovery: f64) -> Self {
        Self {
            name,
            value,
            bound,
            sign: 1.0,
            recovery,
        }
    }

    const fn at_most(name: String, value: f64, bound: f64, recovery: f64) -> Self {
        Self {
            name,
            value,
            bound,
            sign: -1.0,
            recovery,
        }
    }

    /// How far outside the first command of an enabled arm is, and may get.
    fn allowance(&self) -> f64 {
        let outside = self.sign * (self.bound - self.value);
        if outside > 0.0 {
            outside + self.recovery
        } else {
            0.0
        }
    }
}
