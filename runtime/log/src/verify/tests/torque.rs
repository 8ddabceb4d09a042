//! Drives that are switched on and off, honestly and not.

use hal::{ArmCommand, ArmError, ArmState, JointVector};

use super::{doctored, limits, verify_records};
use crate::TickRecord;
use crate::tests::{run_disturbed, run_with_operator};
use trocar_control::OperatorEvent;

#[test]
fn an_arm_without_torque_may_be_anywhere() {
    let result = doctored("limp", |records| {
        for (record, k) in records.iter_mut().zip(0_u32..) {
            make_limp(record);
            // It is pushed by hand, far out of its workspace.
            let state = record.arms.first.measured.as_mut().unwrap();
            state.position[0] += 0.0015 * f64::from(k);
            record.arms.first.command.position = state.position;
        }
    });
    assert!(result.ok, "{:?}", result.violations.first());
}

/// What the controller says of `record`'s measurement while the drives have no torque.
fn make_limp(record: &mut TickRecord) {
    let state = record.arms.first.measured.unwrap();
    let command = &mut record.arms.first.command;
    command.enabled = false;
    (command.position, command.jaw_position) = (state.position, state.jaw_position);
    (command.velocity, command.jaw_velocity) = (JointVector::zeros(), 0.0);
    command.acceleration = JointVector::zeros();
}

#[test]
fn without_torque_and_measurement_the_command_stays() {
    let still = |records: &mut Vec<TickRecord>| {
        for record in &mut *records {
            make_limp(record);
        }
        let held = records[499].arms.first.command;
        for record in &mut records[500..510] {
            let stamp = record.arms.first.command.stamp;
            record.arms.first.measured = Err(ArmError::MeasurementLost { age_ns: 1 });
            record.arms.first.command = ArmCommand { stamp, ..held };
        }
    };
    let result = doctored("lost", still);
    assert!(result.ok, "{:?}", result.violations.first());
    let result = doctored("lost-jump", |records| {
        still(records);
        records[505].arms.first.command.position[0] += 1.0;
    });
    let found = limits(&result);
    assert_eq!(found, ["yaw.disabled_position"; 2]);
}

#[test]
fn a_log_that_calls_every_tick_disabled_is_caught() {
    let result = doctored("all-disabled", |records| {
        for record in &mut *records {
            record.arms.first.command.enabled = false;
        }
        records[600].arms.first.command.position[0] += 1.0;
    });
    let found = limits(&result);
    assert!(
        found.contains(&"yaw.disabled_position") && found.contains(&"yaw.disabled_velocity"),
        "{found:?}"
    );
    assert!(
        result
            .violations
            .iter()
            .any(|violation| violation.tick == 600 && violation.limit == "yaw.disabled_position")
    );
}

#[test]
fn a_jump_cannot_hide_behind_a_disabled_tick() {
    // The arm moves when the tick claims to have no torque.
    let moving = doctored("hidden-jump", |records| {
        records[600].arms.first.command.enabled = false;
        for record in &mut records[601..] {
            record.arms.first.command.position[0] += 1.0;
        }
    });
    let found = limits(&moving);
    assert!(
        found.contains(&"yaw.disabled_velocity") && found.contains(&"yaw.velocity"),
        "{found:?}"
    );
    // A tick that looks like a disabled one in every respect.
    let consistent = doctored("hidden-jump-consistent", |records| {
        make_limp(&mut records[600]);
        for record in &mut records[601..] {
            record.arms.first.command.position[0] += 1.0;
        }
    });
    let found = limits(&consistent);
    assert!(
        found.contains(&"yaw.jerk") && found.contains(&"yaw.velocity"),
        "{found:?}"
    );
    // Before anything moves.
    let resting = doctored("hidden-jump-at-rest", |records| {
        make_limp(&mut records[10]);
        make_limp(&mut records[11]);
        for record in &mut records[12..] {
            record.arms.first.command.position[0] += 1.0;
        }
    });
    let found = limits(&resting);
    assert!(
        resting.violations[0].tick == 12 && found.contains(&"yaw.velocity"),
        "{found:?}"
    );
}

#[test]
fn torque_may_not_go_while_the_arm_moves() {
    let result = doctored("dropped", |records| {
        for record in &mut records[600..] {
            make_limp(record);
        }
    });
    let found = limits(&result);
    assert!(
        result
            .violations
            .iter()
            .all(|violation| violation.tick == 600)
            && found.iter().any(|limit| limit.ends_with(".jerk")),
        "{found:?}"
    );
}

#[test]
fn an_honest_disabling_and_enabling_breaks_no_limit() {
    let (records, header) = run_with_operator(1500, |tick| match tick {
        1 | 1000 => Some(OperatorEvent::Enable),
        600 => Some(OperatorEvent::Disable),
        _ => None,
    });
    let limp = records
        .iter()
        .skip(2)
        .filter(|record| !record.arms.first.command.enabled);
    assert!(limp.count() > 100);
    let result = verify_records("switched", &records, &header);
    assert!(result.ok, "{:?}", result.violations.first());
}

#[test]
fn an_honest_fault_breaks_no_limit() {
    let operator = |tick| match tick {
        1 | 1100 => Some(OperatorEvent::Enable),
        1000 => Some(OperatorEvent::Clear),
        _ => None,
    };
    let pushed = |tick, mut state: ArmState| {
        // Away from its command, so that the drives let go of it there.
        state.position[0] += if tick >= 400 { 0.12 } else { 0.0 };
        Ok(state)
    };
    let lost = |tick, state| match tick {
        400..900 => Err(ArmError::DriveFault { axis: 2, code: 1 }),
        _ => Ok(state),
    };
    let held = |tick, state| match tick {
        400..900 => Err(ArmError::MeasurementLost { age_ns: 1 }),
        _ => Ok(state),
    };
    let runs = [
        ("fault-pushed", run_disturbed(1200, operator, pushed)),
        ("fault-drive", run_disturbed(1200, operator, lost)),
        ("fault-lost", run_disturbed(1200, operator, held)),
    ];
    for (name, (records, header)) in runs {
        assert!(
            records[380].arms.first.command.enabled && records[380].arms.first.report.mode.busy
        );
        assert!(
            records[1000..1100]
                .iter()
                .any(|record| !record.arms.first.command.enabled)
        );
        let result = verify_records(name, &records, &header);
        assert!(result.ok, "{name}: {:?}", result.violations.first());
    }
}
