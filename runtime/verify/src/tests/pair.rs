//! Two arms: each gap between them broken alone, kept by a hair, and the arm without torque.

use hal::{JointVector, Pose};
use nalgebra::{Translation3, UnitQuaternion};

use super::distances::{sampled, to_segment};
use super::scene::{CommandSample, HOME, Random, Scene, broken};
use crate::Stream;
use crate::chain::{Instrument, LINK_NAMES};
use crate::differences::AXES;

/// Two arms 80 mm apart that lean towards each other.
fn scene() -> Scene {
    let mut scene = Scene::loose(2);
    scene.arms[0].place = [-0.04, 0.0, 0.1];
    scene.arms[0].rpy = [0.0, -0.3, 0.1];
    scene.arms[1].place = [0.04, 0.005, 0.1];
    scene.arms[1].rpy = [0.05, 0.3, 0.0];
    scene
}

fn tick(stream: &mut Stream, tick: u64, told: [CommandSample; 2]) {
    stream.tick(tick, &[told[0].pair(), told[1].pair()]);
}

fn both(stream: &mut Stream, at: u64, places: &[[f64; AXES]; 2]) {
    tick(
        stream,
        at,
        places
            .each_ref()
            .map(|place| CommandSample::powered(at, place)),
    );
}

fn instrument(scene: &Scene, arm: usize, place: &[f64; AXES]) -> Instrument {
    let [joints @ .., jaw] = *place;
    let [roll, pitch, yaw] = scene.arms[arm].rpy;
    let frame = Pose::from_parts(
        Translation3::from(scene.arms[arm].place),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    );
    Instrument::new(&frame, &JointVector::from(joints), jaw)
}

/// Every gap between the surfaces of the two arms by name.
fn gaps(scene: &Scene, places: &[[f64; AXES]; 2]) -> Vec<(String, f64)> {
    let links = [0, 1].map(|arm| instrument(scene, arm, &places[arm]).links());
    let gap = |one: usize, link: usize| {
        let ((start, end), (from, to)) = (links[one][link], links[1 - one][0]);
        sampled(start, end, |point| to_segment(point, from, to)) - 0.008
    };
    let mut gaps = vec![("between_arms.shaft.shaft".to_owned(), gap(0, 0))];
    for (one, [arm, other]) in [["psm1", "psm2"], ["psm2", "psm1"]].into_iter().enumerate() {
        for (link, name) in LINK_NAMES.iter().enumerate().skip(1) {
            gaps.push((
                format!("between_arms.{arm}_{name}.{other}_shaft"),
                gap(one, link),
            ));
        }
    }
    gaps
}

fn least<'a>(gaps: impl IntoIterator<Item = &'a (String, f64)>) -> &'a (String, f64) {
    let order = |one: &&(String, f64), two: &&(String, f64)| one.1.total_cmp(&two.1);
    gaps.into_iter().min_by(order).unwrap()
}

#[test]
fn each_gap_is_caught_alone() {
    let mut random = Random(21);
    let mut counts = std::collections::BTreeMap::<String, u32>::new();
    for _ in 0..600 {
        let mut scene = scene();
        let places = [random.place(), random.place()];
        let apart = [HOME, HOME].map(|mut place| {
            place[2] = 0.065;
            place
        });
        let now = gaps(&scene, &places);
        let (shafts, tip) = (&now[0], least(&now[1..]));
        let before = gaps(&scene, &apart);
        if before[0].1 < shafts.1 + 0.001 || least(&before[1..]).1 < tip.1 + 0.001 {
            continue;
        }
        let mut check = |slacks_m: [f64; 2], expected: &[&str]| {
            scene.gaps_m = [shafts.1 - slacks_m[0], tip.1 - slacks_m[1]];
            let mut stream = scene.stream();
            both(&mut stream, 0, &apart);
            both(&mut stream, 1, &places);
            assert_eq!(broken(&stream), expected, "{places:?} {now:?}");
            for violation in stream.violations() {
                assert_eq!(violation.arm, "psm1+psm2");
            }
        };
        check([-3e-6, 1e-7], &[&shafts.0]);
        check([1e-7, 1e-7], &[]);
        let second = now[1..].iter().filter(|gap| gap.0 != tip.0);
        if least(second).1 > tip.1 + 1e-5 {
            check([1e-7, -3e-6], &[&tip.0]);
            *counts.entry(tip.0.clone()).or_default() += 1;
        }
    }
    assert!(
        counts.len() == 6 && counts.values().all(|count| *count >= 5),
        "{counts:?}"
    );
}

#[test]
fn tips_may_meet() {
    // Both tips in one place, with shafts that lean away from each other.
    let mut scene = scene();
    scene.arms[0].rpy = [0.0, -0.6, 0.0];
    scene.arms[1].rpy = [0.0, 0.6, 0.0];
    scene.arms[1].place[1] = 0.0;
    let mut place = HOME;
    // The remote centres are 80 mm apart: the tips meet at half of it, 30 degrees and more from
    // upright.
    place[2] = 0.04 / 0.6_f64.sin() + 0.4318 - 0.4162 - 0.0091;
    scene.gaps_m = [0.004, 0.001];
    let met = [0, 1].map(|arm| instrument(&scene, arm, &place).control_point);
    assert!((met[0] - met[1]).norm() < 1e-9, "{met:?}");
    let mut stream = scene.stream();
    both(&mut stream, 0, &[place, place]);
    // None of it is an allowance for an arm that was enabled outside: no gap is negative.
    let worst = stream
        .worst()
        .filter(|worst| worst.limit.starts_with("between"));
    assert!(
        worst
            .map(|worst| worst.value - worst.bound)
            .all(|gap| gap > 0.0)
    );
    assert!(broken(&stream).is_empty());
}

