use super::*;
use crate::can::cia301::emcy::ErrorCode;

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
fn bus_off_is_a_fault_at_once_and_nothing_stale_leaves_later() {
    let mut bench = moving();
    bench.net().bus_off(0, true);
    assert!(matches!(
        bench.cycle(0.0008),
        Err(ArmError::DriveFault { code: 0x8140, .. })
    ));
    let _ = bench.cycles(20, 0.0008);
    assert_eq!(bench.net().waiting(0, 0), 0);
    bench.net().bus_off(0, false);
    bench.assert_stopped_for_good("bus 0: our controller is bus-off");
}

#[test]
fn bus_off_on_one_of_three_buses_stops_the_axes_on_the_others() {
    let mut bench = Bench::on(&plan(3, MS));
    bench.cycles(50, 0.0004).unwrap();
    bench.net().bus_off(1, true);
    let _ = bench.cycles(20, 0.0004);
    bench.assert_stopped_for_good("bus 1: our controller is bus-off");
}

#[test]
fn a_second_bus_that_goes_off_or_down_is_not_sent_to_either() {
    for trouble in [Trouble::BusOff, Trouble::Down] {
        let mut bench = Bench::on(&plan(3, MS));
        bench.cycles(50, 0.0004).unwrap();
        bench.net().bus_off(1, true);
        let _ = bench.cycles(5, 0.0004);
        bench.net().trouble(2, trouble);
        let _ = bench.cycles(2, 0.0);
        let before = bench.net().wire(2).busy().1;
        // Three drives' heartbeats in 90 ms, and nothing of ours.
        let _ = bench.cycles(90, 0.0);
        assert!(bench.net().wire(2).busy().1 - before < 10, "{trouble:?}");
        let off = bench.arm.cycle().line_health().map(|health| health.off);
        assert_eq!(off, [false, true, true]);
        // The first one is the cause.
        bench.assert_stopped_for_good("bus 1: our controller is bus-off");
    }
}

#[test]
fn an_interface_that_goes_down_is_a_fault() {
    let mut bench = moving();
    bench.net().trouble(0, Trouble::Down);
    let _ = bench.cycle(0.0);
    bench.assert_stopped_for_good("bus 0: the interface is down");
}

#[test]
fn error_passive_and_lost_frames_are_told_and_the_arm_goes_on() {
    let mut bench = moving();
    bench.net().trouble(0, Trouble::ErrorPassive);
    bench.net().trouble(0, Trouble::Lost(3));
    bench.net().trouble(0, Trouble::Foreign);
    assert!(bench.cycle(0.0008).is_ok());
    let health = bench.arm.cycle().line_health()[0];
    assert!(health.passive);
    assert_eq!((health.lost, health.foreign), (3, 1));
    bench.net().trouble(0, Trouble::ErrorActive);
    assert!(bench.cycle(0.0008).is_ok());
    let health = bench.arm.cycle().line_health()[0];
    assert!(!health.passive);
    assert_eq!(health.passives, 1);
}

#[test]
fn a_full_send_queue_is_a_lost_arm_and_then_a_fault() {
    let plan = plan(1, 2 * MS);
    let mut bench = Bench::on(&plan);
    bench.cycles(50, 0.0008).unwrap();
    // Somebody who always wins the bus: nothing of ours gets out.
    let mut outcomes = Vec::new();
    for _ in 0..60 {
        for _ in 0..25 {
            bench.net().intrude(0, frame(0x001, &[0; 8]));
        }
        outcomes.push(bench.cycle(0.0));
    }
    let lost = outcomes
        .iter()
        .position(|o| matches!(o, Err(ArmError::MeasurementLost { .. })));
    let fault = outcomes
        .iter()
        .position(|o| matches!(o, Err(ArmError::DriveFault { .. })));
    assert!(lost < fault && lost.is_some(), "{outcomes:?}");
    assert!(bench.arm.cycle().line_health()[0].unsent > 0);
    assert!(bench.arm.fault().is_some());
}

#[test]
fn no_room_for_20_cycles_is_told_as_such() {
    let plan = plan(1, 2 * MS);
    let mut cycle = cycle::Cycle::new(&plan, TimeNs(0));
    let mut pass = |set_points: bool, count: u32| {
        for _ in 0..count {
            cycle.on_sent(0, set_points);
            // A SYNC alone finds room more easily; that does not make the cycle whole.
            cycle.on_sent(0, true);
            cycle.judge(TimeNs(0));
        }
        cycle.fault().map(|fault| fault.to_string())
    };
    assert_eq!(pass(false, 19), None);
    assert_eq!(pass(true, 1), None);
    assert_eq!(pass(false, 19), None);
    assert_eq!(
        pass(false, 1).as_deref(),
        Some("bus 0: no room for set-points in the send queue for 20 cycles")
    );
}

#[test]
fn a_node_that_is_pulled_is_named_and_the_others_stop() {
    let mut bench = moving();
    bench.net().power(node(4), false);
    let _ = bench.cycles(25, 0.0008);
    // Its process data are missed before its heartbeat is.
    assert_eq!(
        bench.arm.fault().unwrap().to_string(),
        "node 5 (axis 4, bus 0): no usable process data in time for 20 cycles"
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

#[test]
fn the_masters_own_comparison_catches_what_a_drive_does_not_tell() {
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
            "bus 0: somebody else sends {id:03X}h, which only this master may"
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
