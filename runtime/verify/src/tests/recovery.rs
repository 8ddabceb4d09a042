//! Arms that get their torque beyond a boundary: they may stay, get worse by a hair, and come back
//! for good.

use super::scene::{CommandSample, HOME, Scene, broken};
use crate::differences::AXES;

/// How much worse it may get: what the test's configuration says, m, and the checker's tolerance.
const RECOVERY_M: f64 = 0.00002;
const TOLERANCE: f64 = 1e-6;

/// At home, and inserted deeper by this much.
fn deeper(by_m: f64) -> [f64; AXES] {
    let mut place = HOME;
    place[2] += by_m;
    place
}

/// The lowest points at home are 123.1 mm below the remote centre with a closed jaw.
fn closed(scene: &mut Scene, floor: bool) -> [f64; AXES] {
    let mut place = HOME;
    place[6] = 0.0;
    let tips = -(HOME[2] - 0.4318 + 0.4162 + 0.0091 + 0.0102);
    // 5 mm above them.
    let bound = tips + 0.005;
    if floor {
        let point = bound - 0.004;
        scene.regions = format!(
            "[[forbidden]]\nname = \"floor\"\nshape = \"half_space\"\npoint_m = [0, 0, {point:?}]\nnormal = [0, 0, 1]\n"
        );
    } else {
        scene.arms[0].low[2] = bound;
    }
    place
}

#[test]
fn an_arm_enabled_outside_may_only_get_better() {
    for floor in [false, true] {
        let mut scene = Scene::loose(1);
        let home = closed(&mut scene, floor);
        let at = |by_m: f64| {
            let mut place = deeper(by_m);
            place[6] = home[6];
            place
        };
        let caught = |places: &[[f64; AXES]]| {
            let found = scene.broken_by(places);
            let again = found.iter().filter(|limit| limit.ends_with(".again"));
            (!found.is_empty(), again.count() == found.len())
        };
        let (fine, worse, again) = ((false, true), (true, false), (true, true));
        assert_eq!(caught(&[at(0.0), at(0.0), at(RECOVERY_M)]), fine);
        let out = RECOVERY_M + 2.0 * TOLERANCE;
        assert_eq!(caught(&[at(0.0), at(0.0), at(out)]), worse);
        // In small steps it gets no further.
        assert_eq!(caught(&[at(0.0), at(0.000_015), at(0.000_03)]), worse);
        // Where it was it may not return to.
        assert_eq!(
            caught(&[at(0.0), at(-0.002), at(-0.002 + RECOVERY_M)]),
            fine
        );
        assert_eq!(caught(&[at(0.0), at(-0.002), at(-0.001_9)]), again);
        // Once inside it stays inside.
        assert_eq!(caught(&[at(0.0), at(-0.006), at(-0.005)]), fine);
        assert_eq!(
            caught(&[at(0.0), at(-0.006), at(-0.005 + 2.0 * TOLERANCE)]),
            again
        );
        assert_eq!(caught(&[at(-0.1), at(-0.006), at(0.0)]), worse);
    }
}

#[test]
fn torque_that_comes_again_is_a_new_beginning() {
    let mut scene = Scene::loose(1);
    let home = closed(&mut scene, true);
    let mut inside = home;
    inside[2] -= 0.01;
    let run = |limp: bool| {
        let mut stream = scene.stream();
        let places = [home, inside, inside, home, home, home];
        for (place, tick) in places.iter().zip(0..) {
            let told = if limp && (2..5).contains(&tick) {
                CommandSample::limp(tick, place)
            } else {
                CommandSample::powered(tick, place)
            };
            stream.tick(tick, &[told.pair()]);
        }
        broken(&stream)
    };
    assert!(run(true).is_empty());
    assert_eq!(
        run(false),
        [
            "forbidden.floor.left_finger.again",
            "forbidden.floor.right_finger.again"
        ]
    );
}

#[test]
fn an_axis_enabled_beyond_its_range_comes_back() {
    let mut scene = Scene::loose(1);
    scene.axes[3] = [-0.1, 0.1, 1e12, 1e12, 1e12];
    let at = |roll: f64| {
        let mut place = HOME;
        place[3] = roll;
        place
    };
    assert!(
        scene
            .broken_by(&[at(0.3), at(0.2), at(0.05), at(-0.1)])
            .is_empty()
    );
    assert_eq!(scene.broken_by(&[at(0.3), at(0.300_01)]), ["roll.high"]);
    assert_eq!(
        scene.broken_by(&[at(-0.3), at(-0.2), at(-0.21)]),
        ["roll.low.again"]
    );
    assert_eq!(scene.broken_by(&[at(0.3), at(-0.11)]), ["roll.low"]);
}

#[test]
fn two_arms_enabled_too_near_may_only_part() {
    let mut scene = Scene::loose(2);
    scene.arms[1].place = [0.03, 0.0, 0.0];
    // Straight down side by side, 30 mm apart; 22 mm between the surfaces.
    let run = |gap_m: f64, yaws: &[f64], limp: core::ops::Range<u64>| {
        let mut scene = scene.clone();
        scene.gaps_m = [gap_m, -1.0];
        let mut stream = scene.stream();
        for (yaw, tick) in yaws.iter().zip(0..) {
            let mut place = HOME;
            place[0] = *yaw;
            let one = CommandSample::powered(tick, &place);
            let two = if limp.contains(&tick) {
                CommandSample::limp(tick, &HOME)
            } else {
                CommandSample::powered(tick, &HOME)
            };
            stream.tick(tick, &[one.pair(), two.pair()]);
        }
        broken(&stream)
    };
    let (name, again) = ("between_arms.shaft.shaft", "between_arms.shaft.shaft.again");
    // A yaw to the second arm lessens the gap by some 0.1 m times the angle.
    let toward = if run(0.0219, &[0.0, 0.1], 0..0).is_empty() {
        -1.0
    } else {
        1.0
    };
    let yaws = |all: &[f64]| all.iter().map(|yaw| yaw * toward).collect::<Vec<_>>();
    assert_eq!(run(0.0219, &yaws(&[0.0, 0.1]), 0..0), [name]);
    assert!(run(0.025, &yaws(&[0.0, 0.000_1]), 0..0).is_empty());
    assert_eq!(run(0.025, &yaws(&[0.0, 0.000_5]), 0..0), [name]);
    assert_eq!(run(0.025, &yaws(&[0.05, 0.03, 0.04]), 0..0), [again]);
    assert!(run(0.025, &yaws(&[0.05, 0.04, 0.03]), 0..0).is_empty());
    // The torque of either arm begins it anew.
    assert_eq!(run(0.025, &yaws(&[0.05, 0.03, 0.03, 0.05]), 0..0), [again]);
    assert!(run(0.025, &yaws(&[0.05, 0.03, 0.03, 0.05]), 1..3).is_empty());
}
