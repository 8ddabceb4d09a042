//! How long the guard takes; only of use in release, and run by name.

use super::two_arms::{APART_M, towards};
use super::{Rig, config, config_with, home, shapes, two_arms};
use crate::guard::Request;

/// Median, 99th percentile and maximum of the guard's part of a tick under garbage, us.
#[expect(clippy::disallowed_methods, reason = "this measures time")]
fn measure<const ARMS: usize>(
    rig: &mut Rig<ARMS>,
    ticks: usize,
    push: impl Fn(&mut Rig<ARMS>),
) -> [f64; 3] {
    let mut times_us = Vec::with_capacity(ticks);
    for _ in 0..ticks {
        rig.shuffle();
        push(rig);
        let requests = rig.candidates().map(Request::Follow);
        let start = std::time::Instant::now();
        let decisions = rig.guard.next(&rig.states, &requests);
        times_us.push(start.elapsed().as_secs_f64() * 1e6);
        rig.states = decisions.map(|decision| decision.state);
    }
    times_us.sort_by(f64::total_cmp);
    [
        times_us[ticks / 2],
        times_us[ticks * 99 / 100],
        times_us[ticks - 1],
    ]
}

#[test]
#[ignore = "a measurement"]
#[expect(clippy::print_stdout, reason = "this reports a measurement")]
fn how_long_the_guard_takes() {
    let mut lines = Vec::new();
    let mut rig = Rig::new(config(), [home()], 90);
    lines.push(("one arm, one region", measure(&mut rig, 50_000, |_| ())));
    let mut eight = shapes().to_vec();
    eight.extend(shapes());
    let mut rig = Rig::new(config_with(&eight), [home()], 91);
    lines.push(("one arm, eight regions", measure(&mut rig, 50_000, |_| ())));
    let mut rig = Rig::new(two_arms(0.14), [home(); 2], 92);
    lines.push(("two arms apart", measure(&mut rig, 50_000, |_| ())));
    let mut rig = Rig::new(two_arms(APART_M), [home(); 2], 93);
    let push = |rig: &mut Rig<2>| {
        for arm in 0..2 {
            rig.velocity[arm][0] = towards(rig, arm);
        }
    };
    lines.push((
        "two arms pushed at each other",
        measure(&mut rig, 50_000, push),
    ));
    for (name, [median, high, most]) in lines {
        println!("{name}: p50 {median:.1} us, p99 {high:.1} us, max {most:.1} us");
    }
}
