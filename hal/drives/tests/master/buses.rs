//! What becomes of an arm when a bus, or our end of it, fails.

use super::faults::moving;
use super::*;

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
    for trouble in [ControllerEvent::BusOff, ControllerEvent::Down] {
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

/// A controller that was restarted unnoticed is a fault and not sent to.
#[test]
fn restarted_controller_is_a_fault() {
    let mut bench = moving();
    bench.net().trouble(0, ControllerEvent::Restarted);
    let _ = bench.cycle(0.0008);
    assert!(bench.arm.cycle().line_health()[0].off);
    bench.assert_stopped_for_good("bus 0: our controller is bus-off");
}

#[test]
fn an_interface_that_goes_down_is_a_fault() {
    let mut bench = moving();
    bench.net().trouble(0, ControllerEvent::Down);
    let _ = bench.cycle(0.0);
    bench.assert_stopped_for_good("bus 0: the interface is down");
}

#[test]
fn error_passive_and_lost_frames_are_told_and_the_arm_goes_on() {
    let mut bench = moving();
    bench.net().trouble(0, ControllerEvent::ErrorPassive);
    bench.net().trouble(0, ControllerEvent::ErrorPassive);
    bench.net().trouble(0, ControllerEvent::Lost(3));
    bench.net().trouble(0, ControllerEvent::Foreign);
    assert!(bench.cycle(0.0008).is_ok());
    let health = bench.arm.cycle().line_health()[0];
    assert!(health.passive);
    assert_eq!((health.lost, health.foreign), (3, 1));
    bench.net().trouble(0, ControllerEvent::ErrorActive);
    assert!(bench.cycle(0.0008).is_ok());
    let health = bench.arm.cycle().line_health()[0];
    assert!(!health.passive);
    assert_eq!(health.passives, 1);
}

/// A controller that became error passive during bring up is told of with the arm.
#[test]
fn error_passive_during_bring_up_is_reported() {
    for recovers in [false, true] {
        let plan = plan(3, MS);
        let mut net = network(&plan);
        net.trouble(1, ControllerEvent::ErrorPassive);
        if recovers {
            net.trouble(1, ControllerEvent::ErrorActive);
        }
        let mut bench = Bench::with(net, &plan);
        assert!(bench.cycles(5, 0.0).is_ok());
        let health = bench.arm.cycle().line_health();
        let passive = health.map(|health| (health.passive, health.passives));
        let (is, times) = (!recovers, u64::from(!recovers));
        assert_eq!(passive, [(false, 0), (is, times), (false, 0)]);
    }
}

#[test]
fn a_full_send_queue_is_a_lost_arm_and_then_a_fault() {
    let plan = plan(1, 2 * MS);
    let mut bench = Bench::on(&plan);
    bench.cycles(50, 0.0008).unwrap();
    // A node that always wins arbitration: nothing of ours gets out.
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
            let frames = [frame(0x201, &[]), frame(0x202, &[])];
            cycle.on_sent(0, &frames, if set_points { 2 } else { 1 });
            // A SYNC alone finds room more easily; that does not make the cycle whole.
            cycle.on_sent(0, &frames[..1], 1);
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
