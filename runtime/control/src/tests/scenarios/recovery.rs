//! Bad starts, sudden starts, and limits that are lowered under way.

use hal::{ArmState, TimeNs};
use nalgebra::Vector3;

use super::{follow, home_m, least_clearance, target, tip_m};
use crate::OperatorEvent;
use crate::config::ControlConfig;
use crate::motion::{AXES, Axes, JAW};
use crate::tests::adversary::eyes::Boundary;
use crate::tests::adversary::judge::Oracle;
use crate::tests::adversary::rig::{Rig, Scene, axes_of, home, resting};
use trocar_verify::tip_in_rcm;

/// Where an arm is found, and which boundary it is beyond.
fn bad_starts() -> Vec<(&'static str, ArmState, Boundary)> {
    let start = |changes: &[(usize, f64)]| {
        let mut axes = axes_of(&home());
        for &(axis, value) in changes {
            axes[axis] = value;
        }
        resting(TimeNs(0), &axes)
    };
    let region = |region, link| Boundary::Region {
        arm: 0,
        region,
        link,
    };
    let axis = |axis, high| Boundary::Axis { arm: 0, axis, high };
    vec![
        ("the shaft in the rib", start(&[(1, 0.31)]), region(2, 0)),
        (
            "a finger in the vessel",
            start(&[(1, -0.36), (2, 0.118)]),
            region(0, 3),
        ),
        (
            "the wrist behind the wall",
            start(&[(0, 0.6)]),
            region(3, 1),
        ),
        (
            "the tip in the retractor",
            start(&[(0, -0.31), (1, -0.17), (2, 0.128)]),
            region(4, 1),
        ),
        ("a wrist turned too far", start(&[(4, 1.39)]), axis(4, true)),
        (
            "the jaw too far open",
            start(&[(JAW, 1.39)]),
            axis(JAW, true),
        ),
        ("the roll too far", start(&[(3, -4.53)]), axis(3, false)),
        (
            "the fingers in the floor",
            start(&[(2, 0.156)]),
            Boundary::Workspace {
                arm: 0,
                point: 1,
                axis: 2,
                high: false,
            },
        ),
    ]
}

/// On the way from home to `start`, where the boundary is passed by 2 mm (0.002 rad) or, if it
/// never is, the end.
fn beyond(config: &ControlConfig, start: &ArmState, boundary: Boundary) -> ArmState {
    let (from, to) = (axes_of(&home()), axes_of(start));
    (0..=1000)
        .map(|step| f64::from(step) / 1000.0)
        .map(|share| core::array::from_fn(|axis| from[axis] + share * (to[axis] - from[axis])))
        .find(|axes| boundary.clearance(config, &[*axes]) <= -0.002)
        .map_or(*start, |axes| resting(TimeNs(0), &axes))
}

#[test]
fn from_a_bad_start_it_only_gets_better() {
    let scene = Scene::crowded().open_gate();
    let config = &scene.config;
    for (name, start, boundary) in bad_starts() {
        for outward in [true, false] {
            let mut rig = Rig::<1>::new(config);
            rig.arms = [beyond(config, &start, boundary)];
            let mut judge = Oracle::new(&scene);
            let positions = rig.positions();
            let at_start = boundary.clearance(config, &positions);
            assert!(at_start < 0.0, "{name} is none: {at_start}");
            let measured = rig.arms.map(Ok);
            let outputs = rig.step(measured, [Some(OperatorEvent::Enable)]);
            judge.look(&measured, &outputs);
            // Home, or as much further in as the way from there was.
            let home_m = home_m();
            let away_m = tip_m(&positions[0]) - home_m;
            let path = |_: usize, _: f64| {
                let place_m = if outward {
                    home_m
                } else {
                    home_m + away_m * 2.0
                };
                let mut goal = target(place_m, Vector3::new(0.0, 0.0, 0.0));
                goal.jaw = if outward { 0.2 } else { 3.0 };
                goal
            };
            let mut least = at_start;
            let mut before = rig.arms;
            follow(&mut rig, 4.0, path, |rig, outputs| {
                judge.look(&before.map(Ok), outputs);
                judge.follow_tails(outputs);
                before = rig.arms;
                least = least.min(boundary.clearance(config, &rig.positions()));
            });
            let at_end = boundary.clearance(config, &rig.positions());
            println!(
                "{name}, {}: from {at_start:.5}, least {least:.5}, at the end {at_end:.5}",
                if outward { "out" } else { "further in" }
            );
            assert!(
                least >= at_start - config.margins.recovery_m,
                "{name}: {least}"
            );
            assert!(!outward || at_end > 0.0, "{name}: still at {at_end}");
            let violations = judge.violations(false);
            assert!(violations.is_empty(), "{name}: {violations:#?}");
        }
    }
}

