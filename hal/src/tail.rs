//! The safe tail: the rest of a stop, which travels with every command. Hot path: bounded, no
//! allocation, no I/O, no lock.
//!
//! With each setpoint the controller hands over a way from there to rest that it has checked
//! against every limit. Whoever gets no further command plays it, so that a dead, hung or cut-off
//! controller leaves a smooth stop and a held arm.
//!
//! A tail is the stop itself and not its first points: each axis is a start and three phases of
//! constant jerk. It is recomputed by a replay like everything else that a tick gives, so neither
//! the log nor the command hash holds it.

mod player;

use crate::{ArmCommand, JOINT_COUNT, JointVector, TimeNs};

pub use player::TailPlayer;

/// Axes of a tail: the joints in order, then the jaw.
pub const TAIL_AXES: usize = JOINT_COUNT + 1;

/// Phases of constant jerk in one axis's stop: brake, hold the brake, release it.
pub const TAIL_PHASES: usize = 3;

/// Where one axis is and how it moves.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisPoint {
    /// Position, rad (insertion m).
    pub position: f64,
    /// Velocity, rad/s (m/s).
    pub velocity: f64,
    /// Acceleration, rad/s² (m/s²).
    pub acceleration: f64,
}

impl AxisPoint {
    /// This point after `time_s` of constant `jerk`.
    fn after(&self, time_s: f64, jerk: f64) -> Self {
        let (v, a, t) = (self.velocity, self.acceleration, time_s);
        Self {
            position: self.position + t * (v + t * (a / 2.0 + t * jerk / 6.0)),
            velocity: v + t * (a + t * jerk / 2.0),
            acceleration: a + t * jerk,
        }
    }

    /// Whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.position.is_finite() && self.velocity.is_finite() && self.acceleration.is_finite()
    }
}

/// A span of constant jerk.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TailPhase {
    /// How long it lasts, s; what is below zero counts as zero.
    pub duration_s: f64,
    /// Jerk, rad/s³ (m/s³).
    pub jerk: f64,
}

/// One axis on its way to rest.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct AxisTail {
    /// Where it begins.
    pub start: AxisPoint,
    /// What follows, in order; then rest.
    pub phases: [TailPhase; TAIL_PHASES],
}

impl AxisTail {
    /// An axis that rests at `position`, rad (m).
    #[must_use]
    pub fn at_rest(position: f64) -> Self {
        Self {
            start: AxisPoint {
                position,
                ..AxisPoint::default()
            },
            phases: [TailPhase::default(); TAIL_PHASES],
        }
    }

    /// Seconds from the start to rest.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.phases
            .iter()
            .fold(0.0, |sum, phase| sum + phase.duration_s.max(0.0))
    }

    /// The point `time_s` after the start; from [`Self::duration_s`] on exactly at rest.
    #[must_use]
    pub fn at(&self, time_s: f64) -> AxisPoint {
        let time_s = time_s.max(0.0);
        let mut knot = self.start;
        let mut knot_s = 0.0;
        for phase in &self.phases {
            let duration_s = phase.duration_s.max(0.0);
            let end_s = knot_s + duration_s;
            if time_s < end_s {
                return knot.after(time_s - knot_s, phase.jerk);
            }
            knot = knot.after(duration_s, phase.jerk);
            knot_s = end_s;
        }
        AxisPoint {
            position: knot.position,
            ..AxisPoint::default()
        }
    }

    /// Where the last phase ends. A tail that has velocity or acceleration left there, rounding
    /// aside, is no stop.
    #[must_use]
    pub fn end(&self) -> AxisPoint {
        self.phases.iter().fold(self.start, |knot, phase| {
            knot.after(phase.duration_s.max(0.0), phase.jerk)
        })
    }

    /// What remains `time_s` after the start, as a tail of its own.
    #[must_use]
    pub fn remainder(&self, time_s: f64) -> Self {
        let mut left_s = time_s.max(0.0);
        let phases = self.phases.map(|phase| {
            let duration_s = phase.duration_s.max(0.0);
            let played_s = left_s.min(duration_s);
            left_s -= played_s;
            TailPhase {
                duration_s: duration_s - played_s,
                jerk: phase.jerk,
            }
        });
        Self {
            start: self.at(time_s),
            phases,
        }
    }

    /// Whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        let phases = &self.phases;
        self.start.is_finite()
            && phases
                .iter()
                .all(|phase| phase.duration_s.is_finite() && phase.jerk.is_finite())
    }
}

/// An arm on its way to rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SafeTail {
    /// When the stop starts: the stamp of the command that it travels with, or an earlier one if
    /// that command is on the way already.
    pub stamp: TimeNs,
    /// The joints in order, then the jaw.
    pub axes: [AxisTail; TAIL_AXES],
    /// Whether the drives hold torque, on the way and at rest. The tail of a disabled arm stays
    /// disabled.
    pub enabled: bool,
}

impl SafeTail {
    /// An arm that rests at `positions`, rad (insertion m), jaw last.
    #[must_use]
    pub fn at_rest(stamp: TimeNs, positions: &[f64; TAIL_AXES], enabled: bool) -> Self {
        Self {
            stamp,
            axes: positions.map(AxisTail::at_rest),
            enabled,
        }
    }

    /// An arm that rests where `command` puts it at once; a stop only for a command that does not
    /// move.
    #[must_use]
    pub fn hold(command: &ArmCommand) -> Self {
        let positions = core::array::from_fn(|axis| {
            if axis < JOINT_COUNT {
                command.position[axis]
            } else {
                command.jaw_position
            }
        });
        Self::at_rest(command.stamp, &positions, command.enabled)
    }

    /// The setpoint for `now`; before [`Self::stamp`] the first one, after the end at rest.
    #[must_use]
    pub fn command_at(&self, now: TimeNs) -> ArmCommand {
        let time_s = TimeNs(now.since(self.stamp)).seconds();
        let points = self.axes.map(|axis| axis.at(time_s));
        let joints =
            |number: fn(&AxisPoint) -> f64| JointVector::from_fn(|joint, _| number(&points[joint]));
        let jaw = &points[JOINT_COUNT];
        ArmCommand {
            stamp: now,
            position: joints(|point| point.position),
            velocity: joints(|point| point.velocity),
            acceleration: joints(|point| point.acceleration),
            jaw_position: jaw.position,
            jaw_velocity: jaw.velocity,
            enabled: self.enabled,
        }
    }

    /// Seconds from [`Self::stamp`] until the last axis rests.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.axes
            .iter()
            .fold(0.0, |longest, axis| axis.duration_s().max(longest))
    }

    /// The `count` setpoints that follow `now`, one every `period_ns`, for a bus or a drive that
    /// wants some ahead.
    pub fn points(
        &self,
        now: TimeNs,
        period_ns: u64,
        count: u64,
    ) -> impl Iterator<Item = ArmCommand> + '_ {
        (1..=count).map(move |index| {
            let ahead_ns = period_ns.saturating_mul(index);
            self.command_at(TimeNs(now.0.saturating_add(ahead_ns)))
        })
    }

    /// Whether every number is finite.
    #[must_use]
    pub fn is_finite(&self) -> bool {
        self.axes.iter().all(AxisTail::is_finite)
    }
}

#[cfg(test)]
mod tests;
