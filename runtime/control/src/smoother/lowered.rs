//! Lower limits for one axis in mid-motion. Hot path: bounded, no allocation, no I/O, no lock.
//!
//! Ruckig alone, given lower limits while it moves, brings the acceleration down with the lower
//! jerk: it then passes the speed limit or the target, and needs a longer way to stop than there
//! may be. So the full jerk stays until the motion fits.

use super::super::motion::{AxisLimits, MotionState};
use super::super::snapshot::{Reader, Snapshot, SnapshotError, Stateful, Words, layout, possible};
use super::super::stop::AxisStop;

/// Acceleration and jerk are lowered no further than to this part.
const LEAST: f64 = 1e-3;

/// Rounding allowed on an acceleration that is held at its limit, relative.
const ACCELERATION_ROUNDING: f64 = 1e-9;

/// Rounding allowed on a velocity that ramps to its limit, relative to the full one.
const VELOCITY_ROUNDING: f64 = 1e-12;

/// The limits of one axis as built and as lowered.
#[derive(Clone, Copy, Debug)]
pub(super) struct AxisLowering {
    built: AxisLimits,
    limits: AxisLimits,
    /// Limits have been lowered, or the axis was found outside them, and the motion does not fit
    /// them yet.
    settling: bool,
}

impl Stateful for AxisLowering {
    const LAYOUT: u64 = layout("AxisLowering velocity acceleration jerk settling", &[]);
    const WORDS_MAX: usize = 4;

    fn save(&self, to: &mut Snapshot) {
        let Self {
            built: _,
            limits,
            settling,
        } = self;
        let AxisLimits {
            low: _,
            high: _,
            velocity,
            acceleration,
            jerk,
        } = limits;
        (*velocity, (*acceleration, (*jerk, *settling))).put(to);
    }

    fn restore(&mut self, from: &mut Reader<'_>) -> Result<(), SnapshotError> {
        let (velocity, (acceleration, (jerk, settling))): (f64, (f64, (f64, bool))) =
            Words::take(from)?;
        let built = &self.built;
        possible((0.0..=built.velocity).contains(&velocity))?;
        for (limit, full) in [(acceleration, built.acceleration), (jerk, built.jerk)] {
            possible((LEAST * full..=full).contains(&limit))?;
        }
        *self = Self {
            built: *built,
            limits: AxisLimits {
                velocity,
                acceleration,
                jerk,
                ..*built
            },
            settling,
        };
        Ok(())
    }
}

impl AxisLowering {
    /// Full limits.
    pub(super) fn new(built: &AxisLimits) -> Self {
        Self {
            built: *built,
            limits: *built,
            settling: false,
        }
    }

    /// The limits that hold now.
    pub(super) fn limits(&self) -> &AxisLimits {
        &self.limits
    }

    /// Takes `limits` as far as they are between the lowest and the full ones.
    pub(super) fn set(&mut self, limits: &AxisLimits) {
        let before = self.limits;
        // `max` drops a NaN.
        let within = |limit: f64, least: f64, full: f64| limit.max(least * full).min(full);
        self.limits.velocity = within(limits.velocity, 0.0, self.built.velocity);
        self.limits.acceleration = within(limits.acceleration, LEAST, self.built.acceleration);
        self.limits.jerk = within(limits.jerk, LEAST, self.built.jerk);
        self.settling |= self.limits.velocity < before.velocity
            || self.limits.acceleration < before.acceleration
            || self.limits.jerk < before.jerk;
    }

    /// The jerk for the next tick towards `target`, which is within the velocity limit.
    ///
    /// It is the limit, unless the way on which it brings the acceleration to zero passes the speed
    /// limit, or starts above the acceleration limit, or, after the limits were lowered, passes the
    /// target. Then it is what just reaches the target, or the full jerk if that is not enough.
    pub(super) fn jerk(&mut self, velocity: f64, acceleration: f64, target: f64) -> f64 {
        let (limits, full) = (&self.limits, self.built.jerk);
        let push = acceleration.abs();
        let side = acceleration.signum();
        let rounding = VELOCITY_ROUNDING * self.built.velocity;
        let ramp = push * push / (2.0 * limits.jerk);
        if ramp <= rounding {
            self.settling = false;
            return limits.jerk;
        }
        // Seen in the direction of the acceleration, the velocity ends here once the acceleration
        // has been brought to zero.
        let end = side * velocity + ramp;
        let hard = push > limits.acceleration * (1.0 + ACCELERATION_ROUNDING);
        let fits = !hard && end <= limits.velocity + rounding;
        let passes = end > side * target + rounding;
        self.settling = (self.settling || !fits) && (hard || passes);
        if !self.settling {
            return limits.jerk;
        }
        let room = side * (target - velocity);
        if hard || room <= 0.0 {
            full
        } else {
            (push * push / (2.0 * room)).clamp(limits.jerk, full)
        }
    }

    /// Replaces `next` by one tick of the stop at full limits, if acceleration or jerk are lowered
    /// and the stop after `next` leaves the range, or leaves it further than the stop from `state`
    /// does.
    pub(super) fn keep_range(
        &self,
        axis: usize,
        state: &MotionState,
        next: &mut MotionState,
        tick_s: f64,
    ) {
        let built = &self.built;
        if self.limits.acceleration >= built.acceleration && self.limits.jerk >= built.jerk {
            return;
        }
        let stop = stop_of(axis, state, built);
        let (now_low, now_high) = stop.position_range();
        let (low, high) = stop_of(axis, next, built).position_range();
        let lowest = now_low.min(built.low);
        let highest = now_high.max(built.high);
        if low < lowest || high > highest {
            (
                next.position[axis],
                next.velocity[axis],
                next.acceleration[axis],
            ) = stop.at(tick_s);
        }
    }
}

/// The stop at full limits of one axis of `state`.
fn stop_of(axis: usize, state: &MotionState, built: &AxisLimits) -> AxisStop {
    let (p, v, a) = (
        state.position[axis],
        state.velocity[axis],
        state.acceleration[axis],
    );
    AxisStop::new(p, v, a, built)
}

#[cfg(test)]
mod tests;
