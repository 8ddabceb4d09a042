//! The guard alone: garbage in, no limit broken.

mod bounds;
mod each;
mod one_arm;
mod recovery;
mod timing;
mod two_arms;

use super::clearance::{Boundaries, CLEARANCES, Clearances};
use super::planted::PlantedGuardFault;
use super::sample::Sample;
use super::{Decision, Guard, Request};
use crate::config::{BetweenArms, ControlConfig};
use crate::motion::{AXES, Axes, JAW, MotionState};
use crate::region::{Block, Region, Shape};
use crate::smoother::Smoother;
use hal::random::SplitMix64;
use hal::{Pose, TICK_S};
use nalgebra::{Rotation3, Translation3, UnitQuaternion, Vector3};

fn config() -> ControlConfig {
    ControlConfig::load(
        &ControlConfig::default_control(),
        &ControlConfig::needle_lift_safety(),
    )
    .unwrap()
}

/// Needle lift with other regions, given in the RCM frame; the fingers start near (0, 0, -0.124).
fn config_with(shapes: &[Shape]) -> ControlConfig {
    let mut config = config();
    config.arms[0].forbidden = shapes
        .iter()
        .map(|&shape| Region {
            name: "test".to_owned(),
            shape,
        })
        .collect();
    config
}

/// One region of each shape, around where the arm starts.
fn shapes() -> [Shape; 4] {
    [
        Shape::Sphere {
            center_m: Vector3::new(0.0, 0.04, -0.125),
            radius_m: 0.02,
        },
        Shape::Capsule {
            from_m: Vector3::new(-0.035, -0.03, -0.14),
            to_m: Vector3::new(-0.03, 0.03, -0.1),
            radius_m: 0.008,
        },
        Shape::HalfSpace {
            point_m: Vector3::new(0.025, 0.0, -0.12),
            normal: Vector3::new(-1.0, 0.2, 0.3).normalize(),
        },
        Shape::Box(Block {
            center_m: Vector3::new(0.0, -0.035, -0.13),
            half_m: Vector3::new(0.02, 0.01, 0.015),
            axes: Rotation3::from_euler_angles(0.4, 0.2, 0.7),
        }),
    ]
}

/// Two arms whose remote centres are `apart_m` apart along x, over one common box.
fn two_arms(apart_m: f64) -> ControlConfig {
    let mut config = config();
    let scene_box = Block {
        center_m: Vector3::new(0.0, 0.0, 0.04),
        half_m: Vector3::new(0.09, 0.05, 0.05),
        axes: Rotation3::identity(),
    };
    let arm = config.arms[0].clone();
    config.arms = [-0.5, 0.5]
        .map(|side| {
            let mut arm = arm.clone();
            arm.name = format!("arm at {side}");
            arm.scene_from_rcm = Pose::from_parts(
                Translation3::new(side * apart_m, 0.0, 0.15),
                UnitQuaternion::from_euler_angles(0.0, 0.0, side),
            );
            arm.workspace = scene_box.moved(&arm.scene_from_rcm.inverse());
            arm.forbidden.clear();
            arm
        })
        .to_vec();
    config.between_arms = Some(BetweenArms {
        shaft_to_shaft_m: 0.002,
        tip_to_shaft_m: 0.001,
    });
    config
}

fn home() -> MotionState {
    let position = [0.0, 0.0, hal::psm::HOME_INSERTION_M, 0.0, 0.0, 0.0, 0.2];
    at_rest(position)
}

fn at_rest(position: Axes) -> MotionState {
    MotionState {
        position,
        velocity: [0.0; AXES],
        acceleration: [0.0; AXES],
    }
}

fn sample(config: &ControlConfig, arm: usize, state: &MotionState) -> Sample {
    let boundaries = Boundaries::new(&config.arms[arm]);
    Sample::new(state, &boundaries, &[true; CLEARANCES])
}

fn clearances(config: &ControlConfig, state: &MotionState) -> Clearances {
    sample(config, 0, state).clearances
}

fn least(values: &[f64]) -> f64 {
    values.iter().fold(f64::INFINITY, |least, &h| least.min(h))
}

/// Full speed one way or the other, on some of the axes.
fn bang(config: &ControlConfig, random: &mut SplitMix64) -> Axes {
    core::array::from_fn(|axis| match random.next_u64() % 4 {
        0 => config.axes[axis].velocity,
        1 => -config.axes[axis].velocity,
        _ => 0.0,
    })
}

/// Arms that are driven through a guard.
struct Rig<const ARMS: usize> {
    config: ControlConfig,
    guard: Guard<ARMS>,
    smoothers: [Smoother; ARMS],
    states: [MotionState; ARMS],
    /// Where the smoothers are told to go.
    velocity: [Axes; ARMS],
    random: SplitMix64,
}

impl<const ARMS: usize> Rig<ARMS> {
    fn new(config: ControlConfig, states: [MotionState; ARMS], seed: u64) -> Self {
        Self {
            guard: Guard::new(&config, &states, TICK_S).unwrap(),
            smoothers: core::array::from_fn(|_| Smoother::new(&config.axes, TICK_S)),
            states,
            velocity: [[0.0; AXES]; ARMS],
            random: SplitMix64::new(seed),
            config,
        }
    }

