//! How well the commanded tip follows, and that it stops where it should.

use core::f64::consts::TAU;

use hal::TipTarget;
use nalgebra::Vector3;

use super::{Bench, config, pose};
use crate::config::ControlConfig;
use crate::{CommandHash, QpOutcome};
use hal::config::Source;

/// Runs `seconds` with a fresh chunk of `path` every step; calls `look` after each tick with the
/// wanted target.
fn follow(
    bench: &mut Bench,
    seconds: u32,
    path: impl Fn(f64) -> TipTarget,
    mut look: impl FnMut(&Bench, &super::TickOutput, TipTarget),
) {
    let mut chunk = bench.chunk_along(&path);
    for tick in 0..u64::from(seconds) * 1000 {
        if tick % 40 == 0 {
            chunk = bench.chunk_along(&path);
        }
        let output = bench.step(Some(&chunk), None);
        look(bench, &output, path(bench.now().seconds()));
    }
}

/// A circle at 40 mm/s with a slow turn of the tool and the jaw.
fn circle(time_s: f64) -> TipTarget {
    let blend = (time_s / 0.5).min(1.0).powi(2);
    let angle = 0.04 / 0.02 * time_s;
    let (x, y) = (
        0.02 * blend * angle.sin(),
        0.02 * blend * (angle.cos() - 1.0),
    );
    let turn = Vector3::new(
        0.3 * (0.5 * angle).sin() * blend,
        0.2 * (0.5 * angle).sin() * blend,
        0.4 * angle.sin() * blend,
    );
    TipTarget::new(&pose(x, y, -0.12, turn), 0.2 + 0.2 * (angle.sin() * blend))
}

/// A circle at 40 mm s is followed within a millimetre and no QP.
#[test]
fn circle_at_40_mm_s_is_followed_within_1_mm() {
    let mut bench = Bench::enabled(&config());
    let (mut lag_m, mut off_rad, mut solved) = (0.0_f64, 0.0_f64, 0);
    follow(&mut bench, 8, circle, |bench, output, wanted| {
        let (is, wanted) = (bench.tip(), wanted.tip_in_rcm());
        if bench.now().seconds() > 1.0 {
            lag_m = lag_m.max((is.translation.vector - wanted.translation.vector).norm());
            off_rad = off_rad.max(is.rotation.angle_to(&wanted.rotation));
        }
        solved += u32::from(output.report.qp != QpOutcome::NotNeeded);
        assert!(
            !output.report.guard_intervened,
            "at {}",
            bench.now().seconds()
        );
        assert!(output.report.fault.is_none());
    });
    println!(
        "circle: lag {:.3} mm, {:.4} rad, QP in {solved} ticks",
        lag_m * 1e3,
        off_rad
    );
    assert!(
        lag_m < 1e-3 && off_rad < 0.03,
        "lag {lag_m} m, {off_rad} rad"
    );
    assert_eq!(solved, 0);
}

/// A far target is reached without overshoot and without a limit cycle.
#[test]
fn far_target_is_reached_without_overshoot() {
    let mut bench = Bench::enabled(&config());
    let goal = TipTarget::new(
        &pose(0.03, -0.02, -0.125, Vector3::new(0.2, -0.3, 0.5)),
        0.6,
    );
    let (mut beyond_m, mut last_speed) = (0.0_f64, 0.0_f64);
    let goal_m = Vector3::from(goal.position_m);
    let start_m = bench.tip().translation.vector;
    let direction = (goal_m - start_m).normalize();
    follow(
        &mut bench,
        4,
        |_| goal,
        |bench, output, _| {
            beyond_m = beyond_m.max((bench.tip().translation.vector - goal_m).dot(&direction));
            if bench.now().seconds() > 3.0 {
                last_speed = last_speed.max(output.command.velocity.amax());
            }
        },
    );
    let rest = bench.tip();
    let error_m = (rest.translation.vector - goal_m).norm();
    println!(
        "far target: error {error_m:e} m, beyond {beyond_m:e} m, speed after 3 s {last_speed:e}"
    );
    assert!(error_m < 1e-6 && rest.rotation.angle_to(&goal.tip_in_rcm().rotation) < 1e-5);
    assert!(beyond_m < 2e-5, "overshoot {beyond_m} m");
    assert!(last_speed < 1e-4, "still moving at {last_speed}");
    assert!((bench.arm.jaw_position - 0.6).abs() < 1e-6);
}

#[test]
fn a_target_that_stops_dead_is_hardly_overshot() {
    let mut bench = Bench::enabled(&config());
    let path = |time_s: f64| {
        TipTarget::new(
            &pose(0.04 * time_s.min(0.8), 0.0, -0.1135, Vector3::zeros()),
            0.2,
        )
    };
    let mut beyond_m = 0.0_f64;
    follow(&mut bench, 2, path, |bench, _, _| {
        beyond_m = beyond_m.max(bench.tip().translation.x - 0.032);
    });
    println!("dead stop from 40 mm/s: {:.3} mm beyond", beyond_m * 1e3);
    assert!(beyond_m < 1e-3, "overshoot {beyond_m} m");
    assert!((bench.tip().translation.x - 0.032).abs() < 1e-5);
}

