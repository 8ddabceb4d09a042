use std::cell::RefCell;
use std::rc::Rc;

use super::*;
use trocar_canopen::cia301::NmtState;
use trocar_canopen::cia402::{PowerState, Status};
use trocar_canopen::master::{Permission, enable_together};

/// Seven axes come up at 500 Hz on one bus and at 1 kHz on three.
#[test]
fn seven_axes_come_up_on_one_bus_and_on_three() {
    for plan in [plan(1, 2 * MS), plan(3, MS)] {
        let mut bench = Bench::on(&plan);
        assert!(bench.arm.cycle().is_enabled());
        let state = bench.cycles(5, 0.0).unwrap();
        for axis in 0..6 {
            assert!((state.position[axis] - bench.position[axis]).abs() < 1e-4);
        }
        assert_eq!(bench.torques(), [true; TAIL_AXES]);
    }
}

/// Seven axes at 1 kHz on one bus are refused with the arithmetic.
#[test]
fn one_bus_at_1_khz_is_refused_with_the_arithmetic() {
    let plan = plan(1, MS);
    let error = Offline::new(network(&plan), &plan).unwrap_err();
    assert_eq!(
        error.to_string(),
        "bus 0: 1 SYNC x 55 + 7 set-points x 115 + 7 answers x 135 + heartbeats of 8 nodes = 1811 bits with stuffing, \
         but a cycle of 1000 us at 1 Mbit/s has 1000: 181.1 % of the bus, of which at most 95 % may be planned; use more \
         buses or a longer cycle"
    );
}

#[test]
fn a_plan_that_the_wire_cannot_carry_fails_on_it() {
    // The plan says 1 Mbit/s, but the wire has half of it.
    let plan = plan(1, 2 * MS);
    let mut net: Net = Network::new(1, 500_000, 64);
    for axis in 0..TAIL_AXES {
        net.add(0, drive(axis), IdealMotor::default());
    }
    let homed = Offline::new(net, &plan).unwrap().scan().unwrap();
    let homed = homed
        .check_identity()
        .unwrap()
        .map()
        .unwrap()
        .home()
        .unwrap();
    // A few cycles may fit into the queues; many do not.
    let mut arm = homed.enable().unwrap();
    let start = arm.bus_mut().now();
    for n in 1..200 {
        let now = start.plus_ns(n * plan.cycle_ns);
        arm.bus_mut().wait(now);
        let _ = arm.read(now);
    }
    let health = arm.cycle().axis_health();
    assert!(arm.fault().is_some() && health[6].missed > 20, "{health:?}");
}

#[test]
fn a_missing_node_is_named() {
    let plan = plan(1, 2 * MS);
    let mut net = network(&plan);
    net.power(node(4), false);
    let error = Offline::new(net, &plan)
        .unwrap()
        .scan()
        .map(|_| ())
        .unwrap_err();
    assert_eq!(
        error.to_string(),
        "node 5 (axis 4, bus 0): does not answer to a reset"
    );
}

#[test]
fn a_drive_of_another_make_is_refused() {
    let plan = plan(1, 2 * MS);
    let mut net: Net = Network::new(1, plan.bit_rate, 64);
    for axis in 0..TAIL_AXES {
        let config = AxisConfig {
            identity: (0, if axis == 2 { 77 } else { PRODUCT_CODE }),
            ..AxisConfig::default()
        };
        net.add(0, Node::new(node(axis), &config), IdealMotor::default());
    }
    let scanned = Offline::new(net, &plan).unwrap().scan().unwrap();
    let error = scanned.check_identity().map(|_| ()).unwrap_err();
    assert_eq!(
        error.to_string(),
        "node 3 (axis 2, bus 0): 1018:02 is 0x4d instead of 0x54524f43"
    );
}

