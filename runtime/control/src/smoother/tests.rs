//! The smoother at full limits.

use super::Smoother;
use crate::config::ControlConfig;
use crate::motion::{AXES, AxisLimits, MotionState};
use crate::stop::Stop;
use hal::TICK_S;
use hal::random::SplitMix64;

fn at_rest() -> MotionState {
    MotionState {
        position: [0.1; AXES],
        velocity: [0.0; AXES],
        acceleration: [0.0; AXES],
    }
}

fn config() -> ControlConfig {
    ControlConfig::load(
        &ControlConfig::default_control(),
        &ControlConfig::needle_lift_safety(),
    )
    .unwrap()
}

#[test]
fn random_targets_never_break_velocity_acceleration_or_jerk() {
    let axes = config().axes;
    let mut smoother = Smoother::new(&axes, TICK_S);
    let mut random = SplitMix64::new(5);
    let mut state = at_rest();
    let mut target = [0.0; AXES];
    for tick in 0..20_000 {
        if random.happens(0.2) {
            target = core::array::from_fn(|_| random.between(-20.0, 20.0));
        }
        let next = smoother.step(&state, &target).unwrap();
        for (axis, limit) in axes.iter().enumerate() {
            assert!(
                next.velocity[axis].abs() <= limit.velocity * (1.0 + 1e-9),
                "tick {tick} axis {axis}"
            );
            assert!(
                next.acceleration[axis].abs() <= limit.acceleration * (1.0 + 1e-9),
                "tick {tick} axis {axis}"
            );
            let jerk = (next.acceleration[axis] - state.acceleration[axis]) / TICK_S;
            assert!(
                jerk.abs() <= limit.jerk * (1.0 + 1e-6),
                "tick {tick} axis {axis}: {jerk}"
            );
        }
        state = next;
    }
}

#[test]
fn its_stop_is_the_closed_form_stop() {
    let axes = config().axes;
    let mut smoother = Smoother::new(&axes, TICK_S);
    let mut random = SplitMix64::new(6);
    let mut state = at_rest();
    for round in 0..100 {
        let target = core::array::from_fn(|_| random.between(-1.0, 1.0));
        for _ in 0..(random.next_u64() % 100) {
            state = smoother.step(&state, &target).unwrap();
        }
        let stop = Stop::new(&state, &axes);
        let mut time_s = 0.0;
        while time_s < 0.4 {
            state = smoother.step(&state, &[0.0; AXES]).unwrap();
            time_s += TICK_S;
            let expected = stop.at(time_s);
            for axis in 0..AXES {
                let off = (state.position[axis] - expected.position[axis]).abs();
                assert!(off < 1e-9, "round {round} axis {axis} at {time_s}: {off:e}");
            }
        }
    }
}

#[test]
fn nonsense_gives_no_step() {
    let mut smoother = Smoother::new(&config().axes, TICK_S);
    assert!(smoother.step(&at_rest(), &[f64::NAN; AXES]).is_none());
    let mut broken = at_rest();
    broken.velocity[3] = f64::INFINITY;
    assert!(smoother.step(&broken, &[0.0; AXES]).is_none());
}

/// Any state from which the full jerk keeps velocity and acceleration within the limits.
fn any_state(limits: &[AxisLimits; AXES], random: &mut SplitMix64) -> MotionState {
    let mut state = at_rest();
    for (axis, limit) in limits.iter().enumerate() {
        let part = random.between(-1.0, 1.0);
        let a = part * limit.acceleration;
        let carried = a * a.abs() / (2.0 * limit.jerk);
        let (low, high) = (
            -limit.velocity - carried.min(0.0),
            limit.velocity - carried.max(0.0),
        );
        state.position[axis] = random.between(limit.low, limit.high);
        state.velocity[axis] = random.between(low, high);
        state.acceleration[axis] = a;
    }
    state
}

#[test]
fn any_target_velocity_is_reached_from_any_state_and_held() {
    let axes = config().axes;
    let mut smoother = Smoother::new(&axes, TICK_S);
    let mut random = SplitMix64::new(7);
    for round in 0..400 {
        let mut state = any_state(&axes, &mut random);
        let rest = round % 2 == 0;
        let target = axes.map(|limit| {
            if rest {
                0.0
            } else {
                random.between(-limit.velocity, limit.velocity)
            }
        });
        // Twice the highest speed at the highest acceleration, and two ramps, are 0.6 s at most;
        // then it stays.
        for tick in 0..800 {
            state = smoother.step(&state, &target).unwrap();
            for axis in 0..AXES {
                if tick < 600 {
                    continue;
                }
                let off = (state.velocity[axis] - target[axis]).abs();
                let bound = 1e-14 * axes[axis].velocity;
                assert!(off <= bound, "round {round} axis {axis}: {off:e}");
                let a = state.acceleration[axis].abs();
                assert!(
                    a <= 1e-14 * axes[axis].acceleration,
                    "round {round} axis {axis}: {a:e}"
                );
            }
        }
    }
}

#[test]
fn rest_stays_rest_bit_for_bit() {
    let axes = config().axes;
    let mut random = SplitMix64::new(8);
    for round in 0..200 {
        let mut smoother = Smoother::new(&axes, TICK_S);
        if round % 2 == 1 {
            smoother.set_limits(&axes.map(|limit| AxisLimits {
                velocity: limit.velocity * random.between(0.0, 1.0),
                acceleration: limit.acceleration * random.between(0.1, 1.0),
                jerk: limit.jerk * random.between(0.1, 1.0),
                ..limit
            }));
        }
        let mut state = at_rest();
        state.position = axes.map(|limit| random.between(limit.low, limit.high));
        let bits = state.position.map(f64::to_bits);
        for _ in 0..100 {
            state = smoother.step(&state, &[0.0; AXES]).unwrap();
            assert_eq!(state.position.map(f64::to_bits), bits);
            assert_eq!(state.velocity.map(f64::to_bits), [0; AXES]);
            assert_eq!(state.acceleration.map(f64::to_bits), [0; AXES]);
        }
    }
}

#[test]
fn a_target_very_near_the_state_gives_a_step() {
    let axes = config().axes;
    let mut smoother = Smoother::new(&axes, TICK_S);
    let mut random = SplitMix64::new(9);
    for round in 0..20_000 {
        let start = any_state(&axes, &mut random);
        // From any state, and from a steady motion.
        let state = MotionState {
            acceleration: if round % 2 == 0 {
                start.acceleration
            } else {
                [0.0; AXES]
            },
            ..start
        };
        let near = 10.0_f64.powf(random.between(-12.0, -6.0));
        let target = state.velocity.map(|v| v + random.between(-near, near));
        let next = smoother.step(&state, &target).unwrap();
        for (axis, limit) in axes.iter().enumerate() {
            let change = (next.velocity[axis] - state.velocity[axis]).abs();
            let most = limit.acceleration * TICK_S;
            assert!(change <= most, "round {round} axis {axis}: {change:e}");
        }
    }
}
