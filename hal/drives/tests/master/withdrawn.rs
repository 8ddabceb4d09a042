//! How drives are taken from a second master that commands them: by NMT, by a heartbeat that ends,
//! and no drives but our own.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::rc::Rc;

use super::*;
use trocar_canopen::cia301::emcy::ErrorCode;
use trocar_canopen::cia402::{Command, ControlView, PowerState};

/// Moving, with drives that keep to CiA 402 by the letter: of the ways out of operational only NMT
/// stopped stops them.
fn by_the_letter() -> Bench {
    by_the_letter_on(&plan(1, 4 * MS))
}

fn by_the_letter_on(plan: &ArmPlan) -> Bench {
    let drive = |axis| {
        let config = AxisConfig {
            stops_in_pre_operational: false,
            ..axis_config(axis)
        };
        Node::new(node(axis), &config)
    };
    let mut bench = Bench::with(network_of(plan, drive), plan);
    bench.cycles(50, 0.0008).unwrap();
    bench
}

/// Cycles in which a stranger enables node 3 anew, with a SYNC of its own, and leads it on from
/// where it is.
fn led(bench: &mut Bench, cycles: u32) {
    for _ in 0..cycles {
        let target = bench.motors()[2] * COUNTS + 100.0;
        let target = i32::try_from(trocar_canopen::number::whole(target)).unwrap();
        let [a, b, c, d] = target.to_le_bytes();
        let mut at = bench.now.plus_ns(1_800_000);
        for control in [0x06, 0x07, 0x0F, 0x0F] {
            let set_point = frame(0x203, &[control, 0, a, b, c, d]);
            for said in [set_point, frame(0x080, &[])] {
                bench.net().wait(at);
                bench.net().intrude(0, said);
                at = at.plus_ns(250_000);
            }
        }
        let _ = bench.cycle(0.0);
    }
}

/// Who was told to stop by NMT, bus and node. No other NMT command is heard.
type NmtStops = Rc<RefCell<BTreeSet<(u8, u8)>>>;

fn note_stops(net: &mut Net) -> NmtStops {
    let told: NmtStops = Rc::default();
    let noted = Rc::clone(&told);
    net.tamper(Box::new(move |line, _, frame| {
        if frame.id.raw() == 0 {
            assert_eq!(frame.data()[0], 0x02, "{frame}");
            noted.borrow_mut().insert((line, frame.data()[1]));
        }
        Tampering::Pass
    }));
    told
}

/// A drive that only NMT stopped stops is not taken for one of a second master.
#[test]
fn drive_stopped_by_nmt_only_has_no_second_master() {
    let mut bench = by_the_letter();
    // Long before it misses a heartbeat.
    led(&mut bench, 25);
    assert_eq!(bench.torques(), [false; TAIL_AXES]);
    let told = "bus 0: another node sends 203h, which only this master may";
    bench.assert_stopped_for_good(told);
}

/// The drive of axis 2 decides to be pre-operational, and nobody has said so.
fn leave(bench: &mut Bench) {
    let leave = frame(0x000, &[0x80, 3]);
    bench
        .net()
        .poke(node(2), |now, drive, out| drive.on_frame(now, &leave, out));
}

/// A drive that pre operational does not stop goes on which is why it is not the way.
#[test]
fn pre_operational_stops_not_every_drive() {
    let mut bench = by_the_letter();
    // It hears nothing but our heartbeat.
    bench.tamper(|frame| match frame.id.raw() {
        0x000 => Tampering::Drop,
        _ => Tampering::Pass,
    });
    leave(&mut bench);
    let _ = bench.cycles(100, 0.0);
    let others = core::array::from_fn(|axis| axis == 2);
    assert_eq!(bench.torques(), others);
}

/// A node that goes pre operational by itself is named and told to stop and the others brake.
#[test]
fn node_leaving_operational_is_named_and_stopped() {
    let plan = ArmPlan {
        heartbeat_ms: 10,
        brake_ns: 0,
        homing: [None; TAIL_AXES],
        ..plan(1, 4 * MS)
    };
    let mut bench = by_the_letter_on(&plan);
    let told = note_stops(bench.net());
    leave(&mut bench);
    let states = |bench: &mut Bench| {
        core::array::from_fn::<_, TAIL_AXES, _>(|axis| {
            bench.net().node(node(axis)).unwrap().power_state()
        })
    };
    while bench.arm.fault().is_none() {
        assert!(told.borrow().is_empty());
        assert_eq!(states(&mut bench)[2], PowerState::OperationEnabled);
        let _ = bench.cycle(0.0008);
    }
    // A set-point that is sent with this SYNC, and it.
    let _ = bench.cycles(2, 0.0008);
    bench.dead_for(4 * MS);
    for (axis, state) in states(&mut bench).into_iter().enumerate() {
        assert_ne!(state, PowerState::OperationEnabled, "{axis}");
    }
    bench.assert_stopped_for_good("node 3 (axis 2, bus 0): went to PreOperational");
    // Nobody else was, and it no longer once it had heard.
    assert_eq!(*told.borrow(), BTreeSet::from([(0, 3)]));
    told.borrow_mut().clear();
    let _ = bench.cycles(10, 0.0);
    assert!(told.borrow().is_empty());
}

