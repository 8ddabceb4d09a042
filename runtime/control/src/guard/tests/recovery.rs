//! Arms that are enabled without the margin or beyond a boundary.

use super::{MotionState, Rig, clearances, config, config_with, home, least, shapes};
use crate::config::ControlConfig;
use crate::guard::clearance::{CLEARANCES, FACES};
use crate::motion::AXES;
use crate::region::Shape;

/// Straight down, the finger tips `h` above the floor of the workspace, m.
fn above_the_floor(config: &ControlConfig, h: f64) -> MotionState {
    let mut state = home();
    state.position[2] += clearances(config, &state)[8] - h;
    state
}

#[test]
fn an_arm_enabled_without_the_margin_never_leaves() {
    let config = config();
    for (seed, h) in [(61, 1e-3), (62, 2e-4), (63, 1e-5), (64, 1e-7)] {
        let mut rig = Rig::new(config.clone(), [above_the_floor(&config, h)], seed);
        let (mut least_m, mut most_m, mut intervened) = (f64::INFINITY, 0.0_f64, 0);
        for _ in 0..5_000 {
            rig.shuffle();
            intervened += u32::from(rig.step()[0].intervened);
            let now_m = least(&clearances(&config, &rig.states[0]));
            (least_m, most_m) = (least_m.min(now_m), most_m.max(now_m));
        }
        assert!(least_m >= 0.0, "from {h}: {least_m}");
        assert!(intervened > 10, "from {h}: {intervened}");
        assert!(most_m > 1e-3, "from {h}: stuck at {most_m}");
    }
}

/// Until then it gets hardly further out.
#[test]
fn an_arm_enabled_outside_is_kept_in_once_it_is_back() {
    let config = config();
    let (margin_m, recovery_m) = (config.margins.guard_m, config.margins.recovery_m);
    let h = -0.002;
    let fastest = config.axes[2].velocity;
    let mut rig = Rig::new(config.clone(), [above_the_floor(&config, h)], 65);
    let (mut back, mut least_m, mut least_back_m) = (false, f64::INFINITY, f64::INFINITY);
    for tick in 0..8_000 {
        // Further into the tissue, out of it, and into it again, as fast as the arm can.
        rig.velocity[0][2] = if (1_000..4_000).contains(&tick) {
            -fastest
        } else {
            fastest
        };
        rig.step();
        let clearance_m = clearances(&config, &rig.states[0])[8];
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

/// The insertion of the arm at home at which it is `depth_m` deep in the region, or the yaw if that
/// does not lead there.
fn within(config: &ControlConfig, depth_m: f64) -> MotionState {
    let region_m = |state: &MotionState| least(&clearances(config, state)[FACES..]);
    let depth = |axis: usize, value: f64| {
        let mut state = home();
        state.position[axis] = value;
        (region_m(&state), state)
    };
    for axis in [0, 1] {
        for step in 0..4_000 {
            for side in [-1.0, 1.0] {
                let (h, state) = depth(axis, side * 1e-4 * f64::from(step));
                if h < -depth_m {
                    return state;
                }
            }
        }
    }
    panic!("the region is not met");
}

/// Which way each axis leads out of the region, by differences.
fn way_out(config: &ControlConfig, state: &MotionState) -> [f64; AXES] {
    let now_m = least(&clearances(config, state)[FACES..]);
    core::array::from_fn(|axis| {
        let mut moved = *state;
        moved.position[axis] += 1e-6;
        (least(&clearances(config, &moved)[FACES..]) - now_m).signum()
    })
}

/// Pushes an arm that starts `depth_m` in a region further in, then out; gives how much worse it
/// got than it had been before, and where it ended.
fn push(shape: Shape, depth_m: f64, axis: usize) -> (f64, f64) {
    let config = config_with(&[shape]);
    let start = within(&config, depth_m);
    let starts_m = clearances(&config, &start);
    let mut rig = Rig::new(config.clone(), [start], 66);
    let mut worse_m = 0.0_f64;
    let speed = config.axes[axis].velocity;
    for tick in 0..4_000 {
        let out = way_out(&config, &rig.states[0])[axis];
        rig.velocity[0] = [0.0; AXES];
        rig.velocity[0][axis] = if tick < 500 { -out } else { out } * speed;
        rig.step();
        let h = clearances(&config, &rig.states[0]);
        for index in FACES..CLEARANCES {
            if starts_m[index] < 0.0 {
                worse_m = worse_m.max(starts_m[index] - h[index]);
            } else {
                assert!(h[index] >= 0.0, "{index}: {}", h[index]);
            }
        }
    }
    let end_m = least(&clearances(&config, &rig.states[0])[FACES..]);
    (worse_m, end_m)
}

#[test]
fn an_arm_enabled_inside_a_region_only_comes_out() {
    let recovery_m = config().margins.recovery_m;
    for (index, shape) in shapes().into_iter().enumerate() {
        for depth_m in [1e-4, 2e-3, 6e-3] {
            let axis = if index % 2 == 0 { 1 } else { 0 };
            let axis = if index == 3 {
                1
            } else if index == 2 {
                0
            } else {
                axis
            };
            let (worse_m, end_m) = push(shape, depth_m, axis);
            assert!(
                worse_m <= recovery_m,
                "shape {index} from {depth_m}: {worse_m} worse"
            );
            assert!(end_m > 0.0, "shape {index} from {depth_m}: at {end_m}");
        }
    }
}

#[test]
fn garbage_never_makes_a_region_worse() {
    let recovery_m = config().margins.recovery_m;
    for (seed, shape) in (0..).zip(shapes()) {
        let config = config_with(&[shape]);
        let start = within(&config, 3e-3);
        let starts_m = clearances(&config, &start);
        let mut rig = Rig::new(config.clone(), [start], 670 + seed);
        for tick in 0..5_000 {
            rig.shuffle();
            rig.step();
            let h = clearances(&config, &rig.states[0]);
            for (index, (&now_m, &start_m)) in h.iter().zip(&starts_m).enumerate() {
                let keep_m = if start_m < 0.0 {
                    start_m - recovery_m
                } else {
                    0.0
                };
                assert!(now_m >= keep_m, "{tick} {index}: {now_m} {keep_m}");
            }
        }
    }
}
