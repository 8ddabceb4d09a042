//! What drives have stored to say and to hear beside the plan: bring-up takes it out of use, so
//! that a bus carries what was planned.

use std::cell::RefCell;
use std::collections::{BTreeMap, BTreeSet};
use std::rc::Rc;

use super::*;
use trocar_canopen::cia301::AbortCode;
use trocar_canopen::index;
use trocar_canopen::master::client::{read_number, write};

const INVALID: u32 = 1 << 31;

type Objects = Rc<RefCell<BTreeMap<(u16, u8), u32>>>;
type SdoReads = Rc<RefCell<BTreeSet<(u16, u8)>>>;

/// What becomes of a COB-ID that is written, from what it was; none if it may not change so.
type Rule = fn(u32, u32) -> Option<u32>;

/// The standard's: while a PDO is in use, no other bits change than those that say so.
const STANDARD: Rule =
    |old, new| (old & INVALID != 0 || (old ^ new) & !(3 << 30) == 0).then_some(new);

/// Gives node 3 COB-IDs that our drives do not have, which keep `rule`; notes what it is asked for.
fn more(
    objects: &Objects,
    asked: &SdoReads,
    rule: Rule,
) -> impl FnMut(u8, TimeNs, &Frame) -> Tampering + 'static {
    let (objects, asked) = (Rc::clone(objects), Rc::clone(asked));
    let mut reply = None;
    move |_, _, f| {
        let &[command, low, high, sub, a, b, c, d] = f.data() else {
            return Tampering::Pass;
        };
        let place = (u16::from_le_bytes([low, high]), sub);
        if f.id.raw() == 0x603 {
            asked.borrow_mut().insert(place);
            reply = objects.borrow_mut().get_mut(&place).map(|value| {
                let new = u32::from_le_bytes([a, b, c, d]);
                let (code, said) = match (command, rule(*value, new)) {
                    (0x40, _) => (0x43, *value),
                    (_, None) => (0x80, AbortCode::VALUE.0),
                    (_, Some(kept)) => {
                        *value = kept;
                        (0x60, 0)
                    }
                };
                let [a, b, c, d] = said.to_le_bytes();
                frame(0x583, &[code, low, high, sub, a, b, c, d])
            });
        }
        match (f.id.raw(), reply) {
            (0x583, Some(told)) => {
                reply = None;
                Tampering::Replace(told)
            }
            _ => Tampering::Pass,
        }
    }
}

/// What node 3 makes of `stored` in bring-up, up to where all is set, or why it is refused.
fn mapped(
    plan: &ArmPlan,
    stored: &[((u16, u8), u32)],
    asked: &SdoReads,
    rule: Rule,
) -> Result<BTreeMap<(u16, u8), u32>, String> {
    let objects: Objects = Rc::default();
    objects.borrow_mut().extend(stored.iter().copied());
    let mut scanned = Offline::new(network(plan), plan).unwrap().scan().unwrap();
    let tamper = more(&objects, asked, rule);
    scanned.bus_mut().tamper(Box::new(tamper));
    let identified = scanned.check_identity().unwrap();
    identified.map().map_err(|error| error.to_string())?;
    Ok(objects.take())
}

/// A PDO is off whatever else a drive then says of it and one that stays on is refused.
#[test]
fn pdo_that_stays_valid_is_refused() {
    let plan = plan(1, 2 * MS);
    let place = (0x1404, 1);
    let of = |rule| mapped(&plan, &[(place, 0x345)], &SdoReads::default(), rule);
    // Nothing is left but that it is off.
    let after = of(|_, new| Some(if new & INVALID == 0 { new } else { INVALID }));
    assert_eq!(after.unwrap()[&place], INVALID);
    let refusal = "node 3: 1404:01 is 00000345h after 80000345h was written, and they may not differ in 80000000h";
    assert_eq!(of(|old, _| Some(old)), Err(refusal.to_owned()));
}

/// Of a PDO that is put into use a drive may change what nobody uses but not its identifier.
#[test]
fn pdo_in_use_keeps_its_identifier() {
    const NO_RTR: u32 = 1 << 30;
    let plan = plan(1, 2 * MS);
    for (place, id) in [((0x1400, 1), 0x203), ((0x1800, 1), 0x183)] {
        let of = |rule| mapped(&plan, &[(place, id)], &SdoReads::default(), rule);
        // It knows no remote frames, or nothing but.
        let without = of(|_, new| Some(new | NO_RTR)).unwrap();
        assert_eq!(without[&place], id | NO_RTR);
        let with = of(|_, new| Some(new & !NO_RTR)).unwrap();
        assert_eq!(with[&place], id);
        // Stays off, has 29 bits, has another identifier.
        let wrong: [(Rule, u32); 3] = [
            (|_, new| Some(new | INVALID), id | INVALID),
            (|_, new| Some(new | 1 << 29), id | 1 << 29),
            (|_, new| Some(new ^ 1), id ^ 1),
        ];
        for (rule, found) in wrong {
            let written = if id == 0x203 { id } else { id | NO_RTR };
            let found = found | written & NO_RTR;
            let refusal = format!(
                "node 3: {:04X}:01 is {found:08X}h after {written:08X}h was written, and they may not differ in A00007FFh",
                place.0
            );
            assert_eq!(of(rule), Err(refusal));
        }
    }
}

