//! Two arms that want to be where the other one is.

use nalgebra::{Point3, Vector3};

use super::{follow, target};
use crate::QpOutcome;
use crate::tests::adversary::eyes::Boundary;
use crate::tests::adversary::judge::Oracle;
use crate::tests::adversary::rig::{Rig, Scene};

/// Shafts and tips, the least gap beyond the one that is kept, m.
fn gap_m(scene: &Scene, rig: &Rig<2>) -> f64 {
    Boundary::all(&scene.config)
        .into_iter()
        .filter(|boundary| matches!(boundary, Boundary::Shafts | Boundary::ToShaft { .. }))
        .map(|boundary| boundary.clearance(&scene.config, &rig.positions()))
        .fold(f64::INFINITY, f64::min)
}

#[test]
fn two_arms_pushed_through_each_other_stay_apart() {
    let scene = Scene::handover().open_gate();
    let config = &scene.config;
    for height_m in [0.0, 0.01, 0.02] {
        let mut rig = Rig::<2>::enabled(config);
        let mut judge = Oracle::new(&scene);
        // Each goes straight through the other one's place to the far side and back, within 3 s.
        let path = |arm: usize, time_s: f64| {
            let side = if arm == 0 { 1.0 } else { -1.0 };
            let sway = (core::f64::consts::TAU * time_s / 6.0).sin();
            let in_scene = Point3::new(
                side * (-0.012 + 0.045 * sway),
                0.004 * side,
                0.015 + height_m,
            );
            let in_rcm = config.arms[arm].scene_from_rcm.inverse() * in_scene;
            target(in_rcm.coords, Vector3::zeros())
        };
        let (mut least_m, mut failed, mut pressed, mut stopped) =
            (f64::INFINITY, 0_u32, 0_u32, 0_u32);
        let mut before = rig.arms;
        follow(&mut rig, 12.0, path, |rig, outputs| {
            judge.look(&before.map(Ok), outputs);
            if rig.tick % 7 == 0 {
                judge.follow_tails(outputs);
                least_m = least_m.min(gap_m(&scene, rig));
            }
            before = rig.arms;
            for output in outputs {
                failed += u32::from(output.report.qp == QpOutcome::Failed);
                pressed += u32::from(output.report.correction > 1e-6);
                stopped += u32::from(output.report.guard_intervened);
            }
        });
        println!(
            "through each other, {height_m} m up: gap {:.3} mm beyond what is kept, filter in {pressed}, no answer {failed}, guard {stopped} of 24000",
            1e3 * least_m
        );
        let violations = judge.violations(false);
        assert!(violations.is_empty(), "{violations:#?}");
        assert!(
            least_m >= config.margins.guard_m && least_m < 0.004,
            "{least_m}"
        );
        assert!(pressed > 2_000, "{pressed}");
        assert_eq!(failed, 0);
    }
}

#[test]
fn one_arm_pushed_into_a_resting_one_stays_away() {
    let scene = Scene::handover().open_gate();
    let config = &scene.config;
    let mut rig = Rig::<2>::enabled(config);
    let mut judge = Oracle::new(&scene);
    let path = |arm: usize, time_s: f64| {
        let in_scene = if arm == 0 {
            Point3::new(-0.012 + 0.04 * (time_s / 2.0).min(1.0), 0.0, 0.04)
        } else {
            Point3::new(0.012, 0.0, 0.015)
        };
        let in_rcm = config.arms[arm].scene_from_rcm.inverse() * in_scene;
        target(in_rcm.coords, Vector3::zeros())
    };
    let mut least_m = f64::INFINITY;
    let mut before = rig.arms;
    follow(&mut rig, 6.0, path, |rig, outputs| {
        judge.look(&before.map(Ok), outputs);
        before = rig.arms;
        least_m = least_m.min(gap_m(&scene, rig));
    });
    println!(
        "into a resting arm: gap {:.3} mm beyond what is kept",
        1e3 * least_m
    );
    assert!(
        judge.violations(false).is_empty(),
        "{:#?}",
        judge.violations(false)
    );
    assert!(
        least_m >= config.margins.guard_m && least_m < 0.004,
        "{least_m}"
    );
}