#[test]
fn another_vendor_profile_or_modes_are_refused() {
    // What node 3 says of an object instead of what it is.
    for (object, value, refusal) in [
        (
            0x1000_u16,
            0x0002_0191_u32,
            "1000:00 is 0x191 instead of 0x192",
        ),
        (0x1018, 7, "1018:01 is 0x7 instead of 0x0"),
        (0x6502, 1 << 7, "has no Homing mode"),
        (0x6502, 1 << 5, "has no CyclicPosition mode"),
    ] {
        let plan = plan(1, 2 * MS);
        let scanned = Offline::new(network(&plan), &plan).unwrap().scan();
        let mut scanned = scanned.unwrap();
        scanned.bus_mut().tamper(Box::new(move |_, _, f| {
            let about = f.data().get(1..3) == Some(&object.to_le_bytes());
            if f.id.raw() == 0x583 && about {
                let mut data = f.data().to_vec();
                // A value of four bytes, whatever it was.
                data[0] = 0x43;
                data[4..].copy_from_slice(&value.to_le_bytes());
                Tampering::Replace(frame(0x583, &data))
            } else {
                Tampering::Pass
            }
        }));
        let error = scanned.check_identity().map(|_| ()).unwrap_err();
        assert_eq!(
            error.to_string(),
            format!("node 3 (axis 2, bus 0): {refusal}")
        );
    }
}

/// Serial numbers are read and nothing has torque before enabling.
#[test]
fn no_drive_has_torque_before_enabling() {
    let plan = plan(1, 2 * MS);
    let identified = Offline::new(network(&plan), &plan)
        .unwrap()
        .scan()
        .unwrap()
        .check_identity()
        .unwrap();
    assert_eq!(identified.serials(), &[100, 101, 102, 103, 104, 105, 106]);
    let homed = identified.map().unwrap().home().unwrap();
    let mut arm = homed.enable().unwrap();
    let now = arm.bus_mut().now();
    let mut net = arm.release();
    net.wait(now.plus_ns(100 * MS));
    for axis in 0..TAIL_AXES {
        let node = net.node(node(axis)).unwrap();
        assert!(!node.power_state().has_torque());
        assert_eq!(node.nmt_state(), NmtState::Stopped);
    }
}

#[test]
fn a_drive_that_does_not_become_enabled_ends_the_bring_up() {
    let plan = plan(1, 2 * MS);
    let homed = Offline::new(network(&plan), &plan).unwrap().scan().unwrap();
    let homed = homed.check_identity().unwrap().map().unwrap();
    let homed = homed.home().unwrap();
    let mut homed = homed;
    homed.bus_mut().tamper(Box::new(|_, _, f| {
        // Node 6 is always told to let go.
        if f.id.raw() == 0x206 {
            Tampering::Replace(frame(0x206, &[0x06, 0, 0, 0, 0, 0]))
        } else {
            Tampering::Pass
        }
    }));
    let error = homed.enable().map(|_| ()).unwrap_err();
    assert!(
        matches!(error, BringUpError::Fault(Fault::NotEnabled(..))),
        "{error}"
    );
}

/// An arm with its references whose frames are recorded; `replaced` stands for those that it is
/// about.
fn recorded(
    mut replaced: impl FnMut(&Frame) -> Option<Frame> + 'static,
) -> (Homed<Net>, Rc<RefCell<Vec<Frame>>>) {
    let plan = plan(1, 2 * MS);
    let homed = Offline::new(network(&plan), &plan).unwrap().scan().unwrap();
    let homed = homed.check_identity().unwrap().map().unwrap();
    let mut homed = homed.home().unwrap();
    let frames = Rc::new(RefCell::new(Vec::new()));
    let record = Rc::clone(&frames);
    homed.bus_mut().tamper(Box::new(move |_, _, f| {
        let passed = replaced(f);
        record.borrow_mut().push(passed.unwrap_or(*f));
        passed.map_or(Tampering::Pass, Tampering::Replace)
    }));
    (homed, frames)
}

