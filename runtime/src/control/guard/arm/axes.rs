//! What each axis must keep, in closed form. Hot path: bounded, no allocation, no I/O, no lock.

use super::ArmGuard;
#[cfg(test)]
use super::Check;
use crate::control::motion::MotionState;

/// Rounding allowed on limits, relative.
const ROUNDING: f64 = 1e-9;

/// Rounding allowed on the jerk of one tick, relative.
const JERK_ROUNDING: f64 = 1e-7;

/// Rounding allowed on a tick's motion, rad (m) and their derivatives.
const STEP_ROUNDING: f64 = 1e-12;

impl ArmGuard {
    /// Whether one tick of motion within the jerk limit leads from `current` to `candidate`. NaN is nowhere.
    pub(super) fn follows(&self, current: &MotionState, candidate: &MotionState) -> bool {
        let t = self.tick_s;
        self.axes.iter().enumerate().all(|(axis, limits)| {
            let (p, v, a) = (
                current.position[axis],
                current.velocity[axis],
                current.acceleration[axis],
            );
            let jerk = limits.jerk * (1.0 + JERK_ROUNDING);
            let a_off = candidate.acceleration[axis] - a;
            let v_off = candidate.velocity[axis] - v - a * t;
            let p_off = candidate.position[axis] - p - v * t - a * t * t / 2.0;
            let a_follows = a_off.abs() <= jerk * t + STEP_ROUNDING;
            let v_follows = v_off.abs() <= jerk * t * t / 2.0 + STEP_ROUNDING;
            let p_follows = p_off.abs() <= jerk * t * t * t / 6.0 + STEP_ROUNDING;
            #[cfg(test)]
            let (a_follows, v_follows, p_follows) = (
                self.judge(Check::AccelerationStep(axis), a_follows),
                self.judge(Check::VelocityStep(axis), v_follows),
                self.judge(Check::PositionStep(axis), p_follows),
            );
            a_follows && v_follows && p_follows
        })
    }

    /// Whether every axis keeps its limits from the first moment of the candidate's stop to rest.
    pub(super) fn axes_keep(&self) -> bool {
        let path = &self.fresh;
        self.axes.iter().enumerate().all(|(axis, limits)| {
            let stop = &path.stop.axes()[axis];
            let ((low, high), (least, most)) = (self.ranges[axis], path.ranges[axis]);
            let (above, below) = (least >= low, most <= high);
            let slow = stop.peak_velocity() <= limits.velocity * (1.0 + ROUNDING);
            let gentle = stop.peak_acceleration() <= limits.acceleration * (1.0 + ROUNDING);
            #[cfg(test)]
            let (above, below, slow, gentle) = (
                self.judge(Check::RangeLow(axis), above),
                self.judge(Check::RangeHigh(axis), below),
                self.judge(Check::Velocity(axis), slow),
                self.judge(Check::Acceleration(axis), gentle),
            );
            above && below && slow && gentle
        })
    }
}