#[test]
fn a_node_of_which_nothing_is_heard_any_more_is_told_to_stop() {
    let mut bench = by_the_letter();
    let told: NmtStops = Rc::default();
    let noted = Rc::clone(&told);
    // Nor why: its heartbeats do not come through.
    bench.tamper(move |frame| match (frame.id.raw(), frame.data()) {
        (0x703, _) => Tampering::Drop,
        (0x000, [0x02, node]) => {
            noted.borrow_mut().insert((0, *node));
            Tampering::Pass
        }
        _ => Tampering::Pass,
    });
    leave(&mut bench);
    let text = "node 3 (axis 2, bus 0): no process data for 20 cycles";
    let mut cycles = 0;
    while bench.arm.fault().is_none() {
        assert!(told.borrow().is_empty() && bench.torques()[2]);
        let _ = bench.cycle(0.0);
        cycles += 1;
    }
    assert!(cycles < 25, "{cycles}");
    let _ = bench.cycles(15, 0.0);
    assert_eq!(bench.torques(), [false; TAIL_AXES]);
    assert_eq!(*told.borrow(), BTreeSet::from([(0, 3)]));
    bench.assert_stopped_for_good(text);
}

/// Where no NMT command is heard our heartbeat ends, and its time-out stops the drives.
#[test]
fn ended_heartbeat_stops_drives_deaf_to_nmt() {
    let mut bench = by_the_letter();
    bench.tamper(|frame| match frame.id.raw() {
        0x000 => Tampering::Drop,
        _ => Tampering::Pass,
    });
    led(&mut bench, 25);
    // The stranger's set-points are what counts.
    assert!(bench.torques()[2]);
    // Three of our periods of 100 ms.
    led(&mut bench, 75);
    assert_eq!(bench.torques(), [false; TAIL_AXES]);
}

/// The quick stop comes into effect before the nodes are stopped.
#[test]
fn quick_stop_takes_effect_before_nmt_stop() {
    let mut bench = by_the_letter();
    // Drives that losing their master does not stop.
    for axis in 0..TAIL_AXES {
        let id = 0x600 + u16::from(node(axis).raw());
        let nothing = frame(id, &[0x2B, 0x07, 0x60, 0, 0, 0, 0, 0]);
        let poke = |now, drive: &mut Node, out: &mut _| drive.on_frame(now, &nothing, out);
        bench.net().poke(node(axis), poke);
    }
    let order: Rc<RefCell<Vec<&str>>> = Rc::default();
    let noted = Rc::clone(&order);
    bench.tamper(move |frame| {
        let what = match (frame.id.raw(), frame.data()) {
            (0x000, _) => "NMT",
            (0x080, _) => "SYNC",
            (0x207, [low, high, ..]) => {
                let word = ControlView(u16::from_le_bytes([*low, *high]));
                if word.command() != Command::QuickStop {
                    return Tampering::Pass;
                }
                "quick stop"
            }
            _ => return Tampering::Pass,
        };
        noted.borrow_mut().push(what);
        Tampering::Pass
    });
    // The controller is silent, so set-points leave with the SYNC.
    let _ = bench.read();
    bench.net().intrude(0, frame(0x77F, &[5]));
    let _ = bench.read();
    bench.dead_for(50 * MS);
    let order = order.borrow();
    let first = order.iter().position(|what| *what == "quick stop");
    assert_eq!(order[first.unwrap()..][..3], ["quick stop", "SYNC", "NMT"]);
    assert_eq!(bench.torques(), [false; TAIL_AXES]);
}

#[test]
fn on_three_buses_each_node_is_stopped_on_its_own() {
    let plan = plan(3, MS);
    let mut bench = Bench::on(&plan);
    let told = note_stops(bench.net());
    bench.cycles(10, 0.0).unwrap();
    assert!(told.borrow().is_empty());
    bench.net().intrude(1, frame(0x204, &[0x0F, 0, 0, 0, 0, 0]));
    let _ = bench.cycles(10, 0.0);
    let own = plan.axes.map(|axis| (axis.line, axis.node.raw()));
    assert_eq!(*told.borrow(), BTreeSet::from(own));
}

#[test]
fn second_master_after_a_fault_gets_no_drive() {
    let mut bench = Bench::on(&plan(1, 4 * MS));
    let told = note_stops(bench.net());
    bench.net().poke(node(6), |now, drive, out| {
        drive.fail(now, ErrorCode::OVER_CURRENT, 2, out);
    });
    let _ = bench.cycles(20, 0.0);
    assert!(told.borrow().is_empty());
    led(&mut bench, 10);
    let all = (1..=7).map(|node| (0, node)).collect();
    assert_eq!(*told.borrow(), all);
    bench.assert_stopped_for_good(
        "node 7 (axis 6, bus 0): emergency 2310h, continuous over-current",
    );
}

#[test]
fn second_master_on_another_bus_leaves_a_lost_bus_alone() {
    let mut bench = Bench::on(&plan(3, MS));
    bench.net().trouble(1, ControllerEvent::Down);
    let told = note_stops(bench.net());
    let _ = bench.cycles(5, 0.0);
    assert!(told.borrow().is_empty());
    bench.net().intrude(0, frame(0x202, &[0x0F, 0, 0, 0, 0, 0]));
    let _ = bench.cycles(10, 0.0);
    let others = [(0, 1), (0, 2), (0, 3), (2, 6), (2, 7)];
    assert_eq!(*told.borrow(), BTreeSet::from(others));
    assert_eq!(bench.net().waiting(0, 1), 0);
    bench.assert_stopped_for_good("bus 1: the interface is down");
}
