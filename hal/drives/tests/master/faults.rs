use super::*;
use trocar_canopen::cia301::emcy::ErrorCode;

/// Moving at 0.4 units/s.
pub(super) fn moving() -> Bench {
    let mut bench = Bench::new();
    bench.cycles(50, 0.0008).unwrap();
    bench
}

pub(super) fn is_answer(frame: &Frame, axis: u16) -> bool {
    frame.id.raw() == 0x181 + axis
}

#[test]
fn a_node_that_is_pulled_is_named_and_the_others_stop() {
    let mut bench = moving();
    bench.net().power(node(4), false);
    let _ = bench.cycles(25, 0.0008);
    // Its process data are missed before its heartbeat is.
    assert_eq!(
        bench.arm.fault().unwrap().to_string(),
        "node 5 (axis 4, bus 0): no process data for 20 cycles"
    );
    let _ = bench.cycles(300, 0.0);
    let torques = bench.torques();
    assert!(
        torques
            .iter()
            .enumerate()
            .all(|(axis, torque)| axis == 4 || !torque),
        "{torques:?}"
    );
}

#[test]
fn a_heartbeat_that_stays_out_is_a_fault() {
    let mut bench = moving();
    bench.tamper(|frame| {
        if frame.id.raw() == 0x706 {
            Tampering::Drop
        } else {
            Tampering::Pass
        }
    });
    let _ = bench.cycles(250, 0.0);
    bench.assert_stopped_for_good("node 6 (axis 5, bus 0): no heartbeat");
}

#[test]
fn a_node_that_reboots_is_a_fault() {
    let mut bench = moving();
    bench
        .net()
        .poke(node(2), |now, drive, out| drive.power_on(now, out));
    let _ = bench.cycle(0.0);
    bench.assert_stopped_for_good("node 3 (axis 2, bus 0): was reset while in use");
}

#[test]
fn a_node_that_leaves_operational_is_a_fault() {
    let mut bench = moving();
    let stop = frame(0x000, &[0x80, 3]);
    bench
        .net()
        .poke(node(2), |now, drive, out| drive.on_frame(now, &stop, out));
    let _ = bench.cycles(60, 0.0);
    let fault = bench.arm.fault().unwrap();
    assert_eq!(fault.who().map(|who| who.axis), Some(2));
    let text = fault.to_string();
    bench.assert_stopped_for_good(&text);
}

#[test]
fn an_emergency_is_a_fault_with_the_drives_code() {
    let mut bench = moving();
    bench.net().poke(node(6), |now, drive, out| {
        drive.fail(now, ErrorCode::OVER_CURRENT, 2, out);
    });
    let _ = bench.cycle(0.0);
    let error = bench.cycle(0.0).unwrap_err();
    assert_eq!(
        error,
        ArmError::DriveFault {
            axis: 6,
            code: 0x2310
        }
    );
    bench.assert_stopped_for_good(
        "node 7 (axis 6, bus 0): emergency 2310h, continuous over-current",
    );
}

#[test]
fn a_motor_that_does_not_follow_is_a_fault() {
    let mut bench = moving();
    bench.net().motor(node(1)).unwrap().stuck = true;
    let _ = bench.cycles(100, 0.0008);
    let fault = bench.arm.fault().unwrap();
    // The drive's own window is narrower than the master's.
    assert!(
        matches!(fault, Fault::FollowingError(who, _) if who.axis == 1),
        "{fault}"
    );
    let _ = bench.cycles(400, 0.0);
    assert_eq!(bench.torques(), [false; TAIL_AXES]);
}

/// The master's own comparison catches what a drive does not tell.
#[test]
fn master_detects_an_unreported_following_error() {
    let mut bench = moving();
    // A drive that says all is well and stands still.
    let mut first: Option<Vec<u8>> = None;
    bench.tamper(move |f| {
        if !is_answer(f, 1) {
            return Tampering::Pass;
        }
        let data = first.get_or_insert_with(|| f.data().to_vec());
        Tampering::Replace(frame(f.id.raw(), data))
    });
    let _ = bench.cycles(200, 0.0008);
    let fault = bench.arm.fault().unwrap();
    assert!(
        matches!(fault, Fault::FollowingError(who, _) if who.axis == 1),
        "{fault}"
    );
}

