//! The guard alone: garbage in, no limit broken.

use super::clearance::CLEARANCES;
use super::{Guard, INTERVALS, Stop};
use crate::control::config::ControlConfig;
use crate::control::motion::{AXES, MotionState};
use crate::control::random::SplitMix64;
use crate::control::smoother::Smoother;
use crate::kinematics::Frames;

const TICK_S: f64 = 1e-3;

fn config() -> ControlConfig {
    ControlConfig::load(
        &ControlConfig::default_control(),
        &ControlConfig::needle_lift_safety(),
    )
    .unwrap()
}

fn home() -> MotionState {
    let position = [0.0, 0.0, hal::psm::HOME_INSERTION_M, 0.0, 0.0, 0.0, 0.2];
    MotionState {
        position,
        velocity: [0.0; AXES],
        acceleration: [0.0; AXES],
    }
}

/// Random velocities straight into the smoother, as from a filter that answers garbage; gives the least clearance, the
/// highest share of the tip speed limit and the interventions.
fn garbage(config: &ControlConfig, seed: u64, ticks: u32, guarded: bool) -> (f64, f64, u32) {
    garbage_from(home(), config, seed, ticks, guarded)
}

fn garbage_from(
    mut state: MotionState,
    config: &ControlConfig,
    seed: u64,
    ticks: u32,
    guarded: bool,
) -> (f64, f64, u32) {
    let mut random = SplitMix64::new(seed);
    let mut smoother = Smoother::new(&config.axes, TICK_S);
    let mut guard = Guard::new(config, &state, TICK_S);
    let mut velocity = [0.0; AXES];
    let (mut least_m, mut fastest, mut intervened) = (f64::INFINITY, 0.0_f64, 0);
    for tick in 0..ticks {
        if random.happens(0.01) {
            // Full speed one way or the other, on some of the axes.
            velocity = core::array::from_fn(|axis| match random.next_u64() % 4 {
                0 => config.axes[axis].velocity,
                1 => -config.axes[axis].velocity,
                _ => 0.0,
            });
        }
        let candidate = smoother.step(&state, &velocity);
        if guarded {
            let (next, stopped) = guard.next(&state, candidate.as_ref());
            for (axis, limits) in config.axes.iter().enumerate() {
                let jerk = (next.acceleration[axis] - state.acceleration[axis]) / TICK_S;
                assert!(
                    jerk.abs() <= limits.jerk * (1.0 + 1e-6),
                    "tick {tick} axis {axis}: jerk {jerk}"
                );
                let p = next.position[axis];
                assert!(
                    p >= limits.low && p <= limits.high,
                    "tick {tick} axis {axis}: {p}"
                );
            }
            state = next;
            intervened += u32::from(stopped);
        } else {
            state = candidate.unwrap();
        }
        let sample = guard.sample(&state);
        least_m = sample
            .clearances
            .iter()
            .fold(least_m, |least, &h| least.min(h));
        fastest = fastest.max(sample.tip_speed_m_s / config.tip_speed_m_s);
    }
    (least_m, fastest, intervened)
}

#[test]
fn the_guard_alone_keeps_every_limit_under_garbage() {
    let config = config();
    let (least_m, fastest, intervened) = garbage(&config, 51, 60_000, true);
    assert!(least_m >= config.guard.margin_m - 1e-6, "{least_m}");
    assert!(fastest <= 1.0 + 1e-9, "{fastest}");
    assert!(intervened > 1_000, "{intervened}");
}

#[test]
fn garbage_without_the_guard_breaks_them() {
    let (least_m, fastest, _) = garbage(&config(), 51, 5_000, false);
    assert!(least_m < 0.0 && fastest > 1.0, "{least_m} {fastest}");
}

/// Straight down, the finger tips `h` above the floor of the workspace, m.
fn above_the_floor(guard: &Guard, h: f64) -> MotionState {
    let mut state = home();
    let clearances = guard.boundaries.clearances(&Frames::at(&state.joints()));
    state.position[2] += clearances[8] - h;
    state
}

#[test]
fn an_arm_enabled_without_the_margin_never_leaves() {
    let config = config();
    let guard = Guard::new(&config, &home(), TICK_S);
    for (seed, h) in [(61, 1e-3), (62, 4e-4), (63, 1e-4), (64, 1e-6)] {
        let start = above_the_floor(&guard, h);
        let (least_m, _, intervened) = garbage_from(start, &config, seed, 5_000, true);
        assert!(least_m >= 0.0, "from {h}: {least_m}");
        assert!(intervened > 10, "from {h}: {intervened}");
    }
}

