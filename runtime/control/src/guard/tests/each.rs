//! Every single clearance: an arm is pushed at one boundary that only one of its parts can meet
//! first.

use super::two_arms::gaps;
use super::{
    Axes, ControlConfig, MotionState, Rig, SplitMix64, at_rest, clearances, config_with, two_arms,
};
use crate::config::BetweenArms;
use crate::guard::clearance::FACES;
use crate::guard::gaps::KINDS;
use crate::guard::planted::{Check, PlantedGuardFault};
use crate::instrument::{KinematicState, LINKS};
use crate::region::{Block, Shape};
use hal::Pose;
use hal::psm::SHAFT_RADIUS_M;
use nalgebra::{Rotation3, Translation3, UnitQuaternion, Vector3};

/// Poses that are tried until one fits.
const SEARCH: u32 = 20_000;

/// How near a part starts to what it is pushed at, m.
const START_M: f64 = 0.003;

/// A pose away from every end, the jaw wide open.
fn random_pose(config: &ControlConfig, random: &mut SplitMix64) -> MotionState {
    at_rest(core::array::from_fn(|axis| {
        let limits = &config.axes[axis];
        match axis {
            2 => random.between(0.1, 0.18),
            6 => random.between(0.8, 1.2),
            _ => random.between(0.8 * limits.low, 0.8 * limits.high),
        }
    }))
}

/// Velocities that bring `h` down fastest for each axis's limit, by differences.
fn down(config: &ControlConfig, state: &MotionState, h: impl Fn(&MotionState) -> f64) -> Axes {
    let now = h(state);
    let slopes: Axes = core::array::from_fn(|axis| {
        let mut moved = *state;
        moved.position[axis] += 1e-7;
        (h(&moved) - now) / 1e-7 * config.axes[axis].velocity
    });
    let steepest = slopes
        .iter()
        .fold(1e-9_f64, |most, slope| most.max(slope.abs()));
    // A third of full speed, so that neither the tip's speed nor its turning is what holds the arm
    // back.
    core::array::from_fn(|axis| -slopes[axis] / steepest * config.axes[axis].velocity / 3.0)
}

/// The guard as it is keeps a margin, and with any of `faults` it does not.
fn only_without(
    faults: &[PlantedGuardFault],
    outcome: impl Fn(Option<PlantedGuardFault>) -> Result<(), String>,
) {
    assert_eq!(outcome(None), Ok(()));
    for &fault in faults {
        assert!(outcome(Some(fault)).is_err(), "{fault:?} goes unnoticed");
    }
}

/// A check that is dropped, and the same negated.
fn both(check: Check) -> [PlantedGuardFault; 2] {
    [
        PlantedGuardFault::Dropped(check),
        PlantedGuardFault::Negated(check),
    ]
}

/// Pushes the arm at clearance `index`, which should come to the margin and no nearer.
fn push(
    config: &ControlConfig,
    state: MotionState,
    index: usize,
    fault: Option<PlantedGuardFault>,
) -> Result<(), String> {
    let margin_m = config.margins.guard_m;
    let mut rig = Rig::new(config.clone(), [state], 0);
    if let Some(fault) = fault {
        rig.guard.plant(fault);
    }
    let mut least_m = f64::INFINITY;
    for _ in 0..600 {
        rig.velocity[0] = down(config, &rig.states[0], |state| {
            clearances(config, state)[index]
        });
        rig.step();
        least_m = least_m.min(clearances(config, &rig.states[0])[index]);
    }
    // And away again.
    let towards = rig.velocity[0];
    for _ in 0..200 {
        rig.velocity[0] = towards.map(|velocity| -velocity);
        rig.step();
    }
    let end_m = clearances(config, &rig.states[0])[index];
    if end_m < least_m + 1e-4 {
        return Err(format!("{index} holds the arm at {end_m}"));
    }
    met(index, least_m, margin_m)
}

