use super::wire::{Order, QueueFull};
use super::*;
use hal::TimeNs;
use trocar_canopen::arbitrary::Random;
use trocar_canopen::bus_load::bits::{exact, least, most};
use trocar_canopen::bus_load::{Plan, Traffic};
use trocar_canopen::master::{Bus as _, Received};
use trocar_canopen::{CanId, Frame, Payload};

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::new(CanId::new(id).unwrap(), Payload::new(data).unwrap())
}

/// The reference's table of bits: data bytes, without stuffing, with as much as can be.
const FRAME_BITS: [(u8, u32, u32); 6] = [
    (0, 47, 55),
    (1, 55, 65),
    (2, 63, 75),
    (4, 79, 95),
    (6, 95, 115),
    (8, 111, 135),
];

#[test]
fn frames_have_the_bits_of_the_table() {
    for (bytes, min, max) in FRAME_BITS {
        assert_eq!((least(bytes), most(bytes)), (min, max), "{bytes}");
    }
}

#[test]
fn exact_bits_lie_between_least_and_most() {
    let mut random = Random::new(4);
    for _ in 0..20_000 {
        let frame = random.frame();
        let bytes = frame.payload.length();
        let bits = exact(&frame);
        assert!((least(bytes)..=most(bytes)).contains(&bits), "{frame}");
    }
}

/// Numbers of another program, which divides by the polynomial in binary and stuffs a string.
#[test]
fn stuffing_is_that_of_an_independent_count() {
    for (id, data, bits) in [
        (0x080, &[][..], 51),
        (0x000, &[0; 8], 127),
        (0x2AA, &[0x55; 8], 111),
        (0x7FF, &[0xFF; 8], 126),
        (0x185, &[0x27, 6, 0, 0, 0, 0, 0, 0], 122),
        (0x205, &[0x0F, 0, 0x10, 0x27, 0, 0], 105),
    ] {
        assert_eq!(exact(&frame(id, data)), bits, "{id:03X}");
    }
}

fn traffic(kinds: &[(u32, u8)]) -> Plan {
    let kind = |&(count, data_bytes)| Traffic {
        what: "frames",
        count,
        data_bytes,
    };
    Plan {
        line: 0,
        bit_rate: 1_000_000,
        cycle_ns: 1_000_000,
        traffic: kinds.iter().map(kind).collect(),
        heartbeats: (0, 1),
    }
}

/// Name, frames as count and bytes, bits without and with stuffing, whether 500 Hz and 1 kHz can be
/// had.
type Row = (&'static str, &'static [(u32, u8)], (u64, u64), bool, bool);

/// The reference's table 2.10.
const fn table() -> [Row; 10] {
    [
        ("A", &[(1, 0), (7, 6), (7, 8)], (1489, 1805), true, false),
        // With a counter in the SYNC.
        (
            "B",
            &[(1, 1), (7, 6), (7, 6), (7, 8)],
            (2162, 2620),
            false,
            false,
        ),
        ("C", &[(1, 0), (1, 8), (8, 6)], (918, 1110), true, false),
        ("D", &[(1, 0), (4, 8), (7, 8)], (1268, 1540), true, false),
        ("E", &[(1, 0), (4, 8), (7, 4)], (1044, 1260), true, false),
        ("F", &[(1, 0), (14, 4)], (1153, 1385), true, false),
        (
            "4 axes of A",
            &[(1, 0), (4, 6), (4, 8)],
            (871, 1055),
            true,
            false,
        ),
        (
            "3 axes of A",
            &[(1, 0), (3, 6), (3, 8)],
            (665, 805),
            true,
            true,
        ),
        (
            "4, shared",
            &[(1, 0), (2, 8), (4, 6)],
            (649, 785),
            true,
            true,
        ),
        (
            "3, shared",
            &[(1, 0), (2, 8), (3, 6)],
            (554, 670),
            true,
            true,
        ),
    ]
}

