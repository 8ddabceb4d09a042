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