/// Whether the least of something came to the margin and no nearer.
fn met(index: usize, least_m: f64, margin_m: f64) -> Result<(), String> {
    if least_m < margin_m - 1e-9 {
        Err(format!("{index} comes as near as {least_m}"))
    } else if least_m > margin_m + 5e-4 {
        Err(format!("{index} is never met, {least_m}"))
    } else {
        Ok(())
    }
}

#[test]
fn each_point_is_kept_from_each_face_of_the_workspace() {
    let mut random = SplitMix64::new(31);
    for index in 0..FACES {
        let (point, face) = (index / 6, index % 6);
        let mut config = config_with(&[]);
        let axes = Rotation3::from_euler_angles(0.3, -0.2, 0.5);
        config.arms[0].workspace = Block {
            center_m: Vector3::zeros(),
            half_m: Vector3::repeat(0.5),
            axes,
        };
        // A pose in which this point leads the others towards the face.
        let state = loop {
            let state = random_pose(&config, &mut random);
            let h = clearances(&config, &state);
            let others = (0..3).filter(|&other| other != point);
            if others
                .into_iter()
                .all(|other| h[6 * other + face] > h[index] + 1.5e-3)
            {
                break state;
            }
        };
        let h = clearances(&config, &state)[index];
        let inward = config.arms[0].workspace.inward()[face];
        config.arms[0].workspace.center_m += inward * (h - START_M);
        let started = clearances(&config, &state);
        assert!((started[index] - START_M).abs() < 1e-12);
        only_without(&both(Check::Clearance(index)), |fault| {
            push(&config, state, index, fault)
        });
    }
}

/// A small region beside a link, so that the others are further from it, and seven far away.
fn beside(slot: usize, link: usize, random: &mut SplitMix64) -> (ControlConfig, MotionState) {
    let far = Shape::Sphere {
        center_m: Vector3::new(0.0, 0.0, 0.5),
        radius_m: 0.01,
    };
    let (index, small_m) = (FACES + LINKS * slot + link, 0.001);
    let plain = config_with(&[]);
    for _ in 0..SEARCH {
        let state = random_pose(&plain, random);
        let (from_m, to_m) = KinematicState::new(&state).instrument.links()[link];
        let along = to_m - from_m;
        let turn = Rotation3::new(along.normalize() * random.between(0.0, 6.0));
        let across = turn * along.cross(&Vector3::new(0.3, 0.5, 0.7)).normalize();
        let away_m = across * (START_M + small_m + SHAFT_RADIUS_M);
        let center_m = from_m + along * [0.7, 0.5, 0.95, 0.95][link] + away_m;
        let mut shapes = [far; 8];
        shapes[slot] = match slot % 3 {
            0 => Shape::Sphere {
                center_m,
                radius_m: small_m,
            },
            1 => Shape::Capsule {
                from_m: center_m,
                to_m: center_m + across * 0.01,
                radius_m: small_m,
            },
            _ => Shape::Box(Block {
                center_m: center_m + across * 0.003,
                half_m: Vector3::new(0.001, 0.001, 0.004),
                axes: Rotation3::rotation_between(&Vector3::z(), &across).unwrap(),
            }),
        };
        let mut config = config_with(&shapes);
        config.arms[0].workspace.half_m = Vector3::repeat(0.5);
        let h = clearances(&config, &state);
        let mut others = (index - link..index - link + LINKS).filter(|&other| other != index);
        if h[index] > START_M - 1e-9 && others.all(|other| h[other] > h[index] + 2e-4) {
            return (config, state);
        }
    }
    panic!("no pose in which link {link} is beside region {slot}");
}

#[test]
fn each_link_is_kept_from_each_region() {
    let mut random = SplitMix64::new(32);
    for slot in 0..8 {
        for link in 0..LINKS {
            let (config, state) = beside(slot, link, &mut random);
            let index = FACES + LINKS * slot + link;
            // Negated, it still stops the arm once the whole stop's travel no longer says that the
            // region is far.
            let dropped = PlantedGuardFault::Dropped(Check::Clearance(index));
            only_without(&[dropped], |fault| push(&config, state, index, fault));
        }
    }
}

