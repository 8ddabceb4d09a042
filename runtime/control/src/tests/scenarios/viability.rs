//! Axes at their extremes: whatever an axis is asked for, it can still stop within its range.

use super::super::adversary::kinds::below;
use crate::Deviation;
use crate::instrument::KinematicState;
use crate::motion::{AXES, AxisLimits, MotionState};
use crate::rows::{RowInput, Rows};
use crate::smoother::Smoother;
use crate::stop::AxisStop;
use crate::tests::adversary::rig::Scene;
use hal::TICK_S;
use hal::random::SplitMix64;

/// Worst of many steps.
#[derive(Clone, Copy, Debug, Default)]
struct Excess {
    position: f64,
    velocity: f64,
    acceleration: f64,
    refused: u64,
}

impl Excess {
    fn look(&mut self, limits: &AxisLimits, (p, v, a): (f64, f64, f64)) {
        self.position = self.position.max(limits.low - p).max(p - limits.high);
        self.velocity = self.velocity.max(v.abs() / limits.velocity - 1.0);
        self.acceleration = self.acceleration.max(a.abs() / limits.acceleration - 1.0);
    }
}

/// Whether the stop from `state` stays within everything.
fn can_stop(limits: &AxisLimits, (p, v, a): (f64, f64, f64)) -> Option<AxisStop> {
    let stop = AxisStop::new(p, v, a, limits);
    let (low, high) = stop.position_range();
    (low >= limits.low
        && high <= limits.high
        && stop.peak_velocity() <= limits.velocity * (1.0 + 1e-9)
        && stop.peak_acceleration() <= limits.acceleration * (1.0 + 1e-9))
        .then_some(stop)
}

/// Always the highest jerk one way or the other, as long as a stop is left; otherwise the stop
/// itself.
fn extreme_jerks(limits: &AxisLimits, seed: u64, steps: u64) -> Excess {
    let mut random = SplitMix64::new(seed);
    let mut excess = Excess::default();
    let mut state = (f64::midpoint(limits.low, limits.high), 0.0, 0.0);
    let mut held = AxisStop::new(state.0, 0.0, 0.0, limits);
    let (mut played_s, mut way, mut patience) = (0.0, 1.0, 0_u64);
    for _ in 0..steps {
        if patience == 0 {
            way = if random.happens(0.5) { 1.0 } else { -1.0 };
            patience = 1 + random.next_u64() % [1, 5, 50, 2000][below(&mut random, 4)];
        }
        patience -= 1;
        let (p, v, a) = state;
        let t = TICK_S;
        let jerk = way * limits.jerk;
        let next = (
            p + t * (v + t * (a / 2.0 + t * jerk / 6.0)),
            v + t * (a + t * jerk / 2.0),
            a + t * jerk,
        );
        state = if let Some(stop) = can_stop(limits, next) {
            (held, played_s) = (stop, 0.0);
            next
        } else {
            excess.refused += 1;
            played_s += t;
            held.at(played_s)
        };
        excess.look(limits, state);
    }
    excess
}

/// Five million extreme jerks an axis keep every axis in its range.
#[test]
fn extreme_jerks_keep_every_axis_in_range() {
    let config = Scene::crowded().config;
    let steps = 5_000_000;
    for (axis, limits) in config.axes.iter().enumerate() {
        let excess = extreme_jerks(limits, 600 + axis as u64, steps);
        println!(
            "axis {axis}: {steps} extreme jerks, {} refused, beyond range {:.1e}, velocity {:.1e}, acceleration {:.1e}",
            excess.refused, excess.position, excess.velocity, excess.acceleration
        );
        assert!(excess.position <= 1e-6, "{excess:?}");
        assert!(
            excess.velocity <= 1e-6 && excess.acceleration <= 1e-6,
            "{excess:?}"
        );
        assert!(excess.refused > steps / 100, "{excess:?}");
    }
}

/// Velocities at the filter's bounds for each axis, through the smoother; gives the excesses and
/// how often no stop was left.
fn extreme_velocities(seed: u64, ticks: u64) -> [Excess; AXES] {
    let mut config = Scene::crowded().config;
    // Only the bounds of the axes are of interest.
    config.arms[0].forbidden.clear();
    let mut rows = Rows::new(&config);
    let mut random = SplitMix64::new(seed);
    let mut smoother = Smoother::new(&config.axes, TICK_S);
    let mut state = MotionState {
        position: config.axes.map(|axis| f64::midpoint(axis.low, axis.high)),
        ..MotionState::ZERO
    };
    let mut held: [(AxisStop, f64); AXES] = core::array::from_fn(|axis| {
        (
            AxisStop::new(state.position[axis], 0.0, 0.0, &config.axes[axis]),
            0.0,
        )
    });
    let mut high = [true; AXES];
    let mut excesses = [Excess::default(); AXES];
    for _ in 0..ticks {
        let input = RowInput {
            state: &state,
            stance: &KinematicState::new(&state),
            moves: true,
            jaw_effort_n_m: 0.0,
            pace: 1.0,
            deviation: Deviation::default(),
        };
        rows.fill(&config, &[input]);
        let wanted = core::array::from_fn(|axis| {
            let (lowest, highest) = (rows.low[axis], rows.high[axis]);
            assert!(
                lowest <= 0.0 && highest >= 0.0,
                "no interval: {lowest} {highest}"
            );
            if random.happens(0.003) {
                high[axis] = !high[axis];
            }
            if high[axis] { highest } else { lowest }
        });
        let next = smoother.step(&state, &wanted).unwrap();
        for axis in 0..AXES {
            let limits = &config.axes[axis];
            let moved = (
                next.position[axis],
                next.velocity[axis],
                next.acceleration[axis],
            );
            let (p, v, a) = if let Some(stop) = can_stop(limits, moved) {
                held[axis] = (stop, 0.0);
                moved
            } else {
                excesses[axis].refused += 1;
                held[axis].1 += TICK_S;
                held[axis].0.at(held[axis].1)
            };
            state.position[axis] = p;
            state.velocity[axis] = v;
            state.acceleration[axis] = a;
            excesses[axis].look(limits, (p, v, a));
        }
    }
    excesses
}

/// Five million steps at the filter's bounds keep every axis in its range.
#[test]
fn steps_at_the_bounds_keep_every_axis_in_range() {
    let ticks = 715_000;
    let excesses = extreme_velocities(701, ticks);
    for (axis, excess) in excesses.iter().enumerate() {
        println!(
            "axis {axis}: {ticks} ticks at the filter's bounds, stop played in {}, beyond range {:.1e}, velocity {:.1e}, acceleration {:.1e}",
            excess.refused, excess.position, excess.velocity, excess.acceleration
        );
        assert!(excess.position <= 1e-6, "{excess:?}");
        assert!(
            excess.velocity <= 1e-6 && excess.acceleration <= 1e-6,
            "{excess:?}"
        );
    }
}
