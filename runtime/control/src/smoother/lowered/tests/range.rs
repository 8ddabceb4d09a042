//! Lower limits in mid-motion: no excursion out of the joint range.

use super::{TICK_S, at_rest, axes, axis_of, lowered, random_target};
use crate::motion::{AXES, Axes, AxisLimits, MotionState};
use crate::smoother::Smoother;
use crate::stop::AxisStop;
use hal::random::SplitMix64;

/// A target that is wild, but zero where the full-limit stop after one more tick towards it would
/// leave the range.
fn shielded(
    full: &mut Smoother,
    state: &MotionState,
    wild: &Axes,
    built: &[AxisLimits; AXES],
) -> Axes {
    let next = full.step(state, wild).unwrap();
    core::array::from_fn(|axis| {
        let (p, v, a) = axis_of(&next, axis);
        let (low, high) = AxisStop::new(p, v, a, &built[axis]).position_range();
        if low < built[axis].low || high > built[axis].high {
            0.0
        } else {
            wild[axis]
        }
    })
}

/// Ticks on which an axis was out of its range, and by how much at most, on the same targets.
fn excursion(lower: bool, shield: bool, seed: u64) -> (u32, f64) {
    let built = axes();
    let mut random = SplitMix64::new(seed);
    let mut full = Smoother::new(&built, TICK_S);
    let (mut count, mut furthest) = (0, 0.0_f64);
    for _ in 0..60 {
        let mut smoother = Smoother::new(&built, TICK_S);
        let mut state = at_rest();
        state.position = built.map(|limit| random.between(limit.low, limit.high));
        for _ in 0..30 {
            let wild = random_target(&built, &mut random);
            let limits = lowered(&built, &mut random);
            let lower_at = random.next_u64() % 100;
            for tick in 0..random.next_u64() % 200 {
                if lower && tick == lower_at {
                    smoother.set_limits(&limits);
                }
                let target = if shield {
                    shielded(&mut full, &state, &wild, &built)
                } else {
                    wild
                };
                state = smoother.step(&state, &target).unwrap();
                for (p, limit) in state.position.iter().zip(&built) {
                    let beyond = (limit.low - p).max(p - limit.high);
                    if beyond > 0.0 {
                        count += 1;
                        furthest = furthest.max(beyond);
                    }
                }
            }
        }
    }
    (count, furthest)
}

#[test]
fn lower_limits_make_no_excursion_that_full_limits_do_not() {
    let (count, _) = excursion(false, false, 43);
    assert!(
        count > 0,
        "targets that never lead out of the range show nothing"
    );
    let (count, furthest) = excursion(false, true, 43);
    assert_eq!(count, 0, "full limits: {furthest:e}");
    let (count, furthest) = excursion(true, true, 43);
    assert_eq!(count, 0, "lowered limits: {furthest:e}");
}

#[test]
fn lowered_axes_can_always_stop_in_range_whatever_the_target() {
    let built = axes();
    let mut random = SplitMix64::new(44);
    for round in 0..60 {
        let mut smoother = Smoother::new(&built, TICK_S);
        let mut state = at_rest();
        state.position = built.map(|limit| random.between(limit.low, limit.high));
        for _ in 0..20 {
            // All accelerations stay lowered, so that the range is kept without the targets' help.
            let limits = lowered(&built, &mut random).map(|limit| AxisLimits {
                acceleration: limit.acceleration * 0.9,
                ..limit
            });
            smoother.set_limits(&limits);
            let target = random_target(&built, &mut random);
            for tick in 0..random.next_u64() % 300 {
                let next = smoother.step(&state, &target).unwrap();
                for (axis, limit) in built.iter().enumerate() {
                    let (p, v, a) = axis_of(&next, axis);
                    // The guard allows a stop no rounding either.
                    let (low, high) = AxisStop::new(p, v, a, limit).position_range();
                    assert!(
                        low >= limit.low && high <= limit.high,
                        "round {round} tick {tick} axis {axis}: {low} to {high}"
                    );
                    assert!(v.abs() <= limit.velocity * (1.0 + 1e-9));
                    assert!(a.abs() <= limit.acceleration * (1.0 + 1e-9));
                    let jerk = (a - state.acceleration[axis]).abs() / TICK_S;
                    assert!(jerk <= limit.jerk * (1.0 + 1e-6), "axis {axis}: {jerk}");
                }
                state = next;
            }
        }
    }
}

#[test]
fn an_axis_beyond_its_range_gets_no_further_and_comes_back() {
    let built = axes();
    let mut smoother = Smoother::new(&built, TICK_S);
    smoother.set_limits(&built.map(|limit| AxisLimits {
        acceleration: limit.acceleration / 2.0,
        jerk: limit.jerk / 2.0,
        ..limit
    }));
    let mut state = at_rest();
    state.position = built.map(|limit| limit.high + 0.01);
    let start = state;
    for _ in 0..100 {
        state = smoother.step(&state, &[1.0; AXES]).unwrap();
        assert_eq!(state, start);
    }
    for _ in 0..2_000 {
        state = smoother.step(&state, &[-0.05; AXES]).unwrap();
    }
    for (axis, limit) in built.iter().enumerate() {
        assert!(state.position[axis] < limit.high, "axis {axis}");
    }
}