/// A TPDO that Lely's dcfgen has set up and stored, with bit 30 clear, becomes the master's, in
/// whichever state it is.
#[test]
fn tpdo_stored_with_bit_30_clear_is_taken_over() {
    let plan = plan(1, 2 * MS);
    for stored in [0x183, INVALID | 0x183] {
        let scanned = Offline::new(network(&plan), &plan).unwrap().scan();
        let mut scanned = scanned.unwrap();
        let net = scanned.bus_mut();
        for raw in [INVALID | 0x183, stored] {
            write(net, 0, node(2), index::tpdo(0, 1), &raw.to_le_bytes()).unwrap();
        }
        write(net, 0, node(2), index::STORE, b"save").unwrap();
        let identified = scanned.check_identity().unwrap();
        let mut homed = identified.map().unwrap().home().unwrap();
        let after = read_number(homed.bus_mut(), 0, node(2), index::tpdo(0, 1));
        assert_eq!(after, Ok(0x4000_0183), "{stored:x}");
        let mut bench = Bench::of(homed.enable().unwrap(), &plan);
        assert!(bench.cycles(20, 0.0).is_ok());
        assert_eq!(bench.torques(), [true; TAIL_AXES]);
    }
}

/// A drive that is to send the SYNC stops that before it gets another identifier.
#[test]
fn sync_producer_is_stopped_before_its_id_changes() {
    const SENDS: u32 = 1 << 30;
    // While it sends, no other bit may change.
    let rule: Rule = |old, new| (old & SENDS == 0 || (old ^ new) & !SENDS == 0).then_some(new);
    for (sync_id, stored) in [
        (0x080, SENDS | 0x100),
        (0x100, SENDS | 0x080),
        (0x080, 0x100),
    ] {
        let plan = ArmPlan {
            sync_id: CanId::new(sync_id).unwrap(),
            ..plan(1, 2 * MS)
        };
        let place = (0x1005, 0);
        let after = mapped(&plan, &[(place, stored)], &SdoReads::default(), rule);
        assert_eq!(after.unwrap()[&place], u32::from(sync_id), "{stored:x}");
    }
}

#[test]
fn the_deadline_of_a_set_point_is_set_while_the_pdo_is_off() {
    let plan = plan(1, 2 * MS);
    let mut scanned = Offline::new(network(&plan), &plan).unwrap().scan().unwrap();
    let (mut valid, mut refuses) = (true, false);
    scanned.bus_mut().tamper(Box::new(move |_, _, f| {
        match (f.id.raw(), f.data()) {
            (0x603, [0x23, 0x00, 0x14, 1, .., high]) => valid = high & 0x80 == 0,
            (0x603, [0x2B, 0x00, 0x14, 5, ..]) => refuses = valid,
            (0x583, [_, 0x00, 0x14, 5, ..]) if core::mem::take(&mut refuses) => {
                let [a, b, c, d] = AbortCode::DEVICE_STATE.0.to_le_bytes();
                return Tampering::Replace(frame(0x583, &[0x80, 0, 0x14, 5, a, b, c, d]));
            }
            _ => {}
        }
        Tampering::Pass
    }));
    let mut homed = scanned
        .check_identity()
        .unwrap()
        .map()
        .unwrap()
        .home()
        .unwrap();
    // Ten periods.
    assert_eq!(
        read_number(homed.bus_mut(), 0, node(2), index::rpdo(0, 5)),
        Ok(20)
    );
}

/// PDOs beyond the fourth and time stamps are taken out of use as far as a node has any.
#[test]
fn further_pdos_and_time_stamps_are_disabled() {
    // Object, what is stored, what it is after bring-up: the identifier stays.
    let cases: [((u16, u8), u32, u32); 8] = [
        ((0x1404, 1), 0x345, INVALID | 0x345),
        ((0x1405, 1), INVALID | 0x346, INVALID | 0x346),
        // A 29-bit one.
        ((0x1406, 1), 0x2012_3456, 0xA012_3456),
        // The first of the second logical device.
        ((0x1440, 1), 0x347, INVALID | 0x347),
        ((0x1804, 1), 0x4000_03C5, INVALID | 0x4000_03C5),
        ((0x1840, 1), 0x03C6, INVALID | 0x03C6),
        ((0x19C0, 1), 0x03C7, INVALID | 0x03C7),
        // Hears time stamps, and sends them.
        ((0x1012, 0), 0xC000_0100, 0x100),
    ];
    let asked: SdoReads = Rc::default();
    let stored = cases.map(|(place, stored, _)| (place, stored));
    let after = mapped(&plan(1, 2 * MS), &stored, &asked, STANDARD).unwrap();
    for (place, _, wanted) in cases {
        assert_eq!(after[&place], wanted, "{place:x?}");
    }
    let asked = asked.borrow();
    let was_asked = |index: u16| asked.contains(&(index, 1));
    for (last, first_never) in [
        (0x1407, 0x1408),
        (0x1441, 0x1442),
        (0x1480, 0x1481),
        (0x1805, 0x1806),
        (0x1841, 0x1842),
        (0x19C1, 0x19C2),
    ] {
        assert!(was_asked(last) && !was_asked(first_never), "{last:x}");
    }
}