/// Power states that the drives report in `frames`, of nodes 1 to 7 each.
fn reported(frames: &[Frame]) -> [Vec<PowerState>; TAIL_AXES] {
    core::array::from_fn(|axis| {
        let id = 0x180 + u16::from(node(axis).raw());
        let own = frames.iter().filter(|frame| frame.id.raw() == id);
        let word = |frame: &Frame| u16::from_le_bytes([frame.data()[0], frame.data()[1]]);
        own.map(|frame| Status::parse(word(frame)).unwrap().state)
            .collect()
    })
}

/// A drive that is never enabled: the others, which have torque, are taken down before any node is
/// stopped.
#[test]
fn failed_enabling_takes_down_the_drives_that_have_torque() {
    let (homed, frames) = recorded(|f| {
        // Node 6 is always told to be switched on and no more.
        (f.id.raw() == 0x206 && f.data()[0] == 0x0F).then(|| frame(0x206, &[0x07, 0, 0, 0, 0, 0]))
    });
    let error = homed.enable().map(|_| ()).unwrap_err();
    assert!(
        matches!(error, BringUpError::Fault(Fault::NotEnabled(..))),
        "{error}"
    );
    let frames = frames.take();
    let stop = |f: &Frame| f.id.raw() == 0 && f.data()[0] == 0x02;
    // Stops that wait in the queue when the arm is gone are on no bus.
    let stopped = frames.iter().position(stop).unwrap_or(frames.len());
    let before = reported(&frames[..stopped]);
    assert!(before[0].contains(&PowerState::OperationEnabled));
    for states in &before {
        assert_eq!(states.last(), Some(&PowerState::SwitchOnDisabled));
    }
}

/// A drive that has torque and is heard of no more: the error says that it may still have it.
#[test]
fn drive_that_falls_silent_while_enabled_is_not_taken_for_down() {
    let (mut homed, _frames) = recorded(|_| None);
    let mut enabled = false;
    homed.bus_mut().tamper(Box::new(move |_, _, f| {
        let word = || u16::from_le_bytes([f.data()[0], f.data()[1]]);
        if f.id.raw() == 0x206 && f.data()[0] == 0x0F {
            return Tampering::Replace(frame(0x206, &[0x07, 0, 0, 0, 0, 0]));
        }
        if f.id.raw() == 0x181 {
            enabled |= Status::parse(word()).is_ok_and(|status| status.state.has_torque());
            if enabled {
                return Tampering::Drop;
            }
        }
        Tampering::Pass
    }));
    let error = homed.enable().map(|_| ()).unwrap_err();
    assert!(matches!(error, BringUpError::NotDown(_)), "{error}");
    assert!(
        error
            .to_string()
            .ends_with("not all drives have confirmed that they have no torque")
    );
}

/// No drive has torque while nobody has granted it, and those of whom it is denied never have.
#[test]
fn drives_wait_without_torque_until_it_is_granted() {
    for last in [Permission::Granted, Permission::Denied] {
        let (homed, frames) = recorded(|_| None);
        let mut asked = 0;
        let record = Rc::clone(&frames);
        let enabled = enable_together(vec![homed], &mut || {
            asked += 1;
            if asked < 50 {
                return Permission::Pending;
            }
            let so_far = reported(&record.borrow());
            assert!(so_far.iter().flatten().all(|state| !state.has_torque()));
            last
        });
        let has_torque = |states: &Vec<PowerState>| states.iter().any(|state| state.has_torque());
        let states = reported(&frames.borrow());
        match last {
            Permission::Granted => {
                assert!(enabled.unwrap()[0].cycle().is_enabled());
                assert!(states.iter().all(has_torque));
            }
            Permission::Denied | Permission::Pending => {
                assert_eq!(enabled.map(|_| ()).unwrap_err(), (0, BringUpError::Denied));
                assert!(!states.iter().any(has_torque));
            }
        }
    }
}