#[test]
fn a_target_beyond_the_wall_stops_at_the_wall() {
    let config = config();
    let mut bench = Bench::enabled(&config);
    // 20 mm below the floor for the finger tips, and sideways at the same time.
    let path = |time_s: f64| {
        let down_m = 0.06 * (time_s / 2.0).min(1.0);
        TipTarget::new(
            &pose(
                0.02 * (TAU * time_s / 4.0).sin(),
                0.0,
                -0.1135 - down_m,
                Vector3::zeros(),
            ),
            0.2,
        )
    };
    let workspace = config.arms[0].workspace;
    let floor_m = workspace.center_m.z - workspace.half_m.z;
    let (mut lowest_m, mut widest_m, mut solved, mut failed, mut stopped) =
        (0.0_f64, 0.0_f64, 0, 0, 0);
    follow(&mut bench, 8, path, |bench, output, _| {
        let frames = crate::kinematics::Frames::at(&bench.arm.position);
        lowest_m = lowest_m.min(frames.finger_m.z);
        if bench.now().seconds() > 4.0 {
            widest_m = widest_m.max(frames.tip_m.x.abs());
        }
        match output.report.qp {
            QpOutcome::NotNeeded => {}
            QpOutcome::Solved { .. } => solved += 1,
            QpOutcome::Failed => failed += 1,
        }
        stopped += u32::from(output.report.guard_intervened);
    });
    let left_m = lowest_m - floor_m;
    println!(
        "wall: {:.3} mm left, slides {widest_m}, solved {solved}, failed {failed}, guard {stopped}",
        left_m * 1e3
    );
    assert!(
        left_m > config.margins.guard_m && left_m < config.margins.filter_m + 5e-4,
        "{left_m}"
    );
    assert!(
        solved > 3000 && failed == 0,
        "solved {solved}, failed {failed}"
    );
    // Tangential motion goes on along the wall: the target's direction from the remote centre is
    // kept, at the wall's depth.
    assert!(widest_m > 0.016, "stuck at {widest_m}");
    assert!(stopped < 80, "guard intervened {stopped} times");
}

#[test]
fn the_forbidden_sphere_is_passed_by() {
    let config = config();
    let mut bench = Bench::enabled(&config);
    let vessel = config.arms[0].forbidden[0].shape;
    // Straight at the vessel's middle.
    let path = |time_s: f64| {
        let part = (time_s / 3.0).min(1.0);
        TipTarget::new(
            &pose(0.0, 0.045 * part, -0.1135 - 0.025 * part, Vector3::zeros()),
            0.2,
        )
    };
    let mut nearest_m = f64::INFINITY;
    let mut failed = 0;
    follow(&mut bench, 5, path, |bench, output, _| {
        let frames = crate::kinematics::Frames::at(&bench.arm.position);
        for point in [frames.wrist_m, frames.tip_m, frames.finger_m] {
            let centre_line_m = vessel.nearest(&point, &point).distance_m;
            nearest_m = nearest_m.min(centre_line_m - hal::psm::SHAFT_RADIUS_M);
        }
        failed += u32::from(output.report.qp == QpOutcome::Failed);
    });
    println!(
        "vessel: nearest {:.3} mm, QP failed {failed}",
        nearest_m * 1e3
    );
    assert!(
        nearest_m > config.margins.guard_m && nearest_m < 0.004,
        "{nearest_m}"
    );
    assert_eq!(failed, 0);
}

/// Without chunks the arm holds and after the last one it comes to rest.
#[test]
fn arm_rests_after_its_last_chunk() {
    let mut bench = Bench::enabled(&config());
    let before = bench.arm.position;
    for _ in 0..100 {
        bench.step(None, None);
    }
    assert_eq!(bench.arm.position, before);
    let mut chunk = bench.chunk_along(|time_s| {
        TipTarget::new(
            &pose(0.04 * (time_s - 0.1), 0.0, -0.1135, Vector3::zeros()),
            0.2,
        )
    });
    chunk.len = 10;
    for _ in 0..360 {
        bench.step(Some(&chunk), None);
    }
    assert!(bench.controller.mode().busy);
    for _ in 0..250 {
        bench.step(Some(&chunk), None);
    }
    assert!(!bench.controller.mode().busy);
    assert!(bench.arm.velocity.amax() < 1e-9);
}

#[test]
fn the_same_inputs_give_the_same_hash_and_others_another() {
    let run = |radius_scale: f64| -> CommandHash {
        let mut bench = Bench::enabled(&config());
        let path = |time_s: f64| {
            let mut target = circle(time_s);
            target.position_m[2] -= 0.035 * radius_scale * (time_s / 2.0).min(1.0);
            target
        };
        let mut solved = 0;
        follow(&mut bench, 3, path, |_, output, _| {
            solved += u32::from(output.report.qp != QpOutcome::NotNeeded)
        });
        assert!(solved > 100, "the QP takes part: {solved}");
        bench.hash
    };
    assert_eq!(run(1.0), run(1.0));
    assert_ne!(run(1.0), run(1.0 + 1e-9));
}

#[test]
fn every_aggregation_follows_the_circle() {
    for mode in ["ensemble", "whole_chunk", "newest"] {
        let control = ControlConfig::default_control();
        let text = control
            .text()
            .replace("mode = \"ensemble\"", &format!("mode = \"{mode}\""));
        let control = Source::embedded("control.toml", &text);
        let config = ControlConfig::load(&control, &ControlConfig::needle_lift_safety()).unwrap();
        let mut bench = Bench::enabled(&config);
        let mut lag_m = 0.0_f64;
        follow(&mut bench, 6, circle, |bench, _, wanted| {
            if bench.now().seconds() > 1.0 {
                lag_m = lag_m.max(
                    (bench.tip().translation.vector - Vector3::from(wanted.position_m)).norm(),
                );
            }
        });
        // A whole chunk slows down before its end, where it cannot know that another one follows.
        assert!(
            lag_m < if mode == "whole_chunk" { 1.5e-3 } else { 1e-3 },
            "{mode}: {lag_m} m"
        );
    }
}