/// Places in which the shafts' gap is some 20 mm, 1 mm less and 3 mm less.
fn approach() -> [[f64; AXES]; 3] {
    let mut near = HOME;
    near[0] = 0.02;
    let mut nearer = HOME;
    nearer[0] = 0.06;
    [HOME, near, nearer]
}

fn shaft_gap(scene: &Scene, places: &[[f64; AXES]; 2]) -> f64 {
    gaps(scene, places)[0].1
}

#[test]
fn an_arm_without_torque_that_is_pushed_moves_the_bound() {
    let mut scene = scene();
    let [home, near, nearer] = approach();
    let gap = |one, two| shaft_gap(&scene, &[one, two]);
    assert!(gap(home, home) > gap(near, home) + 5e-4 && gap(near, home) > gap(nearer, home) + 5e-4);
    scene.gaps_m[0] = gap(near, home) + 1e-4;
    let run = |limp_until: u64, first: [[f64; AXES]; 6]| {
        let mut stream = scene.stream();
        for (place, at) in first.iter().zip(0..) {
            let one = if at < limp_until {
                CommandSample::limp(at, place)
            } else {
                CommandSample::powered(at, place)
            };
            tick(&mut stream, at, [one, CommandSample::powered(at, &home)]);
        }
        broken(&stream)
    };
    // Pushed while it is limp; with torque the same way is its own doing.
    assert!(run(9, [home, home, near, nearer, near, nearer]).is_empty());
    assert_eq!(
        run(1, [home, home, near, near, near, near]),
        ["between_arms.shaft.shaft"]
    );
    // What it was pushed to is allowed when it gets torque, but no more.
    assert!(run(4, [home, home, near, near, near, near]).is_empty());
    assert_eq!(
        run(4, [home, home, near, near, near, nearer]),
        ["between_arms.shaft.shaft"]
    );
    // And no less once it has come back.
    assert_eq!(
        run(3, [home, home, near, near, home, near]),
        ["between_arms.shaft.shaft.again"]
    );
}

#[test]
fn an_arm_with_torque_may_not_approach_one_without() {
    let mut scene = scene();
    let [home, near, nearer] = approach();
    scene.gaps_m[0] = shaft_gap(&scene, &[near, home]) + 1e-4;
    let run = |limp: [[f64; AXES]; 4], powered: [[f64; AXES]; 4]| {
        let mut stream = scene.stream();
        for (at, (limp, powered)) in (0..).zip(limp.iter().zip(&powered)) {
            tick(
                &mut stream,
                at,
                [
                    CommandSample::powered(at, powered),
                    CommandSample::limp(at, limp),
                ],
            );
        }
        broken(&stream)
    };
    assert!(run([home; 4], [home; 4]).is_empty());
    assert_eq!(
        run([home; 4], [home, home, near, near]),
        ["between_arms.shaft.shaft"]
    );
    // Nor use a tremble of the other one to get on.
    let mut tremble = home;
    tremble[0] += 1e-6;
    assert_eq!(
        run([home, home, tremble, home], [home, near, nearer, nearer]),
        ["between_arms.shaft.shaft"]
    );
}

#[test]
fn a_push_moves_the_bound_by_as_much_as_it_pushed() {
    let mut scene = scene();
    let at = |yaw: f64| {
        let mut place = HOME;
        place[0] = yaw;
        place
    };
    // The second arm is pushed on in two steps, from outside the bound to well beyond it.
    let pushes = [at(0.0), at(-0.02), at(-0.04), at(-0.04)];
    let gap = |one: f64, two: f64| shaft_gap(&scene, &[at(one), at(two)]);
    assert!(gap(0.0, 0.0) > gap(0.0, -0.02) + 5e-4);
    let bound = gap(0.0, 0.0) - 1e-4;
    let first = bound - gap(0.0, -0.02);
    assert!(gap(0.0, -0.04) - gap(0.01, -0.04) > 1e-4 && first > 4e-4);
    let hair = gap(0.0, -0.04) - gap(0.000_1, -0.04);
    assert!((3e-6..1.8e-5).contains(&hair), "{hair}");
    scene.gaps_m[0] = bound;
    for (yaw, found) in [(0.0, false), (0.000_1, false), (0.002, true), (0.01, true)] {
        let mut stream = scene.stream();
        let own = [at(0.0), at(0.0), at(0.0), at(yaw)];
        for (tick_of, (push, own)) in (0..).zip(pushes.iter().zip(&own)) {
            let told = [
                CommandSample::powered(tick_of, own),
                CommandSample::limp(tick_of, push),
            ];
            tick(&mut stream, tick_of, told);
        }
        assert_eq!(!broken(&stream).is_empty(), found, "{yaw}");
    }
}

#[test]
fn two_limp_arms_may_meet() {
    let mut scene = scene();
    scene.gaps_m = [1.0, 1.0];
    let mut stream = scene.stream();
    for at in 0..3 {
        tick(
            &mut stream,
            at,
            [
                CommandSample::limp(at, &HOME),
                CommandSample::limp(at, &HOME),
            ],
        );
    }
    assert!(broken(&stream).is_empty());
}

#[test]
fn a_third_arm_is_not_passed_over() {
    let mut stream = scene().stream();
    let told = CommandSample::powered(0, &HOME);
    stream.tick(0, &[told.pair(); 3]);
    assert_eq!(broken(&stream), ["unknown_arms"]);
}
