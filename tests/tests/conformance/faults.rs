//! What holds for every arm that can break: how it tells.

use hal::{ArmError, TimeNs};

use crate::facts::Fact;
use crate::rig::{Driver, Make, WAY, assert_near, positions};

/// All of them.
pub(crate) const FAULTS: [Fact; 3] = [
    ("a short loss", a_short_loss_is_bridged),
    (
        "a long loss",
        a_lost_measurement_is_told_with_its_age_and_ends,
    ),
    ("a failure", failed_drives_are_named_and_latch_until_reset),
];

fn a_short_loss_is_bridged(make: Make<'_>) {
    let mut driver = Driver::new(make);
    let (before, _) = driver.go(250_000_000);
    let bridged = driver.nature.bridged;
    assert!(driver.rig.deafen(bridged));
    let mut newest = before;
    for _ in 0..bridged + 10 {
        let now = driver.rig.now();
        let (state, _) = driver.go(1);
        assert!(state.stamp >= newest.stamp && state.stamp <= now);
        newest = state;
    }
    let _ = driver.go(240_000_000 + driver.nature.settle_ns);
    let wanted = core::array::from_fn(|axis| driver.found[axis] + WAY[axis]);
    let state = driver.go(1).0;
    assert_near(&positions(&state), &wanted, 0.02, "after a short loss");
}

fn a_lost_measurement_is_told_with_its_age_and_ends(make: Make<'_>) {
    let mut driver = Driver::new(make);
    let stands = driver.arrive();
    let losses = driver.nature.bridged + 6;
    assert!(driver.rig.deafen(losses));
    let mut newest = stands.stamp;
    let mut lost = 0;
    for _ in 0..losses + 20 {
        let now = driver.rig.now();
        let said = driver.set_point();
        match driver.period(Some(said)) {
            Ok(state) => newest = state.stamp,
            Err(error) => {
                let age_ns = now.since(newest);
                assert_eq!(error, ArmError::MeasurementLost { age_ns });
                lost += 1;
            }
        }
    }
    assert!((1..=losses).contains(&lost), "{lost} of {losses}");
    // It is over.
    let now = driver.rig.now();
    let (state, _) = driver.go(1);
    assert!(now.since(state.stamp) <= driver.nature.age_max_ns);
    assert_near(
        &positions(&state),
        &positions(&stands),
        0.01,
        "after a loss",
    );
}

fn failed_drives_are_named_and_latch_until_reset(make: Make<'_>) {
    for axis in [0, 3, 6] {
        let mut driver = Driver::new(make);
        let _ = driver.go(250_000_000);
        assert!(driver.rig.fail(axis, 0x2310));
        let failure = ArmError::DriveFault { axis, code: 0x2310 };
        let failed = (0..5).any(|_| {
            let said = driver.set_point();
            driver.period(Some(said)) == Err(failure)
        });
        assert!(failed, "axis {axis}");
        // Whatever one says.
        for n in 0..driver.periods(700_000_000) {
            let said = driver.set_point();
            let now: TimeNs = driver.rig.now();
            let measured = driver.rig.arm().read(now);
            assert_eq!(measured, Err(failure), "axis {axis}, period {n}");
            if n % 3 > 0 {
                let (command, tail) = said;
                assert_eq!(driver.rig.arm().write(&command, &tail), Err(failure));
            }
            driver.rig.pass();
        }
        if driver.rig.reset() {
            let state = driver.silent(5);
            driver.depart_from(positions(&state), WAY);
            let wanted = core::array::from_fn(|axis| positions(&state)[axis] + WAY[axis]);
            assert_near(
                &positions(&driver.arrive()),
                &wanted,
                0.02,
                "brought up again",
            );
        }
    }
}