#[test]
fn a_bus_carries_what_was_planned_whatever_a_drive_has_stored() {
    let plan = plan(1, 2 * MS);
    let scanned = Offline::new(network(&plan), &plan).unwrap().scan();
    let mut scanned = scanned.unwrap();
    let mut put = |address, data: &[u8]| write(scanned.bus_mut(), 0, node(2), address, data);
    let cob = |raw: u32| raw.to_le_bytes();
    for (address, data) in [
        // Its own set-points under another identifier, and a second way to it under one that is
        // nobody's.
        (index::rpdo(0, 1), cob(INVALID | 0x203)),
        (index::rpdo(0, 1), cob(INVALID | 0x345)),
        (index::rpdo(0, 1), cob(0x345)),
        (index::rpdo(1, 1), cob(INVALID | 0x346)),
        (index::rpdo(1, 1), cob(0x346)),
        // Two more answers, by the clock.
        (index::tpdo(1, 1), cob(INVALID | 0x4000_0283)),
        (index::tpdo(1, 1), cob(0x4000_0283)),
        (index::tpdo(3, 1), cob(INVALID | 0x4000_0347)),
        (index::tpdo(3, 1), cob(0x4000_0347)),
    ] {
        put(address, &data).unwrap();
    }
    for number in [0, 1, 3] {
        put(index::tpdo(number, 5), &[1, 0]).unwrap();
    }
    put(index::EMERGENCY_INHIBIT, &1000_u16.to_le_bytes()).unwrap();
    put(index::STORE, b"save").unwrap();
    let identified = scanned.check_identity().unwrap();
    let homed = identified.map().unwrap().home().unwrap();
    let mut bench = Bench::of(homed.enable().unwrap(), &plan);
    assert!(bench.cycles(5, 0.0).is_ok());
    let heard: Rc<RefCell<BTreeSet<u16>>> = Rc::default();
    let told = Rc::clone(&heard);
    bench.tamper(move |frame| {
        told.borrow_mut().insert(frame.id.raw());
        Tampering::Pass
    });
    let (before_ns, before) = bench.net().wire(0).busy();
    assert!(bench.cycles(100, 0.0008).is_ok());
    let (after_ns, after) = bench.net().wire(0).busy();
    let planned: BTreeSet<u16> = (1..=7)
        .flat_map(|node| [0x180 + node, 0x200 + node, 0x700 + node])
        .chain([0x080, 0x77F])
        .collect();
    assert_eq!(*heard.borrow(), planned);
    // A SYNC, 7 set-points and 7 answers a cycle, and two heartbeats of 8 nodes.
    assert_eq!(after - before, 100 * 15 + 2 * 8);
    let (busy_bits, load) = ((after_ns - before_ns) / 1000, plan.traffic(0).load());
    assert!(
        (100 * load.least..=100 * load.most).contains(&busy_bits),
        "{busy_bits} {load:?}"
    );
}

/// What becomes of bring-up when node 3 refuses to tell 1014h with `code`.
fn without_emergency_identifier(code: AbortCode) -> Result<(), String> {
    let plan = plan(1, 2 * MS);
    let scanned = Offline::new(network(&plan), &plan).unwrap().scan();
    let mut scanned = scanned.unwrap();
    scanned.bus_mut().tamper(Box::new(move |_, _, f| {
        if f.id.raw() != 0x583 || f.data().get(1..4) != Some(&[0x14, 0x10, 0]) {
            return Tampering::Pass;
        }
        let [a, b, c, d] = code.0.to_le_bytes();
        Tampering::Replace(frame(0x583, &[0x80, 0x14, 0x10, 0, a, b, c, d]))
    }));
    let mapped = scanned.check_identity().unwrap().map();
    mapped.map(|_| ()).map_err(|error| error.to_string())
}

/// Only a drive that lacks the identifier of emergencies may keep it to itself.
#[test]
fn only_a_missing_1014h_may_be_left_alone() {
    for code in [AbortCode::NO_OBJECT, AbortCode::NO_DATA] {
        assert_eq!(without_emergency_identifier(code), Ok(()));
    }
    for code in [
        AbortCode::GENERAL,
        AbortCode::HARDWARE,
        AbortCode::DEVICE_STATE,
        AbortCode::WRITE_ONLY,
        AbortCode::TIMEOUT,
        AbortCode(0x1234_5678),
    ] {
        let refusal = format!("node 3: refuses 1014:00: {code}");
        assert_eq!(without_emergency_identifier(code), Err(refusal));
    }
}
