//! The examples of library use do what they say.
#![allow(
    dead_code,
    unreachable_pub,
    reason = "each example has a main of its own"
)]

#[path = "../../runtime/control/examples/own_arm.rs"]
mod own_arm;
#[path = "../../runtime/app/examples/own_policy.rs"]
mod own_policy;
#[path = "../../runtime/app/examples/own_robot.rs"]
mod own_robot;

use tests::{repository, scratch};
use trocar_log::RunLog;
use trocar_log::replay::replay;
use trocar_log::verify::verify;

#[test]
fn an_own_arm_is_led_to_its_target() {
    let away_m = own_arm::run().unwrap();
    assert!(away_m < 2e-4, "{away_m}");
}

#[test]
fn an_own_policy_is_asked_and_its_chunks_are_taken() {
    let result = own_policy::run().unwrap();
    let summary = result.summary;
    assert_eq!(summary.policy.name, "circles");
    assert_eq!((result.ok, summary.success), (false, Some(false)));
    assert!(summary.policy.queries > 50, "{summary:?}");
    assert_eq!(summary.policy.refused, 0, "{summary:?}");
}

#[test]
fn an_own_robot_runs_in_real_time_and_its_log_replays_and_verifies() {
    let log = scratch("own-robot").join("run.mcap");
    let safety = repository().join("config/tasks/needle-lift/safety.toml");
    let result = own_robot::run(&safety, log.clone()).unwrap();
    let summary = result.summary;
    assert!(result.ok, "{summary:?}");
    assert_eq!(
        (summary.reason.as_str(), summary.success),
        ("the 2 s are over", None)
    );
    assert!(summary.policy.queries > 5, "{summary:?}");
    let log = RunLog::open(&log).unwrap();
    assert!(replay(&log).unwrap().identical);
    assert!(verify(&log).unwrap().ok);
    // The tip has gone 1 cm to the side, give or take the lag.
    let place = |tick: Option<&trocar_log::LoggedTick>| {
        let measured = tick.unwrap().arms.first.measured.unwrap();
        trocar_control::kinematics::forward(&measured.position)
            .translation
            .vector
    };
    let ticks: Vec<_> = log.ticks().map(|(tick, _)| tick).collect();
    let way = place(ticks.last().copied()) - place(ticks.first().copied());
    assert!((way.norm() - 0.01).abs() < 5e-4, "{way}");
}

#[test]
fn a_rig_of_another_number_of_arms_is_refused() {
    let log = scratch("own-robot-arms").join("run.mcap");
    let safety = repository().join("config/tasks/needle-handover/safety.toml");
    let refused = own_robot::run(&safety, log).unwrap_err().to_string();
    assert!(refused.contains("the rig has 1 arms"), "{refused}");
}
