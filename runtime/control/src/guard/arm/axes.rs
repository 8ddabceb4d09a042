//! What each axis must keep, in closed form. Hot path: bounded, no allocation, no I/O, no lock.
//!
//! The step is checked by what a jerk `|j| <= J` can do in a tick `T`. In units of `J T`, `J T^2`
//! and `J T^3` the changes of acceleration, velocity and position are the integrals `x` of `u(s)`,
//! `y` of `(1 - s) u(s)` and `z` of `(1 - s)^2 u(s) / 2` over `s` from 0 to 1, for some `|u| <= 1`.
//! Given `x`, `y` has exact bounds; given both, `z` has.

use super::ArmGuard;
#[cfg(test)]
use super::Check;
use crate::motion::MotionState;

/// Rounding allowed on limits, relative.
const ROUNDING: f64 = 1e-9;

/// Rounding allowed on the jerk of one tick, relative.
const JERK_ROUNDING: f64 = 1e-7;

/// Rounding allowed on a tick's motion, rad (m) and their derivatives.
const STEP_ROUNDING: f64 = 1e-12;

/// A share of a tick that is none.
const SHORTEST: f64 = 1e-9;

impl ArmGuard {
    /// Whether one tick of motion within the jerk limit leads from `current` to `candidate`. NaN is
    /// nowhere.
    pub(super) fn follows(&self, current: &MotionState, candidate: &MotionState) -> bool {
        let t = self.tick_s;
        self.axes.iter().enumerate().all(|(axis, limits)| {
            let (p, v, a) = (
                current.position[axis],
                current.velocity[axis],
                current.acceleration[axis],
            );
            let jerk = limits.jerk * (1.0 + JERK_ROUNDING);
            // What jerk would have to do, in units of what the highest one does in a tick, and
            // rounding in the same units.
            let units = [jerk * t, jerk * t * t, jerk * t * t * t];
            let [x, y, z] = [
                (candidate.acceleration[axis] - a) / units[0],
                (candidate.velocity[axis] - v - a * t) / units[1],
                (candidate.position[axis] - p - v * t - a * t * t / 2.0) / units[2],
            ];
            let [x_off, y_off, z_off] = units.map(|unit| STEP_ROUNDING / unit);
            // Between the two states as well, acceleration and velocity are within their limits on
            // the whole.
            let gentle = limits.acceleration * t * (1.0 + ROUNDING) + STEP_ROUNDING;
            let slow = limits.velocity * t * (1.0 + ROUNDING) + STEP_ROUNDING;
            let a_follows = x.abs() <= 1.0 + x_off;
            let v_follows = y <= highest_velocity(x) + y_off
                && -y <= highest_velocity(-x) + y_off
                && (candidate.velocity[axis] - v).abs() <= gentle;
            let p_follows = z <= highest_position(x, y) + z_off
                && -z <= highest_position(-x, -y) + z_off
                && (candidate.position[axis] - p).abs() <= slow;
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

/// How far a jerk `u` between -1 and 1 over a time of 1 can raise the velocity if it changes the
/// acceleration by `x`: by being high first and low then.
fn highest_velocity(x: f64) -> f64 {
    let high = (1.0 + x.clamp(-1.0, 1.0)) / 2.0;
    high * (2.0 - high) - 0.5
}

/// How far it can then raise the position if it changes the velocity by `y` as well: by being low
/// for one span `from..to` and high before and after, since what jerk does to the position, `(1 -
/// s)^2 / 2`, is convex in the time `s` when it acts.
fn highest_position(x: f64, y: f64) -> f64 {
    let low = (1.0 - x.clamp(-1.0, 1.0)) / 2.0;
    if low < SHORTEST {
        return 1.0 / 6.0;
    }
    let middle = 1.0 - (0.5 - y) / (2.0 * low);
    let cubed = |s: f64| (1.0 - s) * (1.0 - s) * (1.0 - s);
    let (from, to) = (middle - low / 2.0, middle + low / 2.0);
    (0.5 - cubed(from) + cubed(to)) / 3.0
}

#[cfg(test)]
mod tests {
    use super::{highest_position, highest_velocity};
    use hal::random::SplitMix64;

    /// What a jerk of `pieces` equal spans does to acceleration, velocity and position in a time of 1.
    fn effect(pieces: &[f64]) -> [f64; 3] {
        let mut state = [0.0; 3];
        #[expect(clippy::cast_precision_loss, reason = "a few pieces")]
        let t = 1.0 / pieces.len() as f64;
        for jerk in pieces {
            let [a, v, p] = state;
            state = [
                a + jerk * t,
                v + a * t + jerk * t * t / 2.0,
                p + v * t + a * t * t / 2.0 + jerk * t * t * t / 6.0,
            ];
        }
        state
    }

    #[test]
    fn whatever_jerk_does_is_within_the_bounds() {
        let mut random = SplitMix64::new(91);
        let mut nearest = [f64::INFINITY; 2];
        for case in 0..200_000 {
            let extreme = case % 2 == 0;
            let (switch, other) = (random.between(0.0, 40.0), random.between(0.0, 40.0));
            let mut index = 0.0;
            let pieces = [(); 40].map(|()| {
                index += 1.0;
                if extreme {
                    if (index < switch) == (index < other) {
                        1.0
                    } else {
                        -1.0
                    }
                } else {
                    random.between(-1.0, 1.0)
                }
            });
            let [x, y, z] = effect(&pieces);
            for sign in [1.0, -1.0] {
                let (x, y, z) = (sign * x, sign * y, sign * z);
                let room = [highest_velocity(x) - y, highest_position(x, y) - z];
                assert!(
                    room.iter().all(|room| *room > -1e-12),
                    "{x} {y} {z}: {room:?}"
                );
                nearest = [nearest[0].min(room[0]), nearest[1].min(room[1])];
            }
        }
        assert!(nearest.iter().all(|room| *room < 1e-9), "{nearest:?}");
    }

    #[test]
    fn opposite_signs_are_more_than_jerk_can_do() {
        // Full jerk against the acceleration, and as much velocity as full jerk for it would give.
        assert!(0.5 > highest_velocity(-1.0) + 0.9);
        // No change of acceleration and velocity, and a position as if there were.
        assert!(1.0 / 6.0 > highest_position(0.0, 0.0) + 0.1);
    }
}
