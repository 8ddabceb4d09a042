//! Checks one command after the other against the limits.

use core::fmt::Display;

use hal::{ArmCommand, ArmError, ArmState, JointVector, TICK_NS};
use nalgebra::Point3;

use super::Violation;
use super::boundary::{Boundary, boundaries};
use super::chain::instrument;
use super::differences::{AXES, History};
use super::limits::Limits;
use crate::log::LoggedTick;

/// What a value may exceed its bound by, in the bound's own unit and, for derivatives, as a fraction of it.
const TOLERANCE: f64 = 1e-6;

/// Speed below which an arm counts as resting, rad/s (m/s), and what the command of an arm without torque may be away from
/// the arm, rad (m): it is a copy.
const REST: f64 = 1e-9;

/// The arm whose commands a log holds.
const ARM: &str = "psm1";

const PERIOD_S: f64 = 1e-3;
const DERIVATIVES: [(usize, &str); 3] = [(1, "velocity"), (2, "acceleration"), (3, "jerk")];

/// What came before a command.
#[derive(Clone, Copy, Debug)]
enum Before {
    /// Nothing: the log begins, and a controller begins without torque.
    Beginning,
    /// Missing ticks, in which the drives may have been switched.
    Gap,
    /// Drives without torque, and where they were told to be.
    Limp([f64; AXES]),
    /// Drives with torque.
    Powered,
}

/// The state of the check between two commands.
pub(super) struct Checker<'a> {
    limits: &'a Limits,
    history: History,
    tip: Option<Point3<f64>>,
    stamp: Option<u64>,
    before: Before,
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
            before: Before::Beginning,
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
        let sample = axes(&command.position, command.jaw_position);
        if command.enabled {
            if let (Before::Beginning | Before::Limp(_), Ok(arm)) = (self.before, &logged.measured)
            {
                self.begin(arm);
            }
            self.powered(command);
            self.before = Before::Powered;
        } else {
            match self.before {
                // Torque goes when the arm rests: this last setpoint is still part of the motion.
                Before::Powered => self.powered(command),
                Before::Limp(held) => self.limp(&sample, &logged.measured, Some(held)),
                Before::Beginning => self.limp(&sample, &logged.measured, None),
                Before::Gap => {}
            }
            let velocity = axes(&command.velocity, command.jaw_velocity);
            self.all_near(&velocity, &[0.0; AXES], "disabled_velocity");
            self.forget();
            self.before = Before::Limp(sample);
        }
    }

    /// An arm gets its torque at rest, where it was measured: its motion begins there.
    fn begin(&mut self, arm: &ArmState) {
        self.forget();
        for _ in 0..3 {
            self.history.push(axes(&arm.position, arm.jaw_position));
        }
        self.tip = Some(instrument(&arm.position).control_point);
    }

    /// Without torque the command moves nothing: it follows the measured arm, and stays where it is if nothing is measured.
    fn limp(
        &mut self,
        sample: &[f64; AXES],
        measured: &Result<ArmState, ArmError>,
        held: Option<[f64; AXES]>,
    ) {
        let expected = match measured {
            Ok(arm) if arm.is_finite() => Some(axes(&arm.position, arm.jaw_position)),
            Ok(_) | Err(_) => held,
        };
        if let Some(expected) = expected {
            self.all_near(sample, &expected, "disabled_position");
        }
    }

    fn all_near(&mut self, values: &[f64; AXES], expected: &[f64; AXES], what: &str) {
        let limits = self.limits;
        for ((limit, value), expected) in limits.axes.iter().zip(values).zip(expected) {
            let name = format_args!("{}.{what}", limit.name);
            self.judge((value - expected).abs(), REST, name, *value, *expected);
        }
    }

    /// Checks a command that moves the arm.
    fn powered(&mut self, command: &ArmCommand) {
        let at = instrument(&command.position);
        let boundaries = boundaries(self.limits, command, &at);
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

    /// Forgets how the arm moved and what it was allowed.
    fn forget(&mut self) {
        self.history.clear();
        self.tip = None;
        self.allowances.clear();
    }

    /// Says that `count` ticks before this one are missing.
    pub(super) fn missing(&mut self, tick: u64, count: u64) {
        self.tick = tick;
        self.forget();
        self.stamp = None;
        self.before = Before::Gap;
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
        self.history
            .push(axes(&command.position, command.jaw_position));
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
        // The velocity that goes to the drives along with the position.
        let velocity = axes(&command.velocity, command.jaw_velocity);
        for (limit, said) in limits.axes.iter().zip(velocity) {
            let bound = limit.derivatives[0];
            let name = format_args!("{}.commanded_velocity", limit.name);
            self.judge(said.abs() - bound, TOLERANCE * bound, name, said, bound);
        }
    }

    /// Notes a violation unless `excess` is at most `tolerance`; NaN is one.
    fn judge(&mut self, excess: f64, tolerance: f64, limit: impl Display, value: f64, bound: f64) {
        let fine = excess <= tolerance;
        if !fine {
            self.report(limit, value, bound);
        }
    }

    /// Says that the commands are not the ones that the run reported.
    pub(super) fn other_hash(&mut self) {
        self.report("command_hash_mismatches", 1.0, 0.0);
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

/// Joints and jaw in one row.
fn axes(joints: &JointVector, jaw: f64) -> [f64; AXES] {
    let mut all = [jaw; AXES];
    for (value, &joint) in all.iter_mut().zip(joints.iter()) {
        *value = joint;
    }
    all
}
