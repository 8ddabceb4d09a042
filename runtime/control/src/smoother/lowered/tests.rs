//! Lower limits in mid-motion: no jump, no overshoot.

mod range;

use super::super::Smoother;
use crate::config::ControlConfig;
use crate::motion::{AXES, Axes, AxisLimits, MotionState};
use hal::TICK_S;
use hal::random::SplitMix64;

/// Rounding allowed on a velocity, relative to the full limit.
const VELOCITY_TOLERANCE: f64 = 1e-11;

fn axes() -> [AxisLimits; AXES] {
    ControlConfig::load(
        &ControlConfig::default_control(),
        &ControlConfig::needle_lift_safety(),
    )
    .unwrap()
    .axes
}

/// The axes of the arm, with room enough that the range plays no part.
fn wide_axes() -> [AxisLimits; AXES] {
    axes().map(|limit| AxisLimits {
        low: -1e4,
        high: 1e4,
        ..limit
    })
}

fn at_rest() -> MotionState {
    MotionState {
        position: [0.1; AXES],
        velocity: [0.0; AXES],
        acceleration: [0.0; AXES],
    }
}

/// Some or all of velocity, acceleration and jerk lowered, each axis on its own.
fn lowered(built: &[AxisLimits; AXES], random: &mut SplitMix64) -> [AxisLimits; AXES] {
    built.map(|limit| {
        let kind = random.next_u64() % 8;
        let mut part = |bit: u64| match kind {
            7 => random.between(0.05, 1.0),
            _ if kind == bit || (kind > 2 && kind != bit + 3) => random.between(0.05, 1.0),
            _ => 1.0,
        };
        AxisLimits {
            velocity: limit.velocity * part(0),
            acceleration: limit.acceleration * part(1),
            jerk: limit.jerk * part(2),
            ..limit
        }
    })
}

fn random_target(built: &[AxisLimits; AXES], random: &mut SplitMix64) -> Axes {
    built.map(|limit| match random.next_u64() % 4 {
        0 => 0.0,
        1 => 20.0,
        2 => -20.0,
        _ => random.between(-limit.velocity, limit.velocity),
    })
}

/// Moves about for a while, so that the next thing to happen does so in mid-motion.
fn wander(smoother: &mut Smoother, state: &mut MotionState, random: &mut SplitMix64) {
    let built = wide_axes();
    for _ in 0..3 {
        let target = random_target(&built, random);
        for _ in 0..random.next_u64() % 120 {
            *state = smoother.step(state, &target).unwrap();
        }
    }
}

/// What one axis must do after its limits were lowered, on its way to a target that stays.
struct Watch {
    built: AxisLimits,
    limits: AxisLimits,
    target: f64,
    /// What the acceleration is brought to zero with: the full jerk where something was lowered,
    /// else the limit.
    ramp_jerk: f64,
    /// Where the velocity may be: between the start, the target, and where that jerk would have
    /// taken it.
    low: f64,
    high: f64,
}

impl Watch {
    fn new(
        built: &AxisLimits,
        before: &AxisLimits,
        limits: &AxisLimits,
        target: f64,
        (_, v, a): (f64, f64, f64),
    ) -> Self {
        let target = target.clamp(-limits.velocity, limits.velocity);
        let lower = limits.velocity < before.velocity
            || limits.acceleration < before.acceleration
            || limits.jerk < before.jerk;
        let ramp_jerk = if lower { built.jerk } else { limits.jerk };
        let carried = v + a * a.abs() / (2.0 * ramp_jerk);
        let tolerance = VELOCITY_TOLERANCE * built.velocity;
        Self {
            built: *built,
            limits: *limits,
            target,
            ramp_jerk,
            low: v.min(target).min(carried) - tolerance,
            high: v.max(target).max(carried) + tolerance,
        }
    }