#[test]
fn an_arm_enabled_outside_gets_hardly_further_and_is_kept_in_once_it_is_back() {
    let config = config();
    let (margin_m, recovery_m) = (config.guard.margin_m, config.guard.recovery_m);
    let h = -0.002;
    let mut state = above_the_floor(&Guard::new(&config, &home(), TICK_S), h);
    let mut guard = Guard::new(&config, &state, TICK_S);
    let mut smoother = Smoother::new(&config.axes, TICK_S);
    let fastest = config.axes[2].velocity;
    let mut velocity = [0.0; AXES];
    let (mut back, mut least_m, mut least_back_m) = (false, f64::INFINITY, f64::INFINITY);
    for tick in 0..8_000 {
        // Further into the tissue, out of it, and into it again, as fast as the arm can.
        velocity[2] = if (1_000..4_000).contains(&tick) {
            -fastest
        } else {
            fastest
        };
        let candidate = smoother.step(&state, &velocity);
        state = guard.next(&state, candidate.as_ref()).0;
        let clearance_m = guard.sample(&state).clearances[8];
        least_m = least_m.min(clearance_m);
        back |= clearance_m > margin_m + recovery_m;
        if back {
            least_back_m = least_back_m.min(clearance_m);
        }
    }
    assert!(least_m < h && least_m >= h - recovery_m, "{least_m}");
    assert!(back);
    assert!(
        least_back_m >= margin_m && least_back_m < 0.005,
        "{least_back_m}"
    );
}

#[test]
fn a_jump_is_refused_and_the_held_stop_played() {
    let config = config();
    let state = home();
    let mut guard = Guard::new(&config, &state, TICK_S);
    let mut jump = state;
    jump.position[0] += 1e-6;
    assert_eq!(guard.next(&state, Some(&jump)), (state, true));
    let mut kick = state;
    kick.acceleration[1] = 1.0;
    assert_eq!(guard.next(&state, Some(&kick)), (state, true));
    let mut nan = state;
    nan.velocity[4] = f64::NAN;
    assert_eq!(guard.next(&state, Some(&nan)), (state, true));
    assert_eq!(guard.next(&state, None), (state, true));
    assert_eq!(guard.next(&state, Some(&state)), (state, false));
}

#[test]
fn bounds_between_samples_hold_on_random_stops() {
    let config = config();
    let guard = Guard::new(&config, &home(), TICK_S);
    let mut random = SplitMix64::new(52);
    for case in 0..300 {
        let mut state = home();
        for axis in 0..AXES {
            let limits = &config.axes[axis];
            state.position[axis] += random.between(-0.02, 0.02);
            state.velocity[axis] = random.between(-limits.velocity, limits.velocity);
            state.acceleration[axis] = random.between(-limits.acceleration, limits.acceleration);
        }
        let stop = Stop::new(&state, &config.axes);
        let gap_s = stop.joints_duration_s() / f64::from(INTERVALS);
        for index in 0..INTERVALS {
            let from_s = gap_s * f64::from(index);
            let (a, b) = (
                guard.sample(&stop.at(from_s)),
                guard.sample(&stop.at(from_s + gap_s)),
            );
            let reach = guard.reach(&stop, &a, &b, gap_s);
            for part in 1..10 {
                let middle = guard.sample(&stop.at(from_s + gap_s * f64::from(part) / 10.0));
                let dip_m = reach.point_speed_m_s() * gap_s / 2.0;
                for i in 0..CLEARANCES {
                    let bound = f64::midpoint(a.clearances[i], b.clearances[i]) - dip_m;
                    assert!(
                        middle.clearances[i] >= bound - 1e-12,
                        "case {case} clearance {i}"
                    );
                }
                let rise = reach.tip_acceleration_m_s2() * gap_s / 2.0;
                let bound = f64::midpoint(a.tip_speed_m_s, b.tip_speed_m_s) + rise;
                assert!(middle.tip_speed_m_s <= bound + 1e-12, "case {case}");
            }
        }
    }
}

#[test]
fn the_guard_measures_the_distances_that_it_should() {
    let config = config();
    let guard = Guard::new(&config, &home(), TICK_S);
    let frames = Frames::at(&home().joints());
    let clearances = guard.boundaries.clearances(&frames);
    // Home: control point 36.5 mm above the organ, fingers 10.2 mm lower, floor at -5 mm, ceiling at 90 mm.
    assert!((clearances[2] - 0.0415).abs() < 1e-12 && (clearances[5] - 0.0535).abs() < 1e-12);
    assert!((clearances[8] - 0.0313).abs() < 1e-12);
    let vessel = &config.geometry.forbidden[0];
    let to_fingers_m =
        (frames.finger_m - vessel.center_m).norm() - vessel.radius_m - hal::psm::SHAFT_RADIUS_M;
    assert!((clearances[14] - to_fingers_m).abs() < 1e-12);
}
