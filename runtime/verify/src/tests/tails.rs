//! The stop that travels with a command: every limit broken by it alone, and kept by a hair.

use hal::psm::{FINGER_M, RCC_M, SHAFT_RADIUS_M, TOOL_M, WRIST_M};
use hal::tail::{AxisTail, TailPhase};
use hal::{SafeTail, TimeNs};

use super::scene::{CommandSample, HOME, NAMES, Random, Scene, broken};
use crate::Stream;

const ROLL: usize = 3;

/// The speed of the stops below, their acceleration and jerk, in s how long they last, and how far
/// they go.
const SPEED: f64 = 0.3;
const BRAKE: f64 = 2.0;
const JERK: f64 = 20.0;
const DURATION_S: f64 = SPEED / BRAKE + BRAKE / JERK;
const WAY: f64 = SPEED * DURATION_S / 2.0;

fn phases(given: [(f64, f64); 3]) -> [TailPhase; 3] {
    given.map(|(duration_s, jerk)| TailPhase { duration_s, jerk })
}

/// The shortest way to rest from `velocity` without acceleration.
fn stop(velocity: f64, brake: f64, jerk: f64) -> [TailPhase; 3] {
    let (speed, jerk) = (velocity.abs(), jerk * velocity.signum());
    let (ramp_s, hold_s) = if speed * jerk.abs() > brake * brake {
        (brake / jerk.abs(), speed / brake - brake / jerk.abs())
    } else {
        ((speed / jerk.abs()).sqrt(), 0.0)
    };
    phases([(ramp_s, -jerk), (hold_s, 0.0), (ramp_s, jerk)])
}

/// An arm at home in which one axis moves, and the way to rest.
fn moving(axis: usize, velocity: f64) -> (CommandSample, SafeTail) {
    let mut told = CommandSample::powered(7, &HOME);
    match told.command.velocity.get_mut(axis) {
        Some(joint) => *joint = velocity,
        None => told.command.jaw_velocity = velocity,
    }
    let mut tail = SafeTail::at_rest(told.command.stamp, &HOME, true);
    tail.axes[axis].start.velocity = velocity;
    tail.axes[axis].phases = stop(velocity, BRAKE, JERK);
    (told, tail)
}

/// What is broken by one command and its tail.
fn broken_by(scene: &Scene, (told, tail): &(CommandSample, SafeTail)) -> Vec<String> {
    let mut stream = scene.stream();
    stream.tick(7, &[told.pair()]);
    stream.tails(&[tail]);
    broken(&stream)
}

/// That the tail breaks `name` and nothing else under one bound, and nothing under the other.
fn only(
    name: &str,
    pair: &(CommandSample, SafeTail),
    bounds: [f64; 2],
    set: impl Fn(&mut Scene, f64),
) {
    let [broken, kept] = bounds.map(|bound| {
        let mut scene = Scene::loose(1);
        set(&mut scene, bound);
        broken_by(&scene, pair)
    });
    assert_eq!(broken, [name]);
    assert!(kept.is_empty(), "{kept:?}");
}

#[test]
fn speed_brake_and_jerk_of_a_tail_are_caught_alone() {
    for (axis, name) in NAMES.iter().enumerate() {
        let pair = moving(axis, -SPEED);
        for (order, what, peak) in [(3, "acceleration", BRAKE), (4, "jerk", JERK)] {
            only(
                &format!("tail.{name}.{what}"),
                &pair,
                [peak * (1.0 - 2e-6), peak],
                |scene, bound| scene.axes[axis][order] = bound,
            );
        }
        // A tail that speeds up first, and is fastest in the middle of a millisecond and of a
        // phase.
        let (told, mut tail) = moving(axis, SPEED);
        let up_s = 0.050_25;
        let peak = SPEED + JERK * up_s * up_s;
        let brake = (JERK * peak).sqrt();
        tail.axes[axis].phases = phases([
            (up_s, JERK),
            (up_s + brake / JERK, -JERK),
            (brake / JERK, JERK),
        ]);
        only(
            &format!("tail.{name}.velocity"),
            &(told, tail),
            [peak * (1.0 - 2e-6), peak],
            |scene, bound| scene.axes[axis][2] = bound,
        );
    }
}

#[test]
fn a_tail_beyond_a_range_is_caught_alone() {
    for (axis, name) in NAMES.iter().enumerate() {
        for (sign, end, what) in [(-1.0, 0, "low"), (1.0, 1, "high")] {
            let last = HOME[axis] + sign * WAY;
            let bounds = [last - sign * 2e-6, last + sign * 1e-9];
            only(
                &format!("tail.{name}.{what}"),
                &moving(axis, sign * SPEED),
                bounds,
                |scene, bound| scene.axes[axis][end] = bound,
            );
        }
    }
}

