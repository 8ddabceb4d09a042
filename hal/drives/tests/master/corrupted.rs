//! What becomes of an arm when the frames to its drives are other ones than were sent.

use super::faults::moving;
use super::*;
use trocar_canopen::cia301::NmtState;

/// Changes the next `count` frames under `id`.
fn change(bench: &mut Bench, id: u16, count: u32, to: impl Fn(&Frame) -> Tampering + 'static) {
    let mut left = count;
    bench.tamper(move |frame| {
        if frame.id.raw() == id && left > 0 {
            left -= 1;
            to(frame)
        } else {
            Tampering::Pass
        }
    });
}

fn resized(frame: &Frame, length: usize) -> Tampering {
    let mut data = frame.data().to_vec();
    data.resize(length, 0);
    Tampering::Replace(super::frame(frame.id.raw(), &data))
}

/// A short or long set point is told by its drive and is a fault.
#[test]
fn set_point_of_wrong_length_is_a_fault() {
    for (length, fault) in [
        (5, "emergency 8210h, PDO too short for its mapping"),
        (0, "emergency 8210h, PDO too short for its mapping"),
        (8, "emergency 8220h, PDO longer than its mapping"),
    ] {
        let mut bench = moving();
        change(&mut bench, 0x203, 1, move |frame| resized(frame, length));
        let _ = bench.cycles(3, 0.0008);
        bench.assert_stopped_for_good(&format!("node 3 (axis 2, bus 0): {fault}"));
    }
}

/// A SYNC of the wrong length is told by a drive and is a fault.
#[test]
fn sync_of_wrong_length_is_a_fault() {
    let mut bench = moving();
    change(&mut bench, 0x080, 1, |frame| resized(frame, 1));
    let _ = bench.cycles(3, 0.0008);
    let fault = bench.arm.fault().unwrap();
    assert_eq!(fault.code().0, 0x8240, "{fault}");
    bench.assert_stopped_for_good(&fault.to_string());
}

/// Flips a bit of the next `count` set-points' target; gives the arm, how far axis 2 was from its
/// way at most and at the end, and how far it went in a cycle.
fn flipped(count: u32, byte: usize, bit: u8) -> (Bench, f64, f64, f64) {
    let mut bench = moving();
    change(&mut bench, 0x203, count, move |frame| {
        let mut data = frame.data().to_vec();
        data[byte] ^= 1 << bit;
        Tampering::Replace(super::frame(frame.id.raw(), &data))
    });
    let (mut off, mut last, mut step): (f64, f64, f64) = (0.0, 0.0, 0.0);
    let mut before = bench.motors();
    for _ in 0..20 {
        let _ = bench.cycle(0.0008);
        let motors = bench.motors();
        // The others are the measure of where it should be.
        let apart = motors[2] - motors[1] - (bench.position[2] - bench.position[1]);
        last = apart.abs();
        off = off.max(last);
        step = step.max((motors[2] - before[2]).abs());
        before = motors;
    }
    (bench, off, last, step)
}

/// A flipped bit in a set point moves an axis no faster than it may and one that stays is a fault.
#[test]
fn flipped_target_bit_keeps_the_speed_limit() {
    // A small one is gone with the next set-point.
    let (bench, off, ..) = flipped(1, 3, 0);
    assert!(bench.arm.fault().is_none() && off < 0.003, "{off}");
    // The drive's greatest speed, as bring-up has set it.
    let (cycle_s, speed) = (0.002, 2.2);
    for (byte, bit) in [(4, 6), (5, 6), (5, 7)] {
        // A large one takes the axis along for a cycle, against its own way, and the next
        // set-points bring it back.
        let (bench, off, last, step) = flipped(1, byte, bit);
        assert!(step < speed * cycle_s + 1e-6, "{step} in a cycle");
        assert!(off < 3.0 * speed * cycle_s, "{off}");
        assert!(bench.arm.fault().is_none() && last < 1e-4, "{last}");
        // One that stays is further away than the axis may lag.
        let (mut bench, _, _, step) = flipped(1000, byte, bit);
        assert!(step < speed * cycle_s + 1e-6, "{step} in a cycle");
        let _ = bench.cycles(30, 0.0008);
        let fault = bench.arm.fault().unwrap();
        assert!(
            matches!(fault, Fault::FollowingError(who, _) if who.axis == 2),
            "{fault}"
        );
        bench.assert_stopped_for_good(&fault.to_string());
    }
}

