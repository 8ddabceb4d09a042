//! The monitor on reports made up by hand, and on episodes played through.

use nalgebra::Vector3;

use super::{Puppet, task};
use crate::tissue::{
    Grasp, Retraction, RetractionConfig, RetractionFailure, RetractionMonitor, TissueReport,
};

fn config() -> RetractionConfig {
    task().success
}

fn lifted(beside_mark_m: f64, mark_rise_m: f64) -> TissueReport {
    let grasp = Grasp {
        area_m2: 1e-5,
        force_n: 0.05,
        middle_m: [0.03, 0.045],
        beside_mark_m,
    };
    TissueReport {
        grasp: Some(grasp),
        mark_rise_m,
        ..TissueReport::at_rest()
    }
}

/// The state after `seconds` of the same report, and the steps that it took.
fn after(report: &TissueReport, seconds: f64) -> (Retraction, u32) {
    let mut monitor = RetractionMonitor::new(&config());
    let mut steps = 0;
    while monitor.state() == Retraction::Running && f64::from(steps) < seconds * 1e3 {
        monitor.observe(report);
        steps += 1;
    }
    (monitor.state(), steps)
}

#[test]
fn a_flap_held_up_at_the_mark_is_a_success_after_the_hold_time() {
    let config = config();
    assert_eq!(
        after(&lifted(0.001, config.lift_height_m + 1e-4), 5.0),
        (Retraction::Success, 500)
    );
    assert_eq!(
        after(&lifted(0.001, config.lift_height_m - 1e-4), 5.0).0,
        Retraction::Running
    );
    let untouched = TissueReport {
        mark_rise_m: 0.05,
        ..TissueReport::at_rest()
    };
    assert_eq!(
        after(&untouched, 5.0).0,
        Retraction::Running,
        "lifted without a grasp"
    );
}

#[test]
fn a_break_in_the_hold_starts_it_anew() {
    let config = config();
    let mut monitor = RetractionMonitor::new(&config);
    let up = lifted(0.001, config.lift_height_m + 1e-4);
    for step in 0..998 {
        let slipped = TissueReport { grasp: None, ..up };
        monitor.observe(if step == 499 { &slipped } else { &up });
        assert_eq!(monitor.state(), Retraction::Running, "step {step}");
    }
    monitor.observe(&up);
    monitor.observe(&up);
    assert_eq!(monitor.state(), Retraction::Success);
}

/// Checks that each report, lasting, loses the episode after its steps with its words.
fn are_named(cases: &[(TissueReport, u32, &str)]) {
    for (report, steps, text) in cases {
        let (state, after_steps) = after(report, 20.0);
        assert!(matches!(state, Retraction::Failure(_)), "{text}: {state:?}");
        assert_eq!((state.to_string().as_str(), after_steps), (*text, *steps));
    }
}

#[test]
fn squeezing_pressing_in_and_slowed_nodes_are_seen_and_named() {
    let rest = TissueReport::at_rest();
    are_named(&[
        (
            TissueReport {
                smooth_squeeze_n: 4.5,
                ..rest
            },
            20,
            "tissue squeezed with 4.50 N",
        ),
        (
            TissueReport {
                ground_depth_m: 0.001,
                ..rest
            },
            20,
            "tissue pressed 1.00 mm into what it lies on",
        ),
        (
            TissueReport { slowed: 3, ..rest },
            1,
            "tissue too fast for its simulation, slowed down 3 times",
        ),
    ]);
}

#[test]
fn every_failure_is_seen_and_named() {
    let rest = TissueReport::at_rest();
    let cases = [
        (
            TissueReport {
                smooth_force_n: 0.9,
                ..rest
            },
            20,
            "tissue handled with 0.90 N",
        ),
        (
            TissueReport {
                stretch: 0.5,
                ..rest
            },
            20,
            "tissue stretched by 50 %",
        ),
        (
            TissueReport {
                instrument_depth_m: 0.002,
                ..rest
            },
            20,
            "instrument sank 2.00 mm into the tissue",
        ),
        (
            TissueReport {
                speed_m_s: 2.0,
                ..rest
            },
            20,
            "tissue flung at 2.00 m/s",
        ),
        (
            TissueReport { lost: 1, ..rest },
            1,
            "tissue slipped out of the jaw",
        ),
        (TissueReport { torn: true, ..rest }, 1, "tissue torn"),
        (
            TissueReport {
                fault: true,
                ..rest
            },
            1,
            "tissue's numbers left their range",
        ),
        (lifted(0.008, 0.0), 500, "flap held 8.0 mm beside the mark"),
    ];
    are_named(&cases);
}

#[test]
fn a_hiccup_of_one_step_is_no_failure() {
    let mut monitor = RetractionMonitor::new(&config());
    let rest = TissueReport::at_rest();
    for step in 0..2000 {
        let hard = step % 20 != 0;
        monitor.observe(&TissueReport {
            smooth_force_n: if hard { 0.9 } else { 0.0 },
            ..rest
        });
    }
    assert_eq!(monitor.state(), Retraction::Running);
}

/// Plays a grasp `aside_m` beside the mark, a lift by `rise_m` at `speed_m_s`, and a wait.
fn episode(aside_m: f64, rise_m: f64, speed_m_s: f64) -> (Retraction, f64) {
    let task = task();
    let mut puppet = Puppet::at_edge(&task.tissue, 0.006, aside_m);
    let mut monitor = RetractionMonitor::new(&task.success);
    let mut hardest_n = 0.0_f64;
    puppet.close(2.0);
    let path = Vector3::new(0.0, 0.25 * rise_m, rise_m);
    let steps = path.norm() / speed_m_s * 1e3;
    for step in 0..6000 {
        if f64::from(step) < steps {
            puppet.tip.translation.vector += path / steps;
        }
        puppet.step();
        monitor.observe(puppet.tissue.report());
        hardest_n = hardest_n.max(puppet.tissue.report().smooth_force_n);
    }
    (monitor.state(), hardest_n)
}

#[test]
fn a_careful_lift_succeeds_and_careless_ones_do_not() {
    let (careful, hardest_n) = episode(0.0, 0.022, 0.02);
    assert_eq!(careful, Retraction::Success);
    assert!(hardest_n < 0.5 * config().force_n_max);
    let (beside, _) = episode(0.009, 0.022, 0.02);
    assert!(matches!(
        beside,
        Retraction::Failure(RetractionFailure::BesideMark { .. })
    ));
    let (too_far, _) = episode(0.0, 0.06, 0.05);
    assert!(matches!(too_far, Retraction::Failure(_)), "{too_far}");
    let (still, _) = episode(0.0, 0.0, 0.02);
    assert_eq!(still, Retraction::Running);
}
