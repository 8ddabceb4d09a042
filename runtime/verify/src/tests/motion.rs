//! Every limit on how axes and tip move, broken by a motion whose extremes are known in closed
//! form, and kept by the same motion under a bound a little wider.

use core::f64::consts::{PI, TAU};

use hal::psm::{RCC_M, TOOL_M, WRIST_M};

use super::scene::{CommandSample, HOME, NAMES, Scene, broken};
use crate::differences::AXES;

/// How long a sweep takes, in ticks and s.
const TICKS: u32 = 200;
const SECONDS: f64 = 0.2;

/// From home by `way` along one axis and rest there: p = way (u - sin(2 pi u) / 2 pi).
fn sweep(axis: usize, way: f64) -> Vec<[f64; AXES]> {
    (0..TICKS + 5)
        .map(|tick| {
            let u = (f64::from(tick) / f64::from(TICKS)).min(1.0);
            let mut place = HOME;
            place[axis] += way * (u - (TAU * u).sin() / TAU);
            place
        })
        .collect()
}

/// The greatest velocity, acceleration and jerk of a sweep.
fn peaks(way: f64) -> [f64; 3] {
    let way = way.abs();
    [
        2.0 * way / SECONDS,
        TAU * way / SECONDS.powi(2),
        4.0 * PI * PI * way / SECONDS.powi(3),
    ]
}

/// That only `name` is broken if the bound is a hundredth inside the peak, and nothing if it is
/// outside.
fn only(name: &str, peak: f64, places: &[[f64; AXES]], set: impl Fn(&mut Scene, f64)) {
    let broken_at = |bound| {
        let mut scene = Scene::loose(1);
        set(&mut scene, bound);
        scene.broken_by(places)
    };
    assert_eq!(broken_at(0.99 * peak), [name], "{peak}");
    assert!(broken_at(1.0001 * peak).is_empty(), "{name} {peak}");
}

#[test]
fn every_derivative_of_every_axis_is_caught_alone() {
    for (axis, name) in NAMES.iter().enumerate() {
        for way in [0.03, -0.03] {
            let orders = ["velocity", "acceleration", "jerk"].into_iter().enumerate();
            for ((order, what), peak) in orders.zip(peaks(way)) {
                only(
                    &format!("{name}.{what}"),
                    peak,
                    &sweep(axis, way),
                    |scene, bound| scene.axes[axis][2 + order] = bound,
                );
            }
        }
    }
}

#[test]
fn both_ends_of_every_range_are_caught_alone() {
    for (axis, name) in NAMES.iter().enumerate() {
        for (way, end, what) in [(-0.03, 0, "low"), (0.03, 1, "high")] {
            let places = sweep(axis, way);
            let broken_by = |slack: f64| {
                let mut scene = Scene::loose(1);
                scene.axes[axis][end] = HOME[axis] + way + slack * way.signum();
                scene.broken_by(&places)
            };
            assert_eq!(broken_by(-2e-6), [format!("{name}.{what}")]);
            assert!(broken_by(1e-9).is_empty(), "{name} {what}");
        }
    }
}

#[test]
fn the_velocity_that_goes_to_the_drives_is_caught_alone() {
    for (axis, name) in NAMES.iter().enumerate() {
        let broken_at = |velocity: f64| {
            let mut scene = Scene::loose(1);
            scene.axes[axis][2] = 0.5;
            let mut stream = scene.stream();
            for tick in 0..5 {
                let mut told = CommandSample::powered(tick, &HOME);
                match told.command.velocity.get_mut(axis) {
                    Some(joint) => *joint = velocity,
                    None => told.command.jaw_velocity = velocity,
                }
                stream.tick(tick, &[told.pair()]);
            }
            broken(&stream)
        };
        assert_eq!(broken_at(-0.50001), [format!("{name}.commanded_velocity")]);
        assert!(broken_at(-0.5).is_empty());
    }
}

#[test]
fn the_tips_speed_is_caught_alone() {
    let tip_speed = |scene: &mut Scene, bound: f64| scene.tip_speed = bound;
    // The insertion moves the tip as it moves; the yaw swings all that is beyond the remote centre.
    only("tip_speed", peaks(0.03)[0], &sweep(2, 0.03), tip_speed);
    let depth = HOME[2] - RCC_M + TOOL_M + WRIST_M;
    let swing = depth * peaks(0.03)[0];
    only("tip_speed", swing, &sweep(0, 0.03), tip_speed);
    // The wrist pitch bends it about a point nearer by.
    let bend = WRIST_M * peaks(0.3)[0];
    only("tip_speed", bend, &sweep(4, 0.3), tip_speed);
}

#[test]
fn the_tips_angular_speed_is_caught_alone() {
    // From home each of these turns the tip by as much as it turns itself; the insertion and the
    // jaw do not turn it.
    for axis in [0, 1, 3, 4, 5] {
        only(
            "tip_angular_speed",
            peaks(0.3)[0],
            &sweep(axis, 0.3),
            |scene, bound| scene.tip_angular_speed = bound,
        );
    }
    for axis in [2, 6] {
        let mut scene = Scene::loose(1);
        scene.tip_angular_speed = 1e-9;
        assert!(scene.broken_by(&sweep(axis, 0.03)).is_empty());
    }
}

#[test]
fn a_limp_arm_that_is_told_to_move_is_caught() {
    for (axis, name) in NAMES.iter().enumerate() {
        let run = |offset: f64, velocity: f64| {
            let mut stream = Scene::loose(1).stream();
            for tick in 0..5 {
                let mut told = CommandSample::limp(tick, &HOME);
                let command = &mut told.command;
                match command.position.get_mut(axis) {
                    Some(joint) => *joint += offset,
                    None => command.jaw_position += offset,
                }
                match command.velocity.get_mut(axis) {
                    Some(joint) => *joint = velocity,
                    None => command.jaw_velocity = velocity,
                }
                stream.tick(tick, &[told.pair()]);
            }
            broken(&stream)
        };
        for sign in [1.0, -1.0] {
            let place = run(sign * 2e-9, 0.0);
            assert_eq!(place, [format!("{name}.disabled_position")]);
            let speed = run(0.0, sign * 2e-9);
            assert_eq!(speed, [format!("{name}.disabled_velocity")]);
        }
        assert!(run(0.0, 0.0).is_empty());
    }
}

#[test]
fn the_worst_of_every_limit_is_told_with_its_tick() {
    let mut scene = Scene::loose(1);
    scene.axes[3][2] = 1.0;
    let mut stream = scene.stream();
    for (place, tick) in sweep(3, 0.03).iter().zip(0..) {
        stream.tick(tick, &[CommandSample::powered(tick, place).pair()]);
    }
    let worst: Vec<_> = stream.worst().collect();
    let of = |name: &str| worst.iter().find(|worst| worst.limit == name).unwrap();
    let velocity = of("roll.velocity");
    assert!((velocity.value - 0.3).abs() < 1e-4 && (velocity.margin - 0.7).abs() < 1e-4);
    assert!((99..=101).contains(&velocity.tick) && velocity.broken == 0);
    let high = of("roll.high");
    assert!((high.value - 0.03).abs() < 1e-12 && (high.margin - 9.97).abs() < 1e-12);
    assert_eq!(stream.violation_count(), 0);
}