#[test]
fn an_operator_may_bring_the_arm_up_again_after_a_fault() {
    let mut bench = Bench::new();
    bench.net().poke(node(1), |now, drive, out| {
        drive.fail(
            now,
            trocar_canopen::cia301::emcy::ErrorCode::OVER_CURRENT,
            2,
            out,
        );
    });
    let _ = bench.cycles(100, 0.0);
    assert!(bench.arm.fault().is_some());
    let net = bench.arm.release();
    let plan = plan(1, 2 * MS);
    let again = Offline::new(net, &plan).unwrap().scan().unwrap();
    let again = again
        .check_identity()
        .unwrap()
        .map()
        .unwrap()
        .home()
        .unwrap();
    let arm = again.enable().unwrap();
    assert_eq!(
        arm.cycle().states(),
        [Some(PowerState::OperationEnabled); TAIL_AXES]
    );
}

/// Buses after bus-off on bus 0 and the fault that it was.
fn released_after_bus_off() -> Net {
    let mut bench = Bench::new();
    bench.net().bus_off(0, true);
    let _ = bench.cycles(100, 0.0);
    assert!(matches!(bench.arm.fault(), Some(Fault::BusOff { line: 0 })));
    bench.arm.release()
}

/// A controller that was bus off and is back is no reason to refuse a new bring up.
#[test]
fn bring_up_accepts_a_controller_back_from_bus_off() {
    let plan = plan(1, 2 * MS);
    let scan = |net| {
        let scanned = Offline::new(net, &plan).unwrap().scan();
        scanned.map_err(|error| error.to_string())
    };
    let mut net = released_after_bus_off();
    net.bus_off(0, false);
    net.bus_off(0, true);
    net.bus_off(0, false);
    let identified = scan(net).unwrap().check_identity().unwrap();
    let arm = identified.map().unwrap().home().unwrap().enable().unwrap();
    assert!(arm.cycle().is_enabled());
    // One that left it again is still off, and of an interface nothing says that it is up again.
    let off = Err("bus 0: bus-off or down".to_owned());
    for down in [false, true] {
        let mut net = released_after_bus_off();
        net.bus_off(0, false);
        if down {
            net.trouble(0, ControllerEvent::Down);
            net.trouble(0, ControllerEvent::Restarted);
        } else {
            net.bus_off(0, true);
        }
        assert_eq!(scan(net).map(|_| ()), off);
    }
}

/// What a drive has stored neither shifts it nor leaves a second way to it.
#[test]
fn stored_offsets_and_pdos_are_cleared() {
    use trocar_canopen::index;
    use trocar_canopen::master::client::{read_number, write};

    let plan = plan(1, 2 * MS);
    let scanned = Offline::new(network(&plan), &plan).unwrap().scan();
    let mut scanned = scanned.unwrap();
    let invalid = 1_u32 << 31;
    {
        let net = scanned.bus_mut();
        let mut put = |address, data: &[u8]| write(net, 0, node(2), address, data).unwrap();
        put(index::POSITION_OFFSET, &6000_i32.to_le_bytes());
        put(index::rpdo(1, 1), &0x303_u32.to_le_bytes());
        put(index::tpdo(2, 1), &(0x4000_0383_u32).to_le_bytes());
        put(index::STORE, b"save");
    }
    let homed = scanned.check_identity().unwrap().map().unwrap().home();
    let mut homed = homed.unwrap();
    let mut get = |address| read_number(homed.bus_mut(), 0, node(2), address).unwrap();
    assert_eq!(get(index::POSITION_OFFSET), 0);
    assert_ne!(get(index::rpdo(1, 1)) & invalid, 0);
    assert_ne!(get(index::tpdo(2, 1)) & invalid, 0);
    let mut bench = Bench::of(homed.enable().unwrap(), &plan);
    assert!(bench.cycles(5, 0.0).is_ok());
}
