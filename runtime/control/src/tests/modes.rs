//! Operator, faults and drives, seen from outside.

use hal::{ArmError, ArmState, PerArm, TimeNs, TipTarget};
use nalgebra::Vector3;

use super::{Bench, config, pose};
use crate::{AnyController, ControlConfig, Controller};
use crate::{Fault, GateDecision, OperatingState, OperatorEvent, TickInput};

fn moving() -> Bench {
    let mut bench = Bench::enabled(&config());
    let chunk = bench.chunk_along(|time_s| {
        TipTarget::new(&pose(0.04 * time_s, 0.0, -0.1135, Vector3::zeros()), 0.2)
    });
    for _ in 0..300 {
        bench.step(Some(&chunk), None);
    }
    assert!(bench.controller.mode().busy);
    bench
}

fn run_to_rest(bench: &mut Bench) {
    for _ in 0..300 {
        bench.step(None, None);
    }
    assert!(!bench.controller.mode().busy);
}

#[test]
fn the_first_commands_are_where_the_arm_is() {
    let mut bench = Bench::disabled(&config());
    bench.arm.position[0] = 0.123;
    let output = bench.step(None, None);
    assert_eq!(
        (output.command.position, output.command.enabled),
        (bench.arm.position, false)
    );
    let output = bench.step(None, Some(OperatorEvent::Enable));
    assert!(output.command.enabled && output.report.mode.homed);
    assert!((output.command.position[0] - 0.123).abs() < 1e-15);
}

/// A lost measurement stops the arm and holds it until the operator clears.
#[test]
fn lost_measurement_stops_until_cleared() {
    let mut bench = moving();
    let error = ArmError::MeasurementLost { age_ns: 5_000_000 };
    let output = bench.step_measuring(Err(error), None, None);
    assert_eq!(output.report.fault, Some(Fault::Arm(error)));
    run_to_rest(&mut bench);
    let output = bench.step(None, Some(OperatorEvent::Enable));
    assert_eq!(output.report.mode.state, OperatingState::Fault);
    assert!(output.command.enabled);
    let output = bench.step(None, Some(OperatorEvent::Clear));
    assert_eq!(
        (output.report.mode.state, output.report.fault),
        (OperatingState::Disabled, None)
    );
    assert!(!output.command.enabled);
    assert_eq!(
        bench
            .step(None, Some(OperatorEvent::Enable))
            .report
            .mode
            .state,
        OperatingState::Enabled
    );
}

#[test]
fn nan_in_the_measurement_is_a_fault() {
    let mut bench = moving();
    let measured = ArmState {
        jaw_effort: f64::NAN,
        ..bench.arm
    };
    let output = bench.step_measuring(Ok(measured), None, None);
    assert_eq!(output.report.fault, Some(Fault::MeasurementNotFinite));
    assert!(output.command.position.iter().all(|x| x.is_finite()));
}

/// An arm that is measured where it cannot be is not enabled there.
#[test]
fn arm_measured_out_of_range_is_not_enabled() {
    for (axis, value) in [(2, 1.39), (2, -0.05), (0, 2.0), (6, 4.0)] {
        let mut bench = Bench::disabled(&config());
        bench.step(None, None);
        let mut measured = bench.arm;
        match measured.position.get_mut(axis) {
            Some(joint) => *joint = value,
            None => measured.jaw_position = value,
        }
        let output = bench.step_measuring(Ok(measured), None, Some(OperatorEvent::Enable));
        let axis = u8::try_from(axis).unwrap();
        assert_eq!(
            output.report.fault,
            Some(Fault::MeasurementOutOfRange { axis, value })
        );
        assert!(!output.command.enabled);
        assert_eq!(output.command.position, super::home());
    }
}

#[test]
fn an_arm_that_does_not_follow_is_stopped_and_released() {
    let mut bench = moving();
    let mut measured = bench.arm;
    measured.position[1] += 0.2;
    let output = bench.step_measuring(Ok(measured), None, None);
    assert!(
        matches!(
            output.report.fault,
            Some(Fault::TrackingError { tip_m, .. }) if tip_m > 0.01
        ),
        "{:?}",
        output.report.fault
    );
    assert!(output.command.enabled, "torque stays until rest");
    run_to_rest(&mut bench);
    assert!(!bench.step(None, None).command.enabled);
}

