//! The velocity and the acceleration that travel with a setpoint: within their limits, and those of
//! the setpoints.

use core::f64::consts::TAU;

use super::scene::{CommandSample, HOME, NAMES, Scene, all_broken};
use crate::differences::AXES;

const TICKS: u32 = 200;

/// The commands of an honest sweep of `axis`: p = way (u - sin(2 pi u) / 2 pi), with its
/// derivatives.
fn sweep(axis: usize, way: f64) -> Vec<CommandSample> {
    let seconds = f64::from(TICKS) * 1e-3;
    (0..TICKS + 5)
        .map(|tick| {
            let u = (f64::from(tick) / f64::from(TICKS)).min(1.0);
            let mut place: [f64; AXES] = HOME;
            place[axis] += way * (u - (TAU * u).sin() / TAU);
            let mut told = CommandSample::powered(u64::from(tick), &place);
            let velocity = way / seconds * (1.0 - (TAU * u).cos());
            match told.command.velocity.get_mut(axis) {
                Some(joint) => {
                    *joint = velocity;
                    let acceleration = way / seconds.powi(2) * TAU * (TAU * u).sin();
                    told.command.acceleration[axis] = acceleration;
                }
                None => told.command.jaw_velocity = velocity,
            }
            told
        })
        .collect()
}

/// What is broken when the motion of `axis` has hardly more than the jerk that it needs, after
/// `change`.
fn broken_by(axis: usize, change: impl Fn(&mut Vec<CommandSample>)) -> Vec<String> {
    let way = 0.03;
    let mut scene = Scene::loose(1);
    scene.axes[axis][4] = 1.001 * TAU * TAU * way / (f64::from(TICKS) * 1e-3).powi(3);
    let mut told = sweep(axis, way);
    change(&mut told);
    let mut stream = scene.stream();
    for (tick, told) in (0..).zip(&told) {
        stream.tick(tick, &[told.pair()]);
    }
    all_broken(&stream)
}

#[test]
fn honest_rates_break_nothing() {
    for axis in 0..AXES {
        assert!(broken_by(axis, |_| ()).is_empty(), "{axis}");
    }
}

#[test]
fn rates_that_are_not_those_of_the_setpoints_are_caught() {
    for (axis, name) in NAMES.iter().enumerate() {
        let expected = |what: &str| format!("{name}.{what}_mismatch");
        let found = broken_by(axis, |told| match told[60].command.velocity.get_mut(axis) {
            Some(joint) => *joint *= 1.02,
            None => told[60].command.jaw_velocity *= 1.02,
        });
        assert!(found.contains(&expected("velocity")), "{found:?}");
        if axis < AXES - 1 {
            let found = broken_by(axis, |told| {
                told[60].command.acceleration[axis] *= 1.2;
            });
            assert_eq!(found, [expected("acceleration")]);
            let none = broken_by(axis, |told| {
                for told in told {
                    told.command.acceleration[axis] = 0.0;
                }
            });
            assert_eq!(none, [expected("acceleration")]);
        }
    }
}

#[test]
fn acceleration_over_limit_or_without_torque_is_caught() {
    let mut scene = Scene::loose(1);
    scene.axes[1][3] = 2.0;
    let mut told = CommandSample::powered(0, &HOME);
    told.command.acceleration[1] = -2.1;
    let mut stream = scene.stream();
    stream.tick(0, &[told.pair()]);
    assert_eq!(all_broken(&stream), ["pitch.commanded_acceleration"]);
    for bad in [f64::NAN, 1e-6] {
        let mut told = CommandSample::limp(0, &HOME);
        told.command.acceleration[4] = bad;
        let mut stream = scene.stream();
        stream.tick(0, &[told.pair()]);
        assert_eq!(all_broken(&stream), ["wrist_pitch.disabled_acceleration"]);
    }
}

#[test]
fn a_clock_that_stands_or_goes_back_is_caught() {
    let scene = Scene::loose(1);
    let run = |times: &[u64], gap_before: Option<usize>| {
        let mut stream = scene.stream();
        for (index, (&at, tick)) in times.iter().zip(0..).enumerate() {
            let told = CommandSample::powered(at, &HOME);
            if gap_before == Some(index) {
                stream.missing(tick, 5);
            }
            stream.tick(tick, &[told.pair()]);
            stream.clock(told.command.stamp);
        }
        all_broken(&stream)
    };
    assert!(run(&[0, 1, 2, 5, 6], None).is_empty());
    let back = ["clock_ns", "stamp"];
    assert_eq!(run(&[0, 1, 2, 2], None), back);
    assert_eq!(run(&[5, 6, 2, 3], None), back);
    // Nor over ticks that are missing.
    assert_eq!(run(&[5, 6, 12, 13], Some(2)), ["missing_ticks"]);
    let over = ["clock_ns", "missing_ticks", "stamp"];
    assert_eq!(run(&[5, 6, 2, 3], Some(2)), over);
    // A tick's time is its commands'.
    let mut stream = scene.stream();
    let told = CommandSample::powered(4, &HOME);
    stream.tick(4, &[told.pair()]);
    stream.clock(hal::TimeNs::from_tick(5));
    assert_eq!(all_broken(&stream), ["clock_ns"]);
}
