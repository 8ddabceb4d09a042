//! Facts about the rows.

use super::{ARMS_MAX, GEOMETRY_MAX, RowInput, Rows, dot};
use crate::Deviation;
use crate::active_set::VARIABLES_MAX;
use crate::config::ControlConfig;
use crate::instrument::KinematicState;
use crate::motion::{AXES, MotionState};
use hal::config::Source;
use hal::random::SplitMix64;

/// Two arms whose workspaces overlap, and a region of every shape.
pub(crate) const TWO_ARMS: &str = include_str!("two_arms.toml");

pub(crate) fn two_arms() -> ControlConfig {
    ControlConfig::load(
        &ControlConfig::default_control(),
        &Source::embedded("two_arms.toml", TWO_ARMS),
    )
    .unwrap()
}

pub(crate) fn random_state(random: &mut SplitMix64, config: &ControlConfig) -> MotionState {
    let position = core::array::from_fn(|axis| {
        random.between(config.axes[axis].low - 0.01, config.axes[axis].high + 0.01)
    });
    let velocity = core::array::from_fn(|axis| {
        random.between(-config.axes[axis].velocity, config.axes[axis].velocity)
    });
    MotionState {
        position,
        velocity,
        acceleration: [0.0; AXES],
    }
}

pub(crate) fn fill(
    rows: &mut Rows,
    config: &ControlConfig,
    states: &[MotionState],
) -> Vec<KinematicState> {
    let stances: Vec<KinematicState> = states.iter().map(KinematicState::new).collect();
    let inputs: Vec<RowInput<'_>> = states
        .iter()
        .zip(&stances)
        .map(|(state, stance)| RowInput {
            state,
            stance,
            moves: true,
            jaw_effort_n_m: 0.0,
            pace: 1.0,
            deviation: Deviation::default(),
        })
        .collect();
    rows.fill(config, &inputs);
    stances
}

#[test]
fn zero_velocity_satisfies_every_row_everywhere() {
    let config = two_arms();
    let mut random = SplitMix64::new(21);
    let mut rows = Rows::new(&config);
    let memory = rows.geometry.as_ptr();
    for case in 0..20_000 {
        let states = [(); 2].map(|()| random_state(&mut random, &config));
        fill(&mut rows, &config, &states);
        assert!(
            rows.hold(&[0.0; VARIABLES_MAX], 0.0),
            "case {case}: {states:?}"
        );
    }
    assert!(rows.geometry.len() <= GEOMETRY_MAX && rows.cones.len() == 2 * ARMS_MAX);
    assert_eq!(memory, rows.geometry.as_ptr(), "filling took memory");
}

#[test]
fn every_geometry_row_is_the_rate_of_its_distance() {
    // With alpha 1 and no margin the bound is the distance itself, while it is positive.
    let mut config = two_arms();
    config.filter.alpha_1_s = 1.0;
    config.margins.filter_m = 0.0;
    let mut random = SplitMix64::new(22);
    let step = 1e-7;
    let (mut before, mut after) = (Rows::new(&config), Rows::new(&config));
    fill(&mut before, &config, &[MotionState::ZERO; 2]);
    let mut compared = vec![0_u32; before.geometry.len()];
    for _ in 0..3_000 {
        let mut states = [(); 2].map(|()| random_state(&mut random, &config));
        fill(&mut before, &config, &states);
        let mut velocity = [0.0; VARIABLES_MAX];
        for (arm, state) in states.iter_mut().enumerate() {
            for axis in 0..AXES {
                let speed = random.between(-1.0, 1.0);
                velocity[AXES * arm + axis] = speed;
                state.position[axis] += step * speed;
            }
        }
        fill(&mut after, &config, &states);
        let rows = before.geometry.iter().zip(&after.geometry);
        for (index, (here, there)) in rows.enumerate() {
            if here.bound > 1e-3 && here.bound < 0.3 {
                let rate = (there.bound - here.bound) / step;
                let predicted = -dot(&here.coefficients, &velocity);
                assert!(
                    (rate - predicted).abs() < 1e-3,
                    "row {index}: {rate} {predicted}"
                );
                compared[index] += 1;
            }
        }
    }
    for (index, count) in compared.iter().enumerate() {
        assert!(*count > 20, "row {index} was compared {count} times");
    }
}

/// A slower pace lowers every speed and an arm at rest has none.
#[test]
fn slower_pace_lowers_every_speed() {
    let config = two_arms();
    let mut random = SplitMix64::new(23);
    let states = [(); 2].map(|()| MotionState {
        velocity: [0.0; AXES],
        ..random_state(&mut random, &config)
    });
    let stances = states.each_ref().map(KinematicState::new);
    let input = |arm: usize, moves: bool, pace: f64| RowInput {
        state: &states[arm],
        stance: &stances[arm],
        moves,
        jaw_effort_n_m: 0.0,
        pace,
        deviation: Deviation::default(),
    };
    let mut rows = Rows::new(&config);
    rows.fill(&config, &[input(0, true, 0.25), input(1, false, 1.0)]);
    for axis in 0..AXES {
        let limit = 0.25 * config.axes[axis].velocity;
        assert!(rows.high[axis] <= limit && rows.low[axis] >= -limit);
        assert_eq!((rows.low[AXES + axis], rows.high[AXES + axis]), (0.0, 0.0));
    }
    let tip = 0.25 * config.filter.speed_fraction * config.tip_speed_m_s;
    assert!((rows.cones[0].limit - tip).abs() < 1e-15);
}