#[test]
fn disabling_while_moving_stops_first_and_releases_then() {
    let mut bench = moving();
    let output = bench.step(None, Some(OperatorEvent::Disable));
    assert!(output.command.enabled && output.report.mode.busy);
    run_to_rest(&mut bench);
    assert!(!bench.step(None, None).command.enabled);
}

#[test]
fn a_paused_arm_holds_and_goes_on_with_fresh_chunks() {
    let mut bench = moving();
    bench.step(None, Some(OperatorEvent::Pause));
    run_to_rest(&mut bench);
    let held = bench.arm.position;
    let goal = TipTarget::new(&bench.tip(), 0.2);
    let chunk = bench.chunk_along(|_| goal);
    let output = bench.step(Some(&chunk), None);
    assert_eq!((output.report.gate, output.command.position), (None, held));
    assert!(output.command.enabled);
    let output = bench.step(Some(&chunk), Some(OperatorEvent::Resume));
    assert_eq!(output.report.mode.state, OperatingState::Enabled);
    assert!(output.report.target.is_some());
}

/// An arm enabled outside its workspace comes back and never gets further.
#[test]
fn arm_outside_its_workspace_comes_back() {
    let config = config();
    let mut bench = Bench::disabled(&config);
    // The tip 5 mm beyond the ceiling and the insertion short of its range.
    bench.arm.position[2] = 0.0565 - 0.005 + 0.0065 + 0.005;
    let start = bench.tip();
    let workspace = config.arms[0].workspace;
    let ceiling_m = workspace.center_m.z + workspace.half_m.z;
    assert!(
        start.translation.z > ceiling_m,
        "{}",
        start.translation.z - ceiling_m
    );
    bench.step(None, Some(OperatorEvent::Enable));
    let goal = TipTarget::new(&pose(0.0, 0.0, -0.10, Vector3::zeros()), 0.2);
    let mut highest_m = f64::NEG_INFINITY;
    for tick in 0..4000 {
        let chunk = bench.chunk_along(|_| goal);
        bench.step((tick % 40 == 0).then_some(&chunk), None);
        highest_m = highest_m.max(bench.tip().translation.z);
    }
    assert!(highest_m <= start.translation.z + 1e-6, "{highest_m}");
    assert!(
        (bench.tip().translation.z + 0.10).abs() < 1e-5,
        "{}",
        bench.tip().translation.z
    );
}

#[test]
fn a_late_controller_goes_on_from_where_the_tail_has_led() {
    for missed in [1, 5, 40, 400] {
        let mut bench = moving();
        let before = bench.step(None, None);
        bench.tick += missed;
        let now = bench.now();
        // What the arm has played alone until now.
        let alone = before.tail.command_at(now);
        let last = before.tail.command_at(TimeNs(now.0 - hal::TICK_NS));
        let output = bench.step(None, None);
        for joint in 0..hal::JOINT_COUNT {
            let jerk = config().axes[joint].jerk;
            let off = (output.command.position[joint] - alone.position[joint]).abs();
            // From the same moment one may go on with full jerk where the other brakes with it.
            assert!(off < jerk * 1e-9 / 3.0 + 1e-12, "{missed} {joint}: {off:e}");
            let change = (output.command.acceleration[joint] - last.acceleration[joint]).abs();
            assert!(
                change < jerk * 1e-3 * (1.0 + 1e-6),
                "{missed} {joint}: {change}"
            );
        }
        assert!(output.report.fault.is_none());
    }
}