#[test]
fn the_tips_speeds_in_a_tail_are_caught_alone() {
    let bounds = [0.99 * SPEED, SPEED];
    only(
        "tail.tip_speed",
        &moving(2, -SPEED),
        bounds,
        |scene, bound| {
            scene.tip_speed = bound;
        },
    );
    only(
        "tail.tip_angular_speed",
        &moving(ROLL, SPEED),
        bounds,
        |scene, bound| {
            scene.tip_angular_speed = bound;
        },
    );
}

#[test]
fn a_tail_that_leaves_or_enters_a_region_is_caught_alone() {
    let depth = HOME[2] - RCC_M + TOOL_M + WRIST_M;
    let last = -depth + WAY;
    only(
        "tail.workspace.control_point.z_max",
        &moving(2, -SPEED),
        [last - 2e-6, last + 1e-9],
        |scene, bound| scene.arms[0].high[2] = bound,
    );
    // The left finger opens towards x.
    let last = FINGER_M * ((HOME[6] + WAY) / 2.0).sin() + SHAFT_RADIUS_M;
    only(
        "tail.forbidden.wall.left_finger",
        &moving(6, SPEED),
        [last - 2e-6, last + 1e-9],
        |scene, bound| {
            scene.regions = format!(
                "[[forbidden]]\nname = \"wall\"\nshape = \"half_space\"\npoint_m = [{bound:?}, 0, 0]\nnormal = [-1, 0, 0]\n"
            );
        },
    );
}

#[test]
fn a_tail_that_is_not_its_commands_is_caught() {
    let scene = Scene::loose(1);
    let honest = moving(ROLL, SPEED);
    assert!(broken_by(&scene, &honest).is_empty());
    let changed = |change: &dyn Fn(&mut CommandSample, &mut SafeTail)| {
        let (mut told, mut tail) = honest;
        change(&mut told, &mut tail);
        broken_by(&scene, &(told, tail))
    };
    for (by, found) in [(2e-9, true), (5e-10, false)] {
        let expect = |name: &str| {
            if found {
                vec![name.to_owned()]
            } else {
                Vec::new()
            }
        };
        let start = changed(&|told, _| told.command.position[ROLL] += by);
        assert_eq!(start, expect("tail.roll.start_position"));
        let start = changed(&|told, _| told.command.velocity[ROLL] -= by);
        assert_eq!(start, expect("tail.roll.start_velocity"));
        let start = changed(&|told, _| told.command.acceleration[ROLL] = by);
        assert_eq!(start, expect("tail.roll.start_acceleration"));
        let rest = changed(&|told, tail| {
            told.command.velocity[ROLL] += by;
            tail.axes[ROLL].start.velocity += by;
        });
        assert_eq!(rest, expect("tail.roll.rest_velocity"));
        let rest = changed(&|_, tail| tail.axes[ROLL].phases[2].duration_s -= by / JERK);
        assert_eq!(rest, expect("tail.roll.rest_acceleration"));
    }
    let (told, _) = honest;
    let late = changed(&|_, tail| tail.stamp = TimeNs(told.command.stamp.0 + 1));
    assert_eq!(late, ["tail.stamp"]);
    let limp = changed(&|_, tail| tail.enabled = false);
    assert_eq!(limp, ["tail.enabled"]);
}

#[test]
fn a_tail_goes_on_where_it_is() {
    // Any command of a tail travels with the same tail, from the first to long after the last.
    let mut random = Random(31);
    let scene = Scene::loose(1);
    for _ in 0..100 {
        let mut tail = SafeTail::at_rest(TimeNs(5_000_000), &random.place(), true);
        for axis in &mut tail.axes {
            let velocity = random.between(-1.0, 1.0);
            axis.start.velocity = velocity;
            axis.phases = stop(
                velocity,
                random.between(1.0, 20.0),
                random.between(50.0, 500.0),
            );
        }
        for now in [5, 6, 29, 105, 400, 3000, 10_000] {
            let mut told = CommandSample::powered(now, &HOME);
            told.command = tail.command_at(TimeNs::from_tick(now));
            told.measured = Err(hal::ArmError::EndOfRecording);
            assert_eq!(broken_by(&scene, &(told, tail)), [""; 0], "{now} {tail:?}");
        }
    }
}

#[test]
fn a_tail_that_takes_too_long_is_caught_and_not_played() {
    let mut scene = Scene::loose(1);
    scene.axes[ROLL] = [-10.0, 10.0, SPEED, BRAKE, JERK];
    let longest_s = SPEED / BRAKE + 3.0 * BRAKE / JERK;
    let (told, mut tail) = moving(ROLL, SPEED);
    assert!(broken_by(&scene, &(told, tail)).is_empty());
    for (duration_s, found) in [(longest_s, false), (longest_s + 1e-6, true), (1e300, true)] {
        let told = CommandSample::powered(7, &HOME);
        tail.axes[ROLL] = AxisTail::at_rest(HOME[ROLL]);
        tail.axes[ROLL].phases[1].duration_s = duration_s;
        let expected = if found {
            vec!["tail.roll.duration"]
        } else {
            vec![]
        };
        assert_eq!(broken_by(&scene, &(told, tail)), expected);
    }
}