    fn see(&self, (p, v, a): (f64, f64, f64), (p2, v2, a2): (f64, f64, f64), label: &str) {
        let (t, jerk) = (TICK_S, self.built.jerk * (1.0 + 1e-9));
        // No jump.
        assert!((a2 - a).abs() <= jerk * t, "{label}: {a} to {a2}");
        assert!((v2 - v - a * t).abs() <= jerk * t * t / 2.0, "{label}");
        let moved = (p2 - p - v * t - a * t * t / 2.0).abs();
        assert!(moved <= jerk * t * t * t / 6.0 + 1e-14, "{label}: {moved}");
        // The acceleration comes under its limit at the full jerk and stays there.
        let expected = (a.abs() - self.built.jerk * t).max(self.limits.acceleration);
        assert!(
            a2.abs() <= expected * (1.0 + 1e-9),
            "{label}: {a} to {a2}, not {expected}"
        );
        // A higher jerk than the limit only takes acceleration away.
        if a2 * a >= 0.0 && a2.abs() > a.abs() {
            let grown = a2.abs() - a.abs();
            let most = self.limits.jerk * (1.0 + 1e-6) * t;
            assert!(grown <= most + 1e-12, "{label}: {a} to {a2}");
        }
        // The velocity goes nowhere that it must not.
        assert!(
            v2 >= self.low && v2 <= self.high,
            "{label}: {v2} outside {} to {}",
            self.low,
            self.high
        );
        // As soon as the jerk keeps it from passing the target, it does not pass it, nor turn back
        // on the way.
        let tolerance = VELOCITY_TOLERANCE * self.built.velocity;
        let side = a.signum();
        if a * a / (2.0 * self.ramp_jerk) <= side * (self.target - v) + 1e-3 * tolerance {
            let (from, to) = (v.min(self.target), v.max(self.target));
            assert!(
                v2 >= from - tolerance && v2 <= to + tolerance,
                "{label}: {v} to {v2} on the way to {}",
                self.target
            );
        }
    }

    fn is_there(&self, v: f64, a: f64) -> bool {
        (v - self.target).abs() <= VELOCITY_TOLERANCE * self.built.velocity
            && a.abs() <= 1e-9 * self.built.acceleration
    }
}

fn axis_of(state: &MotionState, axis: usize) -> (f64, f64, f64) {
    (
        state.position[axis],
        state.velocity[axis],
        state.acceleration[axis],
    )
}

/// Velocity acceleration and jerk come down without an overshoot.
#[test]
fn lowered_limits_are_reached_without_overshoot() {
    let built = wide_axes();
    let mut random = SplitMix64::new(41);
    for round in 0..200 {
        let mut smoother = Smoother::new(&built, TICK_S);
        let mut state = at_rest();
        // The second change comes while the first is still being settled; it lowers some limits and
        // raises others.
        for again in 0..3 {
            if again != 1 {
                wander(&mut smoother, &mut state, &mut random);
            }
            let before = smoother.limits();
            let limits = lowered(&built, &mut random);
            smoother.set_limits(&limits);
            assert_eq!(smoother.limits(), limits);
            let target = random_target(&built, &mut random);
            let watches: [Watch; AXES] = core::array::from_fn(|i| {
                let now = axis_of(&state, i);
                Watch::new(&built[i], &before[i], &limits[i], target[i], now)
            });
            let ticks = if again == 0 {
                random.next_u64() % 60
            } else {
                60_000
            };
            let mut arrived = false;
            for tick in 0..ticks {
                let next = smoother.step(&state, &target).unwrap();
                for (axis, watch) in watches.iter().enumerate() {
                    let label = format!("round {round}.{again} tick {tick} axis {axis}");
                    watch.see(axis_of(&state, axis), axis_of(&next, axis), &label);
                }
                state = next;
                arrived = watches.iter().enumerate().all(|(axis, watch)| {
                    watch.is_there(state.velocity[axis], state.acceleration[axis])
                });
                if arrived {
                    break;
                }
            }
            assert!(arrived || again == 0, "round {round}: never arrives");
        }
    }
}

/// A state at full limits that does not fit the lower ones, as the guard's stop may leave it
/// behind.
fn outside(built: &AxisLimits, limits: &AxisLimits, random: &mut SplitMix64) -> (f64, f64, f64) {
    loop {
        let a = random.between(-built.acceleration, built.acceleration);
        let v = random.between(-built.velocity, built.velocity);
        let carried = v + a * a.abs() / (2.0 * built.jerk);
        let ends = a.signum() * v + a * a / (2.0 * limits.jerk);
        let unfit = a.abs() > limits.acceleration * 1.01 || ends > limits.velocity * 1.01;
        if unfit && carried.abs() <= built.velocity {
            return (0.1, v, a);
        }
    }
}