#[test]
fn a_fault_of_one_arm_pauses_the_other() {
    let config = crate::rows::tests::two_arms();
    let mut controller = Controller::<2>::for_arms(&config).unwrap();
    let arm = ArmState::at_rest(TimeNs(0), super::home(), 0.2);
    let lost = ArmError::MeasurementLost { age_ns: 1 };
    let mut tick = 0;
    let mut step = |measured: [Result<ArmState, ArmError>; 2], operator| {
        let inputs = measured.map(|measured| TickInput {
            now: TimeNs::from_tick(tick),
            measured,
            chunk: None,
            operator,
        });
        tick += 1;
        let outputs = controller.tick_arms(&inputs);
        outputs.map(|output| output.report.mode.state)
    };
    let both = [OperatingState::Enabled; 2];
    assert_eq!(step([Ok(arm); 2], Some(OperatorEvent::Enable)), both);
    let paused = [OperatingState::Fault, OperatingState::Paused];
    assert_eq!(step([Err(lost), Ok(arm)], None), paused);
    // The operator cannot wake the other one before the fault is cleared.
    assert_eq!(step([Ok(arm); 2], Some(OperatorEvent::Resume)), paused);
    let cleared = [OperatingState::Disabled, OperatingState::Paused];
    assert_eq!(step([Ok(arm); 2], Some(OperatorEvent::Clear)), cleared);
    let resumed = [OperatingState::Disabled, OperatingState::Enabled];
    assert_eq!(step([Ok(arm); 2], Some(OperatorEvent::Resume)), resumed);
}

#[test]
fn a_controller_is_for_as_many_arms_as_the_configuration_has() {
    let two = crate::rows::tests::two_arms();
    let error = Controller::new(&two).unwrap_err().to_string();
    assert_eq!(
        error,
        "the configuration has 2 arms, the controller is for 1"
    );
    assert!(Controller::<2>::for_arms(&config()).is_err());
}

/// A tick of a controller for the arms of `config` with inputs of `count` arms.
fn tick_of(count: usize, config: &ControlConfig) -> usize {
    let input = TickInput {
        now: TimeNs(0),
        measured: Ok(ArmState::at_rest(TimeNs(0), super::home(), 0.2)),
        chunk: None,
        operator: None,
    };
    let inputs = PerArm::collect((0..count).map(|_| input)).unwrap();
    AnyController::new(config).unwrap().tick(&inputs).count()
}

#[test]
fn each_arm_of_a_tick_is_answered() {
    assert_eq!(tick_of(1, &config()), 1);
    assert_eq!(tick_of(2, &crate::rows::tests::two_arms()), 2);
}

#[test]
#[should_panic(expected = "inputs of two arms for a controller of one")]
fn a_second_arm_of_another_configuration_is_no_input() {
    tick_of(2, &config());
}

#[test]
#[should_panic(expected = "inputs of one arm for a controller of two")]
fn a_missing_second_arm_is_no_input() {
    tick_of(1, &crate::rows::tests::two_arms());
}

/// Who takes over is followed at once, from where the arm is and as it moves; whoever gets the arm
/// back is followed from its first answer to what was seen since, and older ones are stale.
#[test]
fn another_drives_without_a_jump_and_nothing_old_counts() {
    let mut bench = moving();
    let speed = |bench: &Bench| bench.arm.velocity.norm();
    let before = speed(&bench);
    let here = bench.tip();
    let there = bench.chunk_along(|_| TipTarget::new(&here, 0.2));
    let output = bench.step(Some(&there), Some(OperatorEvent::TakeOver));
    assert_eq!(output.report.gate, Some(GateDecision::Accepted));
    assert_eq!(output.report.mode.state, OperatingState::Enabled);
    assert!((speed(&bench) - before).abs() < 0.02 * before, "no jump");
    // The chunk of before wanted to go on.
    for _ in 0..300 {
        bench.step(None, None);
    }
    let way = (bench.tip().translation.vector - here.translation.vector).norm();
    assert!(way < 1e-3, "{way}");

    let mut old = bench.chunk_along(|_| TipTarget::new(&here, 0.2));
    bench.step(None, None);
    bench.step(None, Some(OperatorEvent::HandBack));
    old.sequence = 7;
    let refused = bench.step(Some(&old), None).report;
    assert!(
        matches!(refused.gate, Some(GateDecision::Stale { .. })),
        "{refused:?}"
    );
    assert_eq!(refused.target, None);
    // The policy counts its chunks by itself.
    let mut new = bench.chunk_along(|_| TipTarget::new(&here, 0.2));
    new.sequence = 1;
    let accepted = bench.step(Some(&new), None).report;
    assert_eq!(accepted.gate, Some(GateDecision::Accepted));
}