#[test]
fn a_flipped_bit_in_a_control_word_is_a_fault_or_nothing() {
    for bit in 0..16 {
        let mut bench = moving();
        change(&mut bench, 0x203, 1, move |frame| {
            let mut data = frame.data().to_vec();
            data[bit / 8] ^= 1 << (bit % 8);
            Tampering::Replace(super::frame(frame.id.raw(), &data))
        });
        let outcome = bench.cycles(20, 0.0008);
        // Without voltage or with a quick stop the drive is no longer enabled. The other commands
        // begin a ramp, from which the next set-point calls it back; the other bits mean nothing to
        // a drive that follows.
        match (bit, bench.arm.fault()) {
            (1..=2, Some(Fault::NotEnabled(who, _))) => {
                assert_eq!(who.axis, 2, "bit {bit}");
                let fault = bench.arm.fault().unwrap().to_string();
                bench.assert_stopped_for_good(&fault);
            }
            (0 | 3.., None) => assert!(outcome.is_ok()),
            (_, fault) => panic!("bit {bit}: {fault:?}"),
        }
    }
}

#[test]
fn a_single_set_point_sync_or_both_may_be_lost_late_or_doubled() {
    for id in [0x203, 0x080] {
        for what in [Tampering::Drop, Tampering::Delay(MS), Tampering::Repeat] {
            let mut bench = moving();
            change(&mut bench, id, 1, move |_| what);
            for _ in 0..20 {
                assert!(bench.cycle(0.0008).is_ok(), "{id:03X} {what:?}");
            }
            let state = bench.cycle(0.0008).unwrap();
            for axis in 0..6 {
                let behind = (bench.position[axis] - state.position[axis]) / 0.0008;
                assert!((2.0..4.0).contains(&behind), "{id:03X} {what:?}: {behind}");
            }
        }
    }
}

#[test]
fn a_second_node_with_a_drives_number_is_a_fault() {
    let mut bench = moving();
    let beat = NmtState::Operational.emit(node(2));
    bench.net().intrude(0, beat);
    let _ = bench.cycles(2, 0.0008);
    let fault = bench.arm.fault().unwrap();
    assert_eq!(fault.who().map(|who| who.axis), Some(2));
    assert_eq!(fault.code().0, 0x8150, "{fault}");
    bench.assert_stopped_for_good(&fault.to_string());
}

#[test]
fn an_emergency_that_says_all_is_well_is_none() {
    let mut bench = moving();
    bench.net().intrude(0, frame(0x083, &[0; 8]));
    // And one that is too short says nothing.
    bench.net().intrude(0, frame(0x084, &[0x10, 0x23]));
    assert!(bench.cycles(5, 0.0008).is_ok());
    assert!(bench.arm.fault().is_none());
}

/// Answers that change places are believed only as far as an axis can go.
#[test]
fn swapped_answers_are_limited_by_the_axis_speed() {
    let mut bench = moving();
    // What axis 0 says arrives as what axis 6 says, and the other way round; they are far from each
    // other.
    bench.tamper(|f| match f.id.raw() {
        0x181 => Tampering::Replace(frame(0x187, f.data())),
        0x187 => Tampering::Replace(frame(0x181, f.data())),
        _ => Tampering::Pass,
    });
    let outcomes: Vec<_> = (0..40).map(|_| bench.cycle(0.0)).collect();
    let lost = |o: &&Result<ArmState, ArmError>| matches!(o, Err(ArmError::MeasurementLost { .. }));
    assert!(outcomes.iter().filter(lost).count() > 5, "{outcomes:?}");
    let health = bench.arm.cycle().axis_health();
    assert!(health[0].rejected >= 20 && health[6].rejected >= 20);
    bench.assert_stopped_for_good(
        "node 1 (axis 0, bus 0): a position that the axis cannot have reached, for 20 cycles",
    );
}