/// Motion that the guard left outside the lower limits settles too.
#[test]
fn motion_outside_lowered_limits_settles() {
    let built = wide_axes();
    let mut random = SplitMix64::new(45);
    for round in 0..400 {
        let mut smoother = Smoother::new(&built, TICK_S);
        let limits = built.map(|limit| AxisLimits {
            velocity: limit.velocity * random.between(0.2, 0.9),
            acceleration: limit.acceleration * random.between(0.2, 0.9),
            jerk: limit.jerk * random.between(0.2, 0.9),
            ..limit
        });
        smoother.set_limits(&limits);
        let mut state = smoother.step(&at_rest(), &[0.0; AXES]).unwrap();
        for axis in 0..AXES {
            let (_, v, a) = outside(&built[axis], &limits[axis], &mut random);
            (state.velocity[axis], state.acceleration[axis]) = (v, a);
        }
        let target = random_target(&built, &mut random);
        let watches: [Watch; AXES] = core::array::from_fn(|i| {
            let now = axis_of(&state, i);
            Watch::new(&built[i], &built[i], &limits[i], target[i], now)
        });
        for tick in 0..200 {
            let next = smoother.step(&state, &target).unwrap();
            for (axis, watch) in watches.iter().enumerate() {
                let label = format!("round {round} tick {tick} axis {axis}");
                watch.see(axis_of(&state, axis), axis_of(&next, axis), &label);
            }
            state = next;
        }
    }
}

#[test]
fn motion_that_fits_keeps_all_the_lower_limits() {
    let built = wide_axes();
    let mut random = SplitMix64::new(42);
    for round in 0..60 {
        let mut smoother = Smoother::new(&built, TICK_S);
        let limits = lowered(&built, &mut random);
        smoother.set_limits(&limits);
        let mut state = at_rest();
        for tick in 0..1_500 {
            let target = random_target(&built, &mut random);
            for _ in 0..random.next_u64() % 20 {
                let next = smoother.step(&state, &target).unwrap();
                for (axis, limit) in limits.iter().enumerate() {
                    let label = format!("round {round} tick {tick} axis {axis}");
                    let jerk = (next.acceleration[axis] - state.acceleration[axis]) / TICK_S;
                    assert!(jerk.abs() <= limit.jerk * (1.0 + 1e-9), "{label}: {jerk}");
                    let (_, v, a) = axis_of(&next, axis);
                    assert!(a.abs() <= limit.acceleration * (1.0 + 1e-9), "{label}");
                    assert!(v.abs() <= limit.velocity * (1.0 + 1e-9), "{label}");
                }
                state = next;
            }
        }
    }
}

#[test]
fn limits_stay_between_the_lowest_and_the_built() {
    let built = axes();
    let mut smoother = Smoother::new(&built, TICK_S);
    let all = |x: f64| {
        [AxisLimits {
            low: -9.0,
            high: 9.0,
            velocity: x,
            acceleration: x,
            jerk: x,
        }; AXES]
    };
    smoother.set_limits(&all(f64::INFINITY));
    assert_eq!(smoother.limits(), built);
    for low in [f64::NAN, -1.0, 0.0, f64::NEG_INFINITY] {
        smoother.set_limits(&all(low));
        for (limit, built) in smoother.limits().iter().zip(&built) {
            assert_eq!((limit.low, limit.high), (built.low, built.high));
            assert!(limit.velocity.abs() < 1e-300);
            assert!((limit.acceleration / built.acceleration - 1e-3).abs() < 1e-15);
            assert!((limit.jerk / built.jerk - 1e-3).abs() < 1e-15);
        }
        assert!(smoother.step(&at_rest(), &[1.0; AXES]).is_some());
    }
    smoother.set_limits(&built);
    assert_eq!(smoother.limits(), built);
}
