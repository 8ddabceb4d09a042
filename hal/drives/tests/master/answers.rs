use std::cell::Cell;
use std::rc::Rc;

use super::faults::{is_answer, moving};
use super::*;

/// What becomes of `count` answers of axis 2, and what the arm says in the cycles after.
fn disturbed(
    count: u32,
    change: impl Fn(&Frame) -> Tampering + 'static,
) -> (Bench, Vec<Result<ArmState, ArmError>>) {
    let mut bench = moving();
    // A heartbeat that holds up a SYNC makes its axis seem slower or faster, and what is bridged
    // goes on at that speed.
    let mut speed = || bench.cycle(0.0008).unwrap().velocity[2];
    assert!((0..10).any(|_| (speed() - 0.4).abs() < 1e-6));
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

/// One or two missing answers are bridged three are a lost measurement.
#[test]
fn third_missing_answer_is_a_lost_measurement() {
    let (bench, outcomes) = disturbed(2, |_| Tampering::Drop);
    assert!(outcomes.iter().all(Result::is_ok));
    // 0.4 units/s, whenever a measurement is of a later instant than the one before.
    let off = |w: &[Result<ArmState, ArmError>]| {
        let (before, after) = (w[0].unwrap(), w[1].unwrap());
        let wanted = 0.4 * (after.stamp.seconds() - before.stamp.seconds());
        (after.position[2] - before.position[2] - wanted).abs()
    };
    assert!(
        outcomes.windows(2).all(|w| off(w) < 4e-5),
        "{:?}",
        outcomes.windows(2).map(off).collect::<Vec<_>>()
    );
    let health = bench.arm.cycle().axis_health()[2];
    assert_eq!((health.missed, health.late, health.age_cycles), (2, 0, 0));
    let (bench, outcomes) = disturbed(3, |_| Tampering::Drop);
    // After the third cycle, and after the one whose answer may be out of step; then the pause
    // shows that it is not.
    assert_eq!(lost(&outcomes), 2);
    assert!(outcomes[29].is_ok() && bench.arm.fault().is_none());
}

#[test]
fn twenty_missing_answers_are_a_fault() {
    let (mut bench, outcomes) = disturbed(1000, |_| Tampering::Drop);
    assert_eq!(lost(&outcomes), 17);
    bench.assert_stopped_for_good("node 3 (axis 2, bus 0): no process data for 20 cycles");
}

/// Short long senseless and impossible answers are not believed.
#[test]
fn malformed_and_impossible_answers_are_rejected() {
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
    type Tamper = fn(&Frame) -> Tampering;
    let kinds: [(Tamper, &str); 4] = [
        (cut, "process data of 7 bytes instead of 8"),
        (empty, "process data of 0 bytes instead of 8"),
        (status, "a status word that codes no state"),
        (jump, "a position that the axis cannot have reached"),
    ];
    for (kind, why) in kinds {
        let (bench, outcomes) = disturbed(2, kind);
        assert!(outcomes.iter().all(Result::is_ok));
        assert_eq!(bench.arm.cycle().axis_health()[2].rejected, 2);
        let (mut bench, outcomes) = disturbed(1000, kind);
        assert_eq!(lost(&outcomes), 17);
        let fault = format!("node 3 (axis 2, bus 0): {why}, for 20 cycles");
        bench.assert_stopped_for_good(&fault);
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

/// Answers of axis 2 that each come so much later, in periods of the SYNC, from bring-up on or in
/// mid-motion.
fn tardy(periods: f64) -> impl FnMut(&Frame) -> Tampering {
    let late_ns = trocar_canopen::number::nanoseconds(periods * 0.002);
    move |frame| {
        if is_answer(frame, 2) {
            Tampering::Delay(late_ns)
        } else {
            Tampering::Pass
        }
    }
}

const UNSTEADY: &str =
    "node 3 (axis 2, bus 0): more than a quarter of its process data is missing or late";

/// Answers that are always late are a fault and none older than five cycles is believed.
#[test]
fn always_late_answers_are_a_fault() {
    for periods in [1.0, 1.4, 2.2, 3.4] {
        let mut bench = moving();
        bench.tamper(tardy(periods));
        let before = bench.arm.cycle().axis_health()[2].late;
        for cycle in 0..60 {
            let measured = bench.cycle(0.0008);
            let real = bench.motors()[2];
            let off = measured.map_or(0.0, |state| (state.position[2] - real).abs());
            // 0.4 units/s.
            assert!(off < 5.0 * 0.0008, "{periods}, {cycle}: {off}");
        }
        let health = bench.arm.cycle().axis_health()[2];
        assert!(health.late > before + 10, "{periods}: {health:?}");
        bench.assert_stopped_for_good(UNSTEADY);
    }
}

/// A drive that answers late from the first SYNC on gives no arm that runs.
#[test]
fn drive_late_from_the_first_sync_gives_no_arm() {
    for periods in [1.0, 2.2] {
        let plan = plan(1, 2 * MS);
        let homed = Offline::new(network(&plan), &plan).unwrap().scan().unwrap();
        let homed = homed.check_identity().unwrap().map().unwrap();
        let mut homed = homed.home().unwrap();
        let mut late = tardy(periods);
        homed
            .bus_mut()
            .tamper(Box::new(move |_, _, frame| late(frame)));
        let mut bench = Bench::of(homed.enable().unwrap(), &plan);
        let _ = bench.cycles(50, 0.0);
        bench.assert_stopped_for_good(UNSTEADY);
    }
}

#[test]
fn a_doubled_answer_does_not_hide_that_all_after_it_are_late() {
    let mut bench = moving();
    let mut count = 0;
    bench.tamper(move |frame| {
        count += u32::from(is_answer(frame, 2));
        match count {
            _ if !is_answer(frame, 2) => Tampering::Pass,
            1 => Tampering::Drop,
            // Two come in this period, as if the late one had come too.
            2 => Tampering::Repeat,
            _ => Tampering::Delay(2 * MS),
        }
    });
    let _ = bench.cycles(70, 0.0008);
    bench.assert_stopped_for_good(UNSTEADY);
}

/// Answers of one axis that come twice hide no other axis that is late or missing.
#[test]
fn duplicate_answers_hide_no_late_axis() {
    type Change = fn(u32) -> Tampering;
    let late: Change = |_| Tampering::Delay(4_400_000);
    let lossy: Change = |count| {
        if count % 2 == 0 {
            Tampering::Drop
        } else {
            Tampering::Pass
        }
    };
    for change in [late, lossy] {
        let mut bench = moving();
        let mut count = 0;
        bench.tamper(move |frame| {
            if is_answer(frame, 1) {
                return Tampering::Repeat;
            }
            count += u32::from(is_answer(frame, 2));
            if is_answer(frame, 2) {
                change(count)
            } else {
                Tampering::Pass
            }
        });
        let _ = bench.cycles(150, 0.0);
        let fault = bench.arm.fault();
        assert!(matches!(fault, Some(Fault::Unsteady(_))), "{fault:?}");
    }
}

/// A SYNC is left out for no longer than drives bridge even when the control thread stalls.
#[test]
fn left_out_syncs_stay_within_what_drives_bridge() {
    let mut bench = moving();
    let mut dropped = false;
    bench.tamper(move |frame| {
        if is_answer(frame, 2) && !dropped {
            dropped = true;
            Tampering::Drop
        } else {
            Tampering::Pass
        }
    });
    let _ = bench.cycle(0.0008);
    bench.dead_for(12 * MS);
    let _ = bench.cycle(0.0);
    assert_eq!(bench.arm.cycle().sync(), Some(bench.now));
}

/// Answers that are lost now and then are not taken for late ones.
#[test]
fn lost_answers_are_not_taken_for_late_ones() {
    for every in [4, 5, 10] {
        let mut bench = moving();
        let mut count = 0;
        bench.tamper(move |frame| {
            count += u32::from(is_answer(frame, 2));
            if is_answer(frame, 2) && count % every == 0 {
                Tampering::Drop
            } else {
                Tampering::Pass
            }
        });
        for cycle in 0..200 {
            assert!(bench.cycle(0.0008).is_ok(), "{every}: {cycle}");
        }
        let health = bench.arm.cycle().axis_health();
        assert!(health[2].missed > 10 && health[2].late == 0, "{health:?}");
        let before = bench.arm.cycle().sync().unwrap();
        bench.net().leave_alone();
        let _ = bench.cycles(100, 0.0008);
        // In step again, and no SYNC is left out any more.
        let after = bench.arm.cycle().sync().unwrap();
        assert!(after.since(before) >= 99 * bench.cycle_ns);
        assert_eq!(bench.arm.cycle().axis_health()[2].age_cycles, 0);
    }
}

/// How many SYNCs are heard in 20 cycles when the first answer of axis 2 is changed.
fn beats(change: fn(&Frame) -> Tampering) -> u32 {
    let mut bench = moving();
    let heard = Rc::new(Cell::new(0));
    let count = Rc::clone(&heard);
    let mut changed = false;
    bench.tamper(move |frame| {
        count.set(count.get() + u32::from(frame.id.raw() == 0x080));
        if is_answer(frame, 2) && !changed {
            changed = true;
            change(frame)
        } else {
            Tampering::Pass
        }
    });
    let _ = bench.cycles(20, 0.0008);
    heard.get()
}

/// One SYNC is left out for an answer that was late lost or doubled.
#[test]
fn one_sync_is_left_out_for_an_ambiguous_answer() {
    assert_eq!(beats(|_| Tampering::Pass), 20);
    assert_eq!(beats(|_| Tampering::Drop), 19);
    assert_eq!(beats(|_| Tampering::Repeat), 19);
    assert_eq!(beats(|_| Tampering::Delay(2 * MS)), 19);
}

/// Answers that are missing too often are a fault although none is missing for long.
#[test]
fn too_many_missing_answers_are_a_fault() {
    let mut bench = moving();
    let mut count = 0;
    bench.tamper(move |frame| {
        count += u32::from(is_answer(frame, 2));
        if is_answer(frame, 2) && count % 2 == 0 {
            Tampering::Drop
        } else {
            Tampering::Pass
        }
    });
    let outcomes: Vec<_> = (0..200).map(|_| bench.cycle(0.0)).collect();
    assert_eq!(lost(&outcomes), 0);
    bench.assert_stopped_for_good(UNSTEADY);
}

#[test]
fn drives_that_are_to_stop_get_every_sync() {
    let mut bench = Bench::on(&plan(3, MS));
    bench.net().bus_off(2, true);
    let _ = bench.cycles(2, 0.0);
    let mut lost = 0;
    bench.tamper(move |frame| {
        lost += u32::from(is_answer(frame, 0));
        if is_answer(frame, 0) && lost % 2 == 0 {
            Tampering::Drop
        } else {
            Tampering::Pass
        }
    });
    for _ in 0..30 {
        let before = bench.arm.cycle().sync();
        let _ = bench.cycle(0.0);
        assert_ne!(bench.arm.cycle().sync(), before);
    }
}
