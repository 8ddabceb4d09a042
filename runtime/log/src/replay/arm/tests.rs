use hal::{Arm as _, ArmError, ArmState, JointVector, SafeTail, TimeNs};

use super::{RecordedArm, ReplayError};
use crate::tests::two_arms::run_two_arms;
use crate::tests::{Scratch, chunk_of_run, run_disturbed, write_records};
use crate::{Loss, RunLog};
use trocar_control::{ControlConfig, Controller, OperatorEvent, TickInput};

const FAULT: ArmError = ArmError::DriveFault {
    axis: 3,
    code: 0x2310,
};

/// An arm that is not measured in ticks 300 and 301, and whose drive fails at 600.
fn log(name: &str) -> RunLog {
    let operator = |tick| (tick == 1).then_some(OperatorEvent::Enable);
    let (records, header) = run_disturbed(700, operator, |tick, state| match tick {
        300 | 301 => Err(ArmError::MeasurementLost { age_ns: 1_000_000 }),
        600.. => Err(FAULT),
        _ => Ok(state),
    });
    let file = Scratch::new(name);
    write_records(&file, &records, &header);
    RunLog::open(&file.0).unwrap()
}

/// Lets a controller drive the recorded arm through the whole log; gives how many commands were
/// other ones.
fn drive(log: &RunLog, operator: impl Fn(u64) -> Option<OperatorEvent>) -> u64 {
    let control = ControlConfig::default_control();
    let config = ControlConfig::load(&control, &ControlConfig::needle_lift_safety()).unwrap();
    let mut controller = Controller::new(&config).unwrap();
    let mut arm = RecordedArm::new(log, 0).unwrap();
    for tick in 0..700 {
        let now = TimeNs::from_tick(tick);
        let chunk = (tick % 250 == 20).then(|| chunk_of_run(tick / 250 + 1));
        let output = controller.tick(&TickInput {
            now,
            measured: arm.read(now),
            chunk: chunk.as_ref(),
            operator: operator(tick),
        });
        let written = arm.write(&output.command, &output.tail);
        assert_eq!(written, if tick < 600 { Ok(()) } else { Err(FAULT) });
    }
    arm.differing()
}

/// A controller that meets a recorded arm commands what was recorded.
#[test]
fn a_controller_repeats_itself_on_a_recorded_arm() {
    let log = log("recorded-arm");
    let enable = |tick| (tick == 1).then_some(OperatorEvent::Enable);
    assert_eq!(drive(&log, enable), 0);
    let slowly = |tick| match tick {
        1 => Some(OperatorEvent::Enable),
        30 => Some(OperatorEvent::Speed { percent: 50 }),
        _ => None,
    };
    assert!(drive(&log, slowly) > 100);
}

#[test]
fn the_newest_tick_counts_and_the_end_is_told() {
    let log = log("recorded-times");
    let mut arm = RecordedArm::new(&log, 0).unwrap();
    let recorded: Vec<_> = log.ticks().map(|(tick, _)| tick.arms.first).collect();
    let at = |tick: u64, ns: u64| TimeNs::from_tick(tick).plus_ns(ns);
    for tick in [0, 1, 250, 299, 300, 302, 599, 699] {
        let expected = recorded[usize::try_from(tick).unwrap()].measured;
        assert_eq!(arm.read(at(tick, 0)), expected, "{tick}");
        assert_eq!(arm.read(at(tick, 999_999)), expected, "{tick}");
    }
    assert_eq!(arm.read(at(700, 0)), Err(ArmError::EndOfRecording));
    let command = recorded[0].command;
    let written = arm.write(&command, &SafeTail::hold(&command));
    assert_eq!(written, Err(ArmError::EndOfRecording));
    // Not bound to go forwards.
    assert_eq!(arm.read(at(5, 0)), recorded[5].measured);
    let mut late = log.clone();
    late.losses.push(Loss::Ticks {
        position: 251,
        count: 4,
    });
    let mut arm = RecordedArm::new(&late, 0).unwrap();
    assert_eq!(arm.read(at(250, 0)), recorded[250].measured);
    let age_ns = 400_000;
    assert_eq!(
        arm.read(at(250, age_ns)),
        Err(ArmError::MeasurementLost { age_ns })
    );
    assert_eq!(arm.read(at(251, 0)), recorded[251].measured);
}

#[test]
fn what_is_no_number_is_counted_apart() {
    let log = log("recorded-nan");
    let mut arm = RecordedArm::new(&log, 0).unwrap();
    let _ = arm.read(TimeNs::from_tick(100));
    let (tick, _) = log.ticks().nth(100).unwrap();
    let mut command = tick.arms.first.command;
    let tail = SafeTail::hold(&command);
    arm.write(&command, &tail).unwrap();
    assert_eq!((arm.differing(), arm.refused()), (0, 0));
    command.velocity[4] = f64::from_bits(command.velocity[4].to_bits() ^ 1);
    arm.write(&command, &tail).unwrap();
    assert_eq!((arm.differing(), arm.refused()), (1, 0));
    command.jaw_velocity = f64::NAN;
    arm.write(&command, &tail).unwrap();
    assert_eq!((arm.differing(), arm.refused()), (1, 1));
}

#[test]
fn each_arm_of_a_log_is_its_own_and_there_are_no_others() {
    let (records, header) = run_two_arms(40);
    let file = Scratch::new("recorded-arms");
    let mut recorder = crate::Recorder::create(&file.0, &header, crate::Pressure::Block).unwrap();
    for record in &records {
        let mut record = *record;
        record.arms.first.chunk_sequence = None;
        let second = record.arms.second.as_mut().unwrap();
        second.chunk_sequence = None;
        let place = JointVector::repeat(0.01);
        second.measured = Ok(ArmState::at_rest(record.now, place, 0.1));
        recorder.tick(&record);
    }
    recorder.finish(None).unwrap();
    let log = RunLog::open(&file.0).unwrap();
    let [first, second] = [0, 1].map(|index| {
        let mut arm = RecordedArm::new(&log, index).unwrap();
        arm.read(TimeNs::from_tick(20)).unwrap().jaw_position
    });
    assert!((first - second).abs() > 0.1, "{first} {second}");
    let none = RecordedArm::new(&log, 2).unwrap_err();
    assert!(matches!(none, ReplayError::NoArm { index: 2 }));
    assert_eq!(none.to_string(), "the log has no arm 2, counted from 0");
    let empty = RecordedArm::new(&RunLog::default(), 0);
    assert!(matches!(empty, Err(ReplayError::Empty)));
}