#[test]
fn plans_cost_what_the_table_says() {
    for (name, kinds, bits, at_500_hz, at_1_khz) in table() {
        let mut plan = traffic(kinds);
        let load = plan.load();
        assert_eq!((load.least, load.most), bits, "{name}");
        assert_eq!(plan.check().is_ok(), at_1_khz, "{name}");
        plan.cycle_ns = 2_000_000;
        assert_eq!(plan.check().is_ok(), at_500_hz, "{name}");
    }
}

/// The shares of the bus that the table gives for 250 Hz, 500 Hz and 1 kHz, without and with
/// stuffing, %.
#[test]
fn plans_take_the_share_that_the_table_says() {
    let rows = [
        ("A", 250, (37, 45)),
        ("A", 500, (74, 90)),
        ("A", 1000, (149, 181)),
        ("B", 250, (54, 66)),
        ("B", 500, (108, 131)),
        ("C", 250, (23, 28)),
        ("C", 500, (46, 56)),
        ("C", 1000, (92, 111)),
        ("D", 250, (32, 39)),
        ("D", 500, (63, 77)),
        ("E", 250, (26, 32)),
        ("E", 500, (52, 63)),
        ("E", 1000, (104, 126)),
        ("F", 250, (29, 35)),
        ("F", 500, (58, 69)),
        ("4 axes of A", 1000, (87, 106)),
        ("3 axes of A", 1000, (67, 81)),
        ("4, shared", 1000, (65, 79)),
        ("3, shared", 1000, (55, 67)),
    ];
    for (name, hz, (low, high)) in rows {
        let found = table().into_iter().find(|row| row.0 == name);
        let mut plan = traffic(found.unwrap().1);
        plan.cycle_ns = 1_000_000_000 / hz;
        let load = plan.load();
        let per_mille = |bits: u64| bits * 1000 / load.room;
        // The table rounds either way.
        for (bits, percent) in [(load.least, low), (load.most, high)] {
            let off = per_mille(bits).abs_diff(percent * 10);
            assert!(
                off <= 10,
                "{name} at {hz} Hz: {} per mille",
                per_mille(bits)
            );
        }
    }
}

/// What each plan of the table takes on the wire, with frames of arbitrary content.
#[test]
fn plans_take_on_the_wire_what_the_table_says() {
    const CYCLES: u64 = 200;
    for (name, kinds, (low, high), at_500_hz, _) in table() {
        let mut random = Random::new(7);
        let mut wire = Wire::new(1_000_000);
        let port = wire.attach(Order::Fifo, 64);
        let mut late = 0;
        for cycle in 0..CYCLES {
            let start = TimeNs(cycle * 2_000_000);
            late += u64::from(wire.waiting(port) > 0);
            for (count, bytes) in kinds {
                for _ in 0..*count {
                    let content = random.bits().to_le_bytes();
                    let id = CanId::truncated(random.bits().to_le_bytes()[0].into());
                    let data = Payload::truncated(&content[..usize::from(*bytes)]);
                    let _ = wire.send(start, port, Frame::new(id, data));
                }
            }
            while wire.next(start.plus_ns(2_000_000)).is_some() {}
        }
        // What overloads the bus piles up, so that not all of it has gone.
        assert_eq!(late > CYCLES / 2, !at_500_hz, "{name}: {late}");
        if at_500_hz {
            let bits = wire.busy().0 / 1000 / CYCLES;
            assert!((low..=high).contains(&bits), "{name}: {bits} bits a cycle");
        }
    }
}

#[test]
fn an_overloaded_plan_is_refused_with_its_arithmetic() {
    let mut plan = Plan::cyclic(0, 1_000_000, 1_000_000, 7, (6, 8));
    plan.heartbeats = (8, 100_000_000);
    assert_eq!(
        plan.check().unwrap_err().to_string(),
        "bus 0: 1 SYNC x 55 + 7 set-points x 115 + 7 answers x 135 + heartbeats of 8 nodes = 1811 bits with stuffing, \
         but a cycle of 1000 us at 1 Mbit/s has 1000: 181.1 % of the bus, of which at most 95 % may be planned; use more \
         buses or a longer cycle"
    );
    plan.cycle_ns = 2_000_000;
    assert_eq!(plan.check().map(|load| load.per_mille()), Ok(908));
    let three = Plan::cyclic(1, 1_000_000, 1_000_000, 3, (6, 8));
    assert_eq!(three.check().map(|load| load.per_mille()), Ok(805));
}