#[test]
fn lost_power_is_a_fault() {
    let mut bench = moving();
    bench.tamper(|f| {
        if !is_answer(f, 0) {
            return Tampering::Pass;
        }
        let mut data = f.data().to_vec();
        data[0] &= !0x10;
        Tampering::Replace(frame(f.id.raw(), &data))
    });
    let _ = bench.cycles(2, 0.0);
    bench.assert_stopped_for_good("node 1 (axis 0, bus 0): the power stage has no voltage");
}

#[test]
fn a_drive_that_disables_itself_is_a_fault() {
    let mut bench = moving();
    bench.tamper(|f| {
        if f.id.raw() == 0x204 {
            Tampering::Replace(frame(0x204, &[0x06, 0, 0, 0, 0, 0]))
        } else {
            Tampering::Pass
        }
    });
    let _ = bench.cycles(40, 0.0);
    let fault = bench.arm.fault().unwrap();
    assert!(
        matches!(fault, Fault::NotEnabled(who, _) if who.axis == 3),
        "{fault}"
    );
}

#[test]
fn a_foreign_master_is_a_fault_and_another_arms_is_not() {
    for (id, data) in [
        (0x080, &[][..]),
        (0x000, &[0x80, 0]),
        (0x000, &[0x02, 3]),
        (0x204, &[0x0F, 0, 0, 0, 0, 0]),
        // Writes to a node: a position offset, a segment, a block.
        (0x603, &[0x23, 0xB0, 0x60, 0, 0, 1, 0, 0]),
        (0x603, &[0x01, 1, 2, 3, 4, 5, 6, 7]),
        (0x603, &[0xC2, 0xB0, 0x60, 0, 4, 0, 0, 0]),
        (0x77F, &[5]),
    ] {
        let mut bench = moving();
        bench.net().intrude(0, frame(id, data));
        let _ = bench.cycles(2, 0.0);
        bench.assert_stopped_for_good(&format!(
            "bus 0: another node sends {id:03X}h, which only this master may"
        ));
    }
    let mut bench = moving();
    for (id, data) in [
        (0x20B, &[0x0F, 0, 0, 0, 0, 0][..]),
        (0x000, &[0x01, 11]),
        (0x77E, &[5]),
        (0x18B, &[0; 8]),
        (0x08B, &[0x10, 0x23, 3, 0, 0, 0, 0, 0]),
        (0x70B, &[0]),
        // Reading is anybody's, and so are the other arm's nodes.
        (0x603, &[0x40, 0x64, 0x60, 0, 0, 0, 0, 0]),
        (0x60B, &[0x23, 0xB0, 0x60, 0, 0, 1, 0, 0]),
    ] {
        bench.net().intrude(0, frame(id, data));
        assert!(bench.cycle(0.0).is_ok(), "{id:03X}");
    }
    assert!(bench.arm.fault().is_none());
}

#[test]
fn lost_set_points_stop_the_drive_that_misses_them() {
    let mut bench = moving();
    bench.tamper(|f| {
        if f.id.raw() == 0x203 {
            Tampering::Drop
        } else {
            Tampering::Pass
        }
    });
    let _ = bench.cycles(30, 0.0008);
    bench.assert_stopped_for_good("node 3 (axis 2, bus 0): emergency 8250h, RPDO overdue");
}

#[test]
fn lost_syncs_stop_every_drive() {
    let mut bench = moving();
    bench.tamper(|f| {
        if f.id.raw() == 0x080 {
            Tampering::Drop
        } else {
            Tampering::Pass
        }
    });
    let _ = bench.cycles(40, 0.0008);
    assert!(bench.arm.fault().is_some());
    let _ = bench.cycles(300, 0.0008);
    let rest = bench.motors();
    let _ = bench.cycles(100, 0.0008);
    assert!(same(&bench.motors(), &rest));
}