    /// Now and then another velocity, as from a filter that answers garbage.
    fn shuffle(&mut self) {
        for arm in 0..ARMS {
            if self.random.happens(0.01) {
                self.velocity[arm] = bang(&self.config, &mut self.random);
            }
        }
    }

    /// What the smoothers answer; now and then any motion that the jerk limits allow.
    fn candidates(&mut self) -> [Option<MotionState>; ARMS] {
        core::array::from_fn(|arm| {
            let mut candidate = self.smoothers[arm].step(&self.states[arm], &self.velocity[arm])?;
            if self.random.happens(0.05) {
                for axis in 0..AXES {
                    let jerk = self.config.axes[axis].jerk * self.random.between(-1.0, 1.0);
                    let state = &self.states[arm];
                    let (v, a) = (state.velocity[axis], state.acceleration[axis]);
                    candidate.acceleration[axis] = a + jerk * TICK_S;
                    candidate.velocity[axis] = v + TICK_S * (a + jerk * TICK_S / 2.0);
                    candidate.position[axis] = state.position[axis]
                        + TICK_S * (v + TICK_S * (a / 2.0 + jerk * TICK_S / 6.0));
                }
            }
            Some(candidate)
        })
    }

    /// One tick; gives what the guard decided.
    fn step(&mut self) -> [Decision; ARMS] {
        let requests = self.candidates().map(Request::Follow);
        self.ask(&requests)
    }

    fn ask(&mut self, requests: &[Request; ARMS]) -> [Decision; ARMS] {
        let decisions = self.guard.next(&self.states, requests);
        for (arm, decision) in decisions.iter().enumerate() {
            self.check_axes(arm, &decision.state);
            self.states[arm] = decision.state;
        }
        decisions
    }

    /// Joint range, velocity, acceleration and jerk of the step to `next`.
    fn check_axes(&self, arm: usize, next: &MotionState) {
        let state = &self.states[arm];
        for (axis, limits) in self.config.axes.iter().enumerate() {
            let jerk = (next.acceleration[axis] - state.acceleration[axis]) / TICK_S;
            assert!(
                jerk.abs() <= limits.jerk * (1.0 + 1e-6),
                "axis {axis}: {jerk}"
            );
            assert!(next.velocity[axis].abs() <= limits.velocity * (1.0 + 1e-9));
            assert!(next.acceleration[axis].abs() <= limits.acceleration * (1.0 + 1e-9));
            let p = next.position[axis];
            assert!(p >= limits.low && p <= limits.high, "axis {axis}: {p}");
        }
    }
}

#[test]
fn the_guard_measures_the_distances_that_it_should() {
    let config = config();
    let state = home();
    let h = clearances(&config, &state);
    // Home: control point 36.5 mm above the organ, floor at -5 mm, ceiling at 90 mm.
    assert!((h[2] - 0.0415).abs() < 1e-12 && (h[5] - 0.0535).abs() < 1e-12);
    // The finger tips are half the jaw's opening off the approach direction.
    let lower_m = hal::psm::FINGER_M * (0.5 * state.position[JAW]).cos();
    assert!((h[8] - 0.0415 + lower_m).abs() < 1e-12);
    assert!((h[14] - h[8]).abs() < 1e-12);
    let sample = sample(&config, 0, &state);
    let Shape::Sphere { center_m, radius_m } = config.arms[0].forbidden[0].shape else {
        panic!("needle lift's vessel is a sphere");
    };
    let radii_m = radius_m + hal::psm::SHAFT_RADIUS_M;
    for finger in 0..2 {
        let tip_m = sample.instrument.fingers_m[finger];
        let apart_m = (tip_m - center_m).norm() - radii_m;
        assert!((h[20 + finger] - apart_m).abs() < 1e-12);
    }
    assert!(h[22..].iter().all(|&h| h > 1.0), "no other region");
}

#[test]
fn every_planted_fault_is_listed_once() {
    let faults = PlantedGuardFault::all();
    for (index, fault) in faults.iter().enumerate() {
        assert!(!faults[..index].contains(fault), "{fault:?}");
    }
    // Seven checks an axis, the clearances, two of the tip's speed, and seven pairs of links; six
    // paddings and three more.
    assert_eq!(faults.len(), 2 * (49 + CLEARANCES + 2 + 7) + 2 * 6 + 3);
}

#[test]
fn an_unplanted_guard_is_the_one_that_is_tested() {
    // The hooks of planted faults change nothing while none is planted, and are heard when one is.
    let config = config();
    let mut rigs = [0, 1].map(|_| Rig::new(config.clone(), [home()], 59));
    let last = PlantedGuardFault::Dropped(super::planted::Check::Clearance(CLEARANCES - 1));
    rigs[1].guard.plant(last);
    for _ in 0..2_000 {
        let [one, other] = rigs.each_mut().map(|rig| {
            rig.shuffle();
            rig.step()
        });
        assert_eq!(one, other);
    }
}