#[test]
fn the_first_chunk_far_away_makes_no_jump() {
    let scene = Scene::crowded().open_gate();
    let config = &scene.config;
    let mut rig = Rig::<1>::enabled(config);
    let ramp_s = TimeNs(config.soft_start_ns).seconds();
    let path = |_: usize, _: f64| target(home_m() + Vector3::new(0.03, 0.02, -0.02), Vector3::x());
    let mut before = rig.arms[0];
    let (mut first_m, mut most, mut fastest) = (0.0_f64, 0.0_f64, 0.0_f64);
    follow(&mut rig, 2.0, path, |rig, _| {
        let way_m = (tip_in_rcm(&rig.arms[0].position).translation.vector
            - tip_in_rcm(&before.position).translation.vector)
            .norm();
        if rig.tick == 2 {
            first_m = way_m;
        }
        let pace = 0.1 + 0.9 * (rig.now().seconds() / ramp_s).min(1.0);
        let share = way_m / 1e-3 / config.tip_speed_m_s;
        fastest = fastest.max(share);
        most = most.max(share / pace);
        before = rig.arms[0];
    });
    println!(
        "soft start: first tick {first_m:.1e} m, at most {most:.3} of the pace, up to {fastest:.3} of the speed"
    );
    // What the jerk limits allow within a tick.
    assert!(first_m <= 1e-7, "{first_m}");
    assert!(most <= 1.0, "{most}");
    assert!(fastest > 0.5, "{fastest}");
}

#[test]
fn limits_lowered_while_moving_are_kept_without_an_excursion() {
    let scene = Scene::crowded().open_gate();
    let config = &scene.config;
    for percent in [60_u8, 20, 5, 0] {
        let mut rig = Rig::<1>::enabled(config);
        let mut judge = Oracle::new(&scene);
        // Back and forth, turning, as fast as it can; the limits fall after 1.15 s, in full motion.
        let path = |_: usize, time_s: f64| {
            let side = if (time_s * 1.25).fract() < 0.5 {
                1.0
            } else {
                -1.0
            };
            target(
                home_m() + Vector3::new(0.02 * side, 0.008 * side, 0.0),
                Vector3::new(0.0, 0.0, 0.9 * side),
            )
        };
        let mut before = rig.arms;
        follow(&mut rig, 1.15, path, |rig, outputs| {
            judge.look(&before.map(Ok), outputs);
            before = rig.arms;
        });
        let measured = rig.arms.map(Ok);
        let outputs = rig.step(measured, [Some(OperatorEvent::Speed { percent })]);
        judge.look(&measured, &outputs);
        let share = f64::from(percent) / 100.0;
        let speeds = |arm: &ArmState| -> Axes {
            core::array::from_fn(|axis| {
                let v = arm.velocity.get(axis).copied().unwrap_or(arm.jaw_velocity);
                v.abs() / config.axes[axis].velocity
            })
        };
        let moving: f64 = speeds(&rig.arms[0]).into_iter().fold(0.0, f64::max);
        let mut before = rig.arms;
        let start_s = rig.now().seconds();
        // A speed above the new limit falls; one below it never passes it.
        let mut highest: Axes = [f64::INFINITY; AXES];
        let (mut rise, mut late, mut place_m) = (0.0_f64, 0.0_f64, f64::INFINITY);
        follow(&mut rig, 1.5, path, |rig, outputs| {
            judge.look(&before.map(Ok), outputs);
            before = rig.arms;
            let now = speeds(&rig.arms[0]);
            let since_s = rig.now().seconds() - start_s;
            for axis in 0..AXES {
                // The acceleration that there was is let go first.
                if since_s > 0.06 {
                    rise = rise.max(now[axis] - highest[axis].max(share));
                    highest[axis] = highest[axis].min(now[axis]).max(share);
                }
                if since_s > 0.4 {
                    late = late.max(now[axis]);
                }
            }
            place_m = place_m.min(least_clearance(config, &rig.positions()));
        });
        println!(
            "limits to {percent} % at {moving:.2} of a speed limit: rise {rise:.1e}, after 0.4 s at most {late:.3}, nearest {:.3} mm",
            1e3 * place_m
        );
        assert!(moving > 0.3, "{moving}");
        assert!(rise <= 1e-6, "{rise}");
        assert!(late <= share + 1e-6, "{late}");
        let violations = judge.violations(false);
        assert!(violations.is_empty(), "{violations:#?}");
    }
}
