//! The fastest jerk-limited way to rest, in closed form. Hot path: bounded, no allocation, no I/O,
//! no lock.
//!
//! From velocity `v` and acceleration `a` an axis ramps its acceleration against the motion, may
//! hold it at the limit, and ramps it back to zero. The profile is the same as a time-optimal
//! generator's for a target velocity of zero, but shares no code with it.
//!
//! With `a_max` and `j` the limits, `v` and `a` taken towards the side of `v + a |a| / (2 j)`: the
//! acceleration goes to `-min(sqrt(j v + a^2 / 2), a_max)`, is held for
//! `(v + (a^2 - 2 a_max^2) / (2 j)) / a_max` if it got to `-a_max`, and returns to zero. With `a`
//! of the same sign as `v` the axis is faster before it is slower.

use super::motion::{AXES, Axes, AxisLimits, MotionState};
use super::snapshot::words;

/// A moment of a profile, after which the jerk is constant.
///
/// Jerk holds from here to the next knot; of the last one it is zero, as are velocity and
/// acceleration.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Knot {
    time_s: f64,
    position: f64,
    velocity: f64,
    acceleration: f64,
    jerk: f64,
}

words!(Knot {
    time_s: f64,
    position: f64,
    velocity: f64,
    acceleration: f64,
    jerk: f64,
});

impl Knot {
    /// Position, velocity and acceleration at `time_s` of the profile, by the cubic of this phase.
    fn after(&self, time_s: f64) -> (f64, f64, f64) {
        let t = time_s - self.time_s;
        let acceleration = self.acceleration + self.jerk * t;
        let velocity = self.velocity + t * (self.acceleration + self.jerk * t / 2.0);
        let position = self.position
            + t * (self.velocity + t * (self.acceleration / 2.0 + self.jerk * t / 6.0));
        (position, velocity, acceleration)
    }
}

/// One axis on its way to rest: three phases of constant jerk, then rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisStop {
    knots: [Knot; 4],
}

words!(AxisStop { knots: [Knot; 4] });

impl AxisStop {
    /// The stop from position, velocity and acceleration under `limits`.
    ///
    /// Position and velocity limits do not enter: whether the stop keeps them is for the caller to
    /// check. An acceleration above its limit is brought down with the full jerk.
    #[must_use]
    pub fn new(position: f64, velocity: f64, acceleration: f64, limits: &AxisLimits) -> Self {
        let (a_max, jerk) = (limits.acceleration, limits.jerk);
        // The velocity that remains once the acceleration has been brought to zero tells which way
        // to brake.
        let remaining = velocity + acceleration * acceleration.abs() / (2.0 * jerk);
        let side = if remaining < 0.0 { -1.0 } else { 1.0 };
        let (v, a) = (side * velocity, side * acceleration);
        let peak = (jerk * v + a * a / 2.0).max(0.0).sqrt().min(a_max);
        let hold_s = if peak < a_max {
            0.0
        } else {
            ((v + (a * a - 2.0 * a_max * a_max) / (2.0 * jerk)) / a_max).max(0.0)
        };
        let phases = [
            ((a + peak) / jerk, -jerk),
            (hold_s, 0.0),
            (peak / jerk, jerk),
        ];

        let mut knot = Knot {
            time_s: 0.0,
            position,
            velocity,
            acceleration,
            jerk: 0.0,
        };
        let mut knots = [knot; 4];
        for (slot, (duration_s, phase_jerk)) in knots.iter_mut().zip(phases) {
            knot.jerk = side * phase_jerk;
            *slot = knot;
            let time_s = knot.time_s + duration_s.max(0.0);
            (knot.position, knot.velocity, knot.acceleration) = knot.after(time_s);
            knot.time_s = time_s;
        }
        knots[3] = Knot {
            velocity: 0.0,
            acceleration: 0.0,
            jerk: 0.0,
            ..knot
        };
        Self { knots }
    }

