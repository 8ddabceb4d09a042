use super::faults::{is_answer, moving};
use super::*;

/// What becomes of `count` answers of axis 2, and what the arm says in the cycles after.
fn disturbed(
    count: u32,
    change: impl Fn(&Frame) -> Tampering + 'static,
) -> (Bench, Vec<Result<ArmState, ArmError>>) {
    let mut bench = moving();
    let mut left = count;
    bench.tamper(move |frame| {
        if is_answer(frame, 2) && left > 0 {
            left -= 1;
            change(frame)
        } else {
            Tampering::Pass
        }
    });
    let outcomes = (0..30).map(|_| bench.cycle(0.0008)).collect();
    (bench, outcomes)
}

fn lost(outcomes: &[Result<ArmState, ArmError>]) -> usize {
    let is_lost = |o: &&Result<_, _>| matches!(o, Err(ArmError::MeasurementLost { .. }));
    outcomes.iter().filter(is_lost).count()
}

#[test]
fn one_or_two_missing_answers_are_bridged_three_are_a_lost_measurement() {
    let (bench, outcomes) = disturbed(2, |_| Tampering::Drop);
    assert!(outcomes.iter().all(Result::is_ok));
    let steps: Vec<f64> = outcomes
        .windows(2)
        .map(|w| w[1].unwrap().position[2] - w[0].unwrap().position[2])
        .collect();
    assert!(steps.iter().all(|s| (s - 0.0008).abs() < 4e-5), "{steps:?}");
    assert_eq!(bench.arm.cycle().axis_health()[2].missed, 2);
    let (bench, outcomes) = disturbed(3, |_| Tampering::Drop);
    assert_eq!(lost(&outcomes), 1);
    assert!(outcomes[29].is_ok() && bench.arm.fault().is_none());
}

#[test]
fn twenty_missing_answers_are_a_fault() {
    let (mut bench, outcomes) = disturbed(1000, |_| Tampering::Drop);
    assert_eq!(lost(&outcomes), 17);
    bench.assert_stopped_for_good("node 3 (axis 2, bus 0): no usable process data for 20 cycles");
}

#[test]
fn short_long_senseless_and_impossible_answers_are_not_believed() {
    let cut = |f: &Frame| Tampering::Replace(frame(f.id.raw(), &f.data()[..7]));
    let empty = |f: &Frame| Tampering::Replace(frame(f.id.raw(), &[]));
    let status = |f: &Frame| {
        let mut data = f.data().to_vec();
        data[0] = 0x03;
        Tampering::Replace(frame(f.id.raw(), &data))
    };
    let jump = |f: &Frame| {
        let mut data = f.data().to_vec();
        data[4] ^= 0x40;
        Tampering::Replace(frame(f.id.raw(), &data))
    };
    let kinds: [fn(&Frame) -> Tampering; 4] = [cut, empty, status, jump];
    for kind in kinds {
        let (bench, outcomes) = disturbed(2, kind);
        assert!(outcomes.iter().all(Result::is_ok));
        assert_eq!(bench.arm.cycle().axis_health()[2].rejected, 2);
        let (mut bench, outcomes) = disturbed(1000, kind);
        assert_eq!(lost(&outcomes), 17);
        bench.assert_stopped_for_good(
            "node 3 (axis 2, bus 0): no usable process data for 20 cycles",
        );
    }
}

#[test]
fn late_and_doubled_answers_are_counted() {
    let (bench, outcomes) = disturbed(1, |_| Tampering::Delay(2 * MS));
    assert!(outcomes.iter().all(Result::is_ok));
    let health = bench.arm.cycle().axis_health()[2];
    assert_eq!((health.missed, health.late), (1, 1));
    let (bench, outcomes) = disturbed(1, |_| Tampering::Repeat);
    assert!(outcomes.iter().all(Result::is_ok));
    assert_eq!(bench.arm.cycle().axis_health()[2].late, 1);
}