#[test]
fn nan_in_a_tail_is_caught_wherever_it_matters() {
    let scene = Scene::loose(1);
    for nonsense in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
        for number in 0..9 {
            let (told, mut tail) = moving(ROLL, SPEED);
            let AxisTail { start, phases } = &mut tail.axes[ROLL];
            let [first, second, third] = phases;
            *[
                &mut start.position,
                &mut start.velocity,
                &mut start.acceleration,
                &mut first.duration_s,
                &mut first.jerk,
                &mut second.duration_s,
                &mut second.jerk,
                &mut third.duration_s,
                &mut third.jerk,
            ][number] = nonsense;
            let found = broken_by(&scene, &(told, tail));
            assert!(
                found.iter().any(|limit| limit.starts_with("tail.roll.")),
                "{number}"
            );
        }
    }
}

#[test]
fn a_limp_arm_has_a_tail_that_rests() {
    let scene = Scene::loose(1);
    let told = CommandSample::limp(7, &HOME);
    let mut tail = SafeTail::at_rest(told.command.stamp, &HOME, false);
    assert!(broken_by(&scene, &(told, tail)).is_empty());
    tail.axes[ROLL].phases[0].duration_s = 0.1;
    assert_eq!(broken_by(&scene, &(told, tail)), ["tail.roll.duration"]);
    let tail = SafeTail::at_rest(told.command.stamp, &HOME, true);
    assert_eq!(broken_by(&scene, &(told, tail)), ["tail.enabled"]);
}

/// Two arms side by side, of which the first swings to the second and would stop.
fn two(gap_m: f64, yaw_velocity: f64) -> (Stream, [CommandSample; 2], [SafeTail; 2]) {
    let mut scene = Scene::loose(2);
    scene.arms[1].place = [0.06, 0.0, 0.0];
    scene.gaps_m = [gap_m, -1.0];
    let (told, tail) = moving(0, yaw_velocity);
    let rest = CommandSample::powered(7, &HOME);
    let stays = SafeTail::at_rest(rest.command.stamp, &HOME, true);
    (scene.stream(), [told, rest], [tail, stays])
}

#[test]
fn tails_that_bring_two_arms_too_near_are_caught_alone() {
    let gap = |yaw: f64| {
        let (mut stream, _, _) = two(-1.0, SPEED);
        let mut place = HOME;
        place[0] = yaw;
        let told = [
            CommandSample::powered(0, &place),
            CommandSample::powered(0, &HOME),
        ];
        stream.tick(0, &told.each_ref().map(CommandSample::pair));
        let shafts = stream
            .worst()
            .find(|worst| worst.limit == "between_arms.shaft.shaft");
        shafts.unwrap().value
    };
    // Towards the second arm, whichever way that is.
    let sign = if gap(WAY) < gap(-WAY) { 1.0 } else { -1.0 };
    let last = gap(sign * WAY);
    assert!(last < gap(0.0) - 0.002);
    let run = |gap_m: f64, sign: f64| {
        let (mut stream, told, tails) = two(gap_m, sign * SPEED);
        stream.tick(7, &told.each_ref().map(CommandSample::pair));
        stream.tails(&tails.each_ref());
        broken(&stream)
    };
    assert_eq!(run(last + 2e-6, sign), ["tail.between_arms.shaft.shaft"]);
    assert!(run(last - 1e-8, sign).is_empty());
    assert!(run(last + 2e-6, -sign).is_empty());
}

#[test]
fn a_missing_tail_and_one_too_many_are_caught() {
    for count in [0, 1, 3] {
        let (mut stream, told, [one, two]) = two(-1.0, SPEED);
        stream.tick(7, &told.each_ref().map(CommandSample::pair));
        stream.tails(&[&one, &two, &two][..count]);
        assert_eq!(broken(&stream), ["tail.missing"], "{count}");
    }
}

#[test]
fn an_arm_enabled_outside_has_a_tail_that_goes_back() {
    let mut scene = Scene::loose(1);
    scene.axes[2][3..].copy_from_slice(&[BRAKE, JERK]);
    // The control point at home is 1 mm too high.
    scene.arms[0].high[2] = -(HOME[2] - RCC_M + TOOL_M + WRIST_M) - 0.001;
    for (velocity, found) in [(0.01, false), (-0.001, false), (-0.01, true)] {
        let expected: &[&str] = if found {
            &["tail.workspace.control_point.z_max"]
        } else {
            &[]
        };
        assert_eq!(
            broken_by(&scene, &moving(2, velocity)),
            expected,
            "{velocity}"
        );
    }
}