    /// Seconds until rest.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.knots[3].time_s
    }

    /// Position, velocity and acceleration `time_s` into the stop.
    ///
    /// After the end it stays where it rests.
    #[must_use]
    pub fn at(&self, time_s: f64) -> (f64, f64, f64) {
        let knot = self
            .knots
            .iter()
            .rev()
            .find(|knot| knot.time_s <= time_s)
            .unwrap_or(&self.knots[0]);
        knot.after(time_s)
    }

    /// What remains of the stop `time_s` into it.
    #[must_use]
    pub fn remainder(&self, time_s: f64) -> Remainder {
        let (position, velocity, acceleration) = self.at(time_s);
        let phases = core::array::from_fn(|phase| {
            let (from, to) = (&self.knots[phase], &self.knots[phase + 1]);
            Phase {
                duration_s: to.time_s - from.time_s.max(time_s).min(to.time_s),
                jerk: from.jerk,
            }
        });
        Remainder {
            position,
            velocity,
            acceleration,
            phases,
        }
    }

    /// Lowest and highest position from here to rest, exactly.
    ///
    /// The extremes of the four knots and of the places where the velocity passes zero.
    #[must_use]
    pub fn position_range(&self) -> (f64, f64) {
        let mut low = self.knots[0].position;
        let mut high = low;
        let mut take = |position: f64| {
            low = low.min(position);
            high = high.max(position);
        };
        for (from, to) in self.knots.iter().zip(&self.knots[1..]) {
            take(to.position);
            for time_s in turning_times(from) {
                if time_s > from.time_s && time_s < to.time_s {
                    take(from.after(time_s).0);
                }
            }
        }
        (low, high)
    }

    /// Highest speed from here to rest, exactly.
    #[must_use]
    pub fn peak_velocity(&self) -> f64 {
        let mut peak = self
            .knots
            .iter()
            .fold(0.0_f64, |peak, knot| peak.max(knot.velocity.abs()));
        let first = &self.knots[0];
        if first.jerk.abs() > 0.0 {
            let time_s = -first.acceleration / first.jerk;
            if time_s > 0.0 && time_s < self.knots[1].time_s {
                peak = peak.max(first.after(time_s).1.abs());
            }
        }
        peak
    }

    /// Highest acceleration from here to rest, exactly.
    #[must_use]
    pub fn peak_acceleration(&self) -> f64 {
        self.knots
            .iter()
            .fold(0.0_f64, |peak, knot| peak.max(knot.acceleration.abs()))
    }
}

/// A span of constant jerk.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Phase {
    /// How long it lasts, s; not negative.
    pub duration_s: f64,
    /// Jerk, rad/s³ (m/s³).
    pub jerk: f64,
}

/// The rest of one axis's stop: where it is, and three phases of constant jerk, after which it
/// rests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Remainder {
    /// Position, rad (m).
    pub position: f64,
    /// Velocity, rad/s (m/s).
    pub velocity: f64,
    /// Acceleration, rad/s² (m/s²).
    pub acceleration: f64,
    /// What follows; phases that are over last no time.
    pub phases: [Phase; 3],
}

/// When the velocity of a phase passes zero; NaN where it does not.
fn turning_times(knot: &Knot) -> [f64; 2] {
    let (a, b, c) = (knot.jerk / 2.0, knot.acceleration, knot.velocity);
    if a.abs() < 1e-300 {
        return [knot.time_s - c / b, f64::NAN];
    }
    let root = (b * b - 4.0 * a * c).sqrt();
    [
        knot.time_s + (-b - root) / (2.0 * a),
        knot.time_s + (-b + root) / (2.0 * a),
    ]
}

/// All axes on their way to rest, each as fast as it can.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stop {
    axes: [AxisStop; AXES],
}

words!(Stop {
    axes: [AxisStop; AXES]
});

impl Stop {
    /// The stop from `state` under `limits`.
    #[must_use]
    pub fn new(state: &MotionState, limits: &[AxisLimits; AXES]) -> Self {
        let axes = core::array::from_fn(|axis| {
            AxisStop::new(
                state.position[axis],
                state.velocity[axis],
                state.acceleration[axis],
                &limits[axis],
            )
        });
        Self { axes }
    }

    /// The profiles of the axes.
    #[must_use]
    pub fn axes(&self) -> &[AxisStop; AXES] {
        &self.axes
    }

    /// The state `time_s` into the stop.
    #[must_use]
    pub fn at(&self, time_s: f64) -> MotionState {
        let zero: Axes = [0.0; AXES];
        let mut state = MotionState {
            position: zero,
            velocity: zero,
            acceleration: zero,
        };
        for (index, axis) in self.axes.iter().enumerate() {
            (
                state.position[index],
                state.velocity[index],
                state.acceleration[index],
            ) = axis.at(time_s);
        }
        state
    }

    /// Seconds until joints and jaw are at rest.
    #[must_use]
    pub fn duration_s(&self) -> f64 {
        self.axes
            .iter()
            .fold(0.0_f64, |longest, axis| longest.max(axis.duration_s()))
    }
}

#[cfg(test)]
mod tests;