#[test]
fn the_lowest_identifier_goes_first_and_nobody_is_interrupted() {
    let mut wire = Wire::new(1_000_000);
    let a = wire.attach(Order::Fifo, 8);
    let b = wire.attach(Order::Priority, 8);
    wire.send(TimeNs(0), a, frame(0x700, &[1])).unwrap();
    let first = exact(&frame(0x700, &[1]));
    // Too late for the first arbitration.
    wire.send(TimeNs(1000), a, frame(0x300, &[])).unwrap();
    wire.send(TimeNs(1000), a, frame(0x080, &[])).unwrap();
    wire.send(TimeNs(1000), b, frame(0x400, &[])).unwrap();
    wire.send(TimeNs(1000), b, frame(0x200, &[])).unwrap();
    let order: Vec<_> = std::iter::from_fn(|| wire.next(TimeNs(10_000_000))).collect();
    let ids: Vec<u16> = order.iter().map(|d| d.frame.id.raw()).collect();
    // A Linux queue is blocked by its head; a drive's is not.
    assert_eq!(ids, [0x700, 0x200, 0x300, 0x080, 0x400]);
    assert_eq!(order[0].at, TimeNs(u64::from(first) * 1000));
    let bits: u32 = order.iter().map(|d| exact(&d.frame)).sum();
    assert_eq!(order[4].at, TimeNs(u64::from(bits) * 1000));
    assert_eq!(wire.busy(), (u64::from(bits) * 1000, 5));
}

#[test]
fn a_frame_arrives_with_its_last_bit_and_a_full_queue_refuses() {
    let mut wire = Wire::new(500_000);
    let port = wire.attach(Order::Fifo, 2);
    let frame = frame(0x123, &[1, 2, 3]);
    let end = TimeNs(u64::from(exact(&frame)) * 2000);
    wire.send(TimeNs(0), port, frame).unwrap();
    wire.send(TimeNs(0), port, frame).unwrap();
    assert_eq!(wire.send(TimeNs(0), port, frame), Err(QueueFull));
    assert!(wire.next(TimeNs(end.0 - 1)).is_none());
    assert_eq!(wire.next(end).map(|d| d.at), Some(end));
    wire.set_attached(port, false);
    assert!(wire.next(TimeNs(u64::MAX / 2)).is_none());
}

#[test]
fn two_with_one_identifier_collide() {
    let mut wire = Wire::new(1_000_000);
    let a = wire.attach(Order::Fifo, 2);
    let b = wire.attach(Order::Fifo, 2);
    wire.send(TimeNs(0), a, frame(0x185, &[1])).unwrap();
    wire.send(TimeNs(0), b, frame(0x185, &[2])).unwrap();
    assert!(wire.next(TimeNs(1_000_000)).is_some());
    assert_eq!(wire.collisions(), 1);
}

/// A frame that is held back comes after those that overtake it.
#[test]
fn delayed_frame_is_overtaken() {
    let mut network: Network<IdealMotor> = Network::new(1, 1_000_000, 8);
    let other = network.add_master(8);
    let (held, quick) = (frame(0x100, &[1]), frame(0x200, &[2]));
    network.tamper(Box::new(move |_, _, frame| {
        if *frame == held {
            Tampering::Delay(300_000)
        } else {
            Tampering::Pass
        }
    }));
    assert_eq!(network.send(0, &[held, quick]), 2);
    // One look at both: they are told apart by when they arrive, not by when anything looks.
    network.advance(TimeNs(400_000));
    let mut came = Vec::new();
    network.receive_as(other, 0, &mut |received| came.push(received));
    assert_eq!(came, [quick, held].map(Received::Frame));
}