/// Two arms of which the links of `kind` are nearest to one another, [`START_M`] from what they
/// must keep.
fn facing(kind: usize, random: &mut SplitMix64) -> (ControlConfig, [MotionState; 2]) {
    let (link_a, link_b) = KINDS[kind];
    for _ in 0..SEARCH {
        let mut config = two_arms(0.1);
        // The wrist's neighbours are so near to it that only its own gap may be the wide one.
        config.between_arms = Some(BetweenArms {
            shaft_to_shaft_m: if kind == 0 { 0.004 } else { 0.0 },
            tip_to_shaft_m: if kind == 0 { 0.0 } else { 0.004 },
        });
        for arm in &mut config.arms {
            arm.workspace.half_m = Vector3::repeat(0.5);
        }
        let states = [0, 1].map(|_| random_pose(&config, random));
        config.arms[1].scene_from_rcm.rotation = UnitQuaternion::from_euler_angles(
            random.between(-0.8, 0.8),
            random.between(-0.8, 0.8),
            random.between(-3.0, 3.0),
        );
        let links = [0, 1].map(|arm| {
            let instrument = KinematicState::new(&states[arm]).instrument;
            instrument.moved(&config.arms[arm].scene_from_rcm).links()
        });
        let ((a_from, a_to), (b_from, b_to)) = (links[0][link_a], links[1][link_b]);
        let across = (a_to - a_from).cross(&(b_to - b_from));
        if across.norm() < 1e-9 {
            continue;
        }
        let inner = |link: usize| match link {
            0 => 0.8,
            1 => 0.5,
            _ => 0.9,
        };
        let a_m = a_from + (a_to - a_from) * inner(link_a);
        let b_m = b_from + (b_to - b_from) * inner(link_b);
        let between = config.between_arms.unwrap();
        let gap_m = if kind == 0 {
            between.shaft_to_shaft_m
        } else {
            between.tip_to_shaft_m
        };
        let apart = across.normalize() * (gap_m + 2.0 * SHAFT_RADIUS_M + START_M);
        let moved = Translation3::from(a_m + apart - b_m);
        let frame: Pose = config.arms[1].scene_from_rcm;
        config.arms[1].scene_from_rcm = moved * frame;
        let gaps_m = gaps(&config, &states[0], &states[1]);
        let others = (0..KINDS.len()).filter(|&other| other != kind);
        if (gaps_m[kind] - START_M).abs() < 1e-9
            && others
                .into_iter()
                .all(|other| gaps_m[other] > gaps_m[kind] + 2e-4)
        {
            return (config, states);
        }
    }
    panic!("no poses in which links of kind {kind} face one another");
}

#[test]
fn each_pair_of_links_of_two_arms_keeps_its_gap() {
    let mut random = SplitMix64::new(33);
    for kind in 0..KINDS.len() {
        for turn in 0..3 {
            let (config, states) = facing(kind, &mut random);
            only_without(&both(Check::Pair(kind)), |fault| {
                push_pair(&config, states, (kind, turn), fault)
            });
        }
    }
}

/// Pushes the links of `kind` together: one arm goes for the other, by `turn`, or both do.
fn push_pair(
    config: &ControlConfig,
    states: [MotionState; 2],
    (kind, turn): (usize, usize),
    fault: Option<PlantedGuardFault>,
) -> Result<(), String> {
    let mut rig = Rig::new(config.clone(), states, 0);
    if let Some(fault) = fault {
        rig.guard.plant(fault);
    }
    let mut least_m = f64::INFINITY;
    for _ in 0..600 {
        for arm in (0..2).filter(|&arm| turn == 2 || turn == arm) {
            let other = rig.states[1 - arm];
            rig.velocity[arm] = down(config, &rig.states[arm], |state| {
                let pair = if arm == 0 {
                    [state, &other]
                } else {
                    [&other, state]
                };
                gaps(config, pair[0], pair[1])[kind]
            });
        }
        rig.step();
        least_m = least_m.min(gaps(config, &rig.states[0], &rig.states[1])[kind]);
    }
    met(kind, least_m, config.margins.guard_m)
}
