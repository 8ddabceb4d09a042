//! A send queue with less room than a cycle needs, when drives have to stop.

use std::collections::BTreeSet;

use super::*;
use trocar_canopen::cia301::emcy::ErrorCode;
use trocar_canopen::cia402::PowerState;

/// Buses that take only so many frames of ours between two waits.
struct Narrow {
    net: Net,
    room: [usize; 3],
    left: [usize; 3],
    /// What found room, and on which bus.
    said: Vec<(u8, Frame)>,
}

impl Bus for Narrow {
    fn now(&self) -> TimeNs {
        self.net.now()
    }

    fn send(&mut self, line: u8, frames: &[Frame]) -> usize {
        let left = &mut self.left[usize::from(line)];
        let count = self.net.send(line, &frames[..frames.len().min(*left)]);
        *left -= count;
        self.said.extend(frames[..count].iter().map(|f| (line, *f)));
        count
    }

    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received)) {
        self.net.receive(line, sink);
    }

    fn flush(&mut self, line: u8) {
        self.net.flush(line);
    }

    fn wait(&mut self, until: TimeNs) {
        self.net.wait(until);
        self.left = self.room;
    }
}

/// An arm whose queue has room for all, yet.
fn brought_up(plan: &ArmPlan) -> CanArm<Narrow> {
    let bus = Narrow {
        net: network(plan),
        room: [usize::MAX; 3],
        left: [usize::MAX; 3],
        said: Vec::new(),
    };
    let scanned = Offline::new(bus, plan).unwrap().scan().unwrap();
    let mapped = scanned.check_identity().unwrap().map().unwrap();
    mapped.home().unwrap().enable().unwrap()
}

/// Cycles that an arm takes until no drive follows any more, after one of them has failed and since
/// when its queue has taken `room` frames a cycle. Their own watches would stop the drives after
/// ten at the earliest.
fn cycles_to_stop(room: usize, controller_lives: bool) -> u32 {
    let plan = plan(1, 2 * MS);
    let mut arm = brought_up(&plan);
    let mut now = arm.bus_mut().now();
    for cycle in 0..100 {
        if cycle == 20 {
            arm.bus_mut().room[0] = room;
            arm.bus_mut().net.poke(node(6), |now, drive, out| {
                drive.fail(now, ErrorCode::OVER_CURRENT, 2, out);
            });
        }
        let mut follows = |axis| {
            let drive = arm.bus_mut().net.node(node(axis)).unwrap();
            drive.power_state() == PowerState::OperationEnabled
        };
        if !(0..TAIL_AXES).any(&mut follows) {
            assert!(arm.fault().is_some());
            return cycle - 20;
        }
        now = now.plus_ns(plan.cycle_ns);
        arm.bus_mut().wait(now);
        let measured = arm.read(now);
        // A controller that is told of a fault goes on to say what it said.
        if controller_lives && (cycle < 20 || measured.is_err()) {
            let command = ArmCommand {
                stamp: now,
                position: JointVector::from_fn(|axis, _| {
                    0.1 * (1.0 + f64::from(u8::try_from(axis).unwrap()))
                }),
                velocity: JointVector::zeros(),
                acceleration: JointVector::zeros(),
                jaw_position: 0.7,
                jaw_velocity: 0.0,
                enabled: true,
            };
            let _ = arm.write(&command, &SafeTail::hold(&command));
            arm.send_before(now.plus_ns(plan.cycle_ns));
        }
    }
    u32::MAX
}

/// A queue with little room takes the SYNC and the quick stops of drives that still follow.
#[test]
fn short_queue_takes_sync_and_quick_stops_first() {
    for controller_lives in [true, false] {
        // Enough, half of it, and next to nothing: a period for the fault and one for its answer to
        // be heard, and as many as it takes to tell each of the six once, beside the SYNC.
        for (room, at_most) in [(16, 3), (6, 4), (4, 4), (3, 5), (2, 8)] {
            let cycles = cycles_to_stop(room, controller_lives);
            assert!(cycles <= at_most, "{room} {controller_lives}: {cycles}");
        }
    }
}

#[test]
fn nodes_without_power_do_not_take_the_room_of_the_others() {
    let plan = plan(1, 2 * MS);
    let mut arm = brought_up(&plan);
    let mut now = arm.bus_mut().now();
    for cycle in 0..68 {
        if cycle == 20 {
            for axis in [0, 1] {
                arm.bus_mut().net.power(node(axis), false);
            }
        }
        if cycle == 60 {
            assert!(arm.fault().is_some());
            arm.bus_mut().room[0] = 3;
            arm.bus_mut().said.clear();
        }
        now = now.plus_ns(plan.cycle_ns);
        arm.bus_mut().wait(now);
        let _ = arm.read(now);
    }
    let all = core::mem::take(&mut arm.bus_mut().said);
    let said = |id: u16| {
        let ids = all.iter().map(|(_, frame)| frame.id.raw());
        ids.filter(|raw| *raw == id).count()
    };
    // SYNC in each of the eight cycles but the first, which does not know of the lack of room yet;
    // the set-point for the first that lives in each, for the second but in the two cycles that
    // tell a silent node to stop.
    assert_eq!([0x080, 0x203, 0x204].map(said), [7, 8, 6]);
    assert_eq!([0x000, 0x201, 0x202].map(said), [2, 0, 0]);
}

/// With a silent controller on three buses of which the first has taken `room` frames a cycle for a
/// while, a drive on the last one fails. What found room in a cycle then, and the cycles until the
/// drives on the second one stop.
fn on_three_buses(room: usize) -> (Vec<(u8, u16)>, u32) {
    let plan = plan(3, MS);
    let mut arm = brought_up(&plan);
    let mut now = arm.bus_mut().now();
    let mut said = Vec::new();
    for cycle in 0..40 {
        match cycle {
            10 => arm.bus_mut().room[0] = room,
            15 => arm.bus_mut().net.poke(node(6), |now, drive, out| {
                drive.fail(now, ErrorCode::OVER_CURRENT, 2, out);
            }),
            _ => {}
        }
        let drive = arm.bus_mut().net.node(node(3)).unwrap();
        if drive.power_state() != PowerState::OperationEnabled {
            return (said, cycle - 15);
        }
        now = now.plus_ns(plan.cycle_ns);
        arm.bus_mut().wait(now);
        arm.bus_mut().said.clear();
        let _ = arm.read(now);
        let ids = arm.bus_mut().said.iter();
        said = ids.map(|(line, frame)| (*line, frame.id.raw())).collect();
    }
    (said, u32::MAX)
}

/// A full bus has its own SYNC first and the set points on the others still come before theirs.
#[test]
fn full_bus_sends_its_sync_first() {
    let (all, at_best) = on_three_buses(16);
    let (said, cycles) = on_three_buses(2);
    let on = |said: &[(u8, u16)], line| -> Vec<u16> {
        let there = said.iter().filter(|(at, _)| *at == line);
        there.map(|(_, id)| *id).collect()
    };
    assert_eq!(on(&all, 0), [0x201, 0x202, 0x203, 0x080]);
    assert!(matches!(on(&said, 0)[..], [0x080, 0x201..=0x203]));
    for said in [&all, &said] {
        assert_eq!(on(said, 1), [0x204, 0x205, 0x080]);
        // The one that failed is no hurry.
        assert_eq!(on(said, 2), [0x206, 0x207, 0x080]);
    }
    assert_eq!(cycles, at_best);
}

/// Cycles until each drive is no longer enabled, with a stranger who leads the last node with a
/// SYNC of his own and a queue that takes `room` frames a cycle, and whom of the nodes we told to
/// stop within 50 cycles.
fn led_by_another(room: usize) -> ([u32; TAIL_AXES], BTreeSet<u8>) {
    let plan = plan(1, 2 * MS);
    let mut arm = brought_up(&plan);
    let mut now = arm.bus_mut().now();
    arm.bus_mut().room[0] = room;
    let (mut rest, mut told) = ([u32::MAX; TAIL_AXES], BTreeSet::new());
    for cycle in 0..50 {
        let net = &mut arm.bus_mut().net;
        let ahead = net.motor(node(6)).unwrap().position_counts + 100.0;
        let [a, b, c, d] = i32::try_from(trocar_canopen::number::whole(ahead))
            .unwrap()
            .to_le_bytes();
        assert!(net.intrude(0, frame(0x207, &[0x0F, 0, a, b, c, d])));
        assert!(net.intrude(0, frame(0x080, &[])));
        now = now.plus_ns(plan.cycle_ns);
        arm.bus_mut().wait(now);
        arm.bus_mut().said.clear();
        let _ = arm.read(now);
        let stops = arm.bus_mut().said.iter().filter(|(_, f)| f.id.raw() == 0);
        told.extend(stops.map(|(_, stop)| stop.data()[1]));
        for (axis, rest) in rest.iter_mut().enumerate() {
            let drive = arm.bus_mut().net.node(node(axis)).unwrap();
            if drive.power_state() != PowerState::OperationEnabled {
                *rest = (*rest).min(cycle);
            }
        }
    }
    (rest, told)
}

/// With a transmit queue nearly full, every node that a second master may command is told to stop.
#[test]
fn short_queue_still_carries_every_nmt_stop() {
    // As many cycles as it takes to tell each of the seven once, beside the SYNC, and three for the
    // first to be heard.
    for (room, at_most) in [(16, 4), (6, 5), (5, 5), (4, 6), (3, 7), (2, 10)] {
        let (rest, told) = led_by_another(room);
        assert_eq!(told, (1..=7).collect(), "{room}");
        assert!(
            rest.iter().all(|cycles| *cycles <= at_most),
            "{room}: {rest:?}"
        );
    }
}

/// A drive whose set points find no room is not blamed for where it stays.
#[test]
fn unsent_set_points_are_no_following_error() {
    // Half a cycle's way.
    let plan = ArmPlan {
        axes: plan(1, 2 * MS).axes.map(|axis| AxisPlan {
            following_max: 0.0005,
            ..axis
        }),
        ..plan(1, 2 * MS)
    };
    let mut bench = Moved::new(&plan);
    // It jumps when it hears one again, and its own window tells: only our comparison is asked.
    bench.arm.bus_mut().net.tamper(Box::new(|_, _, heard| {
        let mut data = heard.data().to_vec();
        if heard.id.raw() != 0x187 {
            return Tampering::Pass;
        }
        data[1] &= !0x20;
        Tampering::Replace(frame(0x187, &data))
    }));
    let mut behind: f64 = 0.0;
    for cycle in 0..300 {
        // In nine of ten cycles there is no room for the last set-point; its drive misses ten in a
        // row.
        bench.arm.bus_mut().room[0] = if cycle % 10 == 0 { 16 } else { 7 };
        bench.cycle(0.001);
        assert_eq!(bench.arm.fault(), None, "{cycle}");
        let net = &mut bench.arm.bus_mut().net;
        let [first, last] = [0, 6].map(|axis| net.motor(node(axis)).unwrap().position_counts);
        behind = behind.max(first + 0.6 * COUNTS - last);
    }
    // It was, by what its controller wanted.
    assert!(behind > 8.0 * 0.001 * COUNTS, "{behind}");
}

/// An arm on a narrow bus whose controller moves all axes.
struct Moved {
    arm: CanArm<Narrow>,
    now: TimeNs,
    way: f64,
}

impl Moved {
    fn new(plan: &ArmPlan) -> Self {
        let mut arm = brought_up(plan);
        let now = arm.bus_mut().now();
        Self { arm, now, way: 0.0 }
    }

    fn cycle(&mut self, step: f64) {
        self.now = self.now.plus_ns(self.arm.plan().cycle_ns);
        self.arm.bus_mut().wait(self.now);
        let _ = self.arm.read(self.now);
        self.way += step;
        let place = |axis: u8| 0.1 * (1.0 + f64::from(axis)) + self.way;
        let command = ArmCommand {
            stamp: self.now,
            position: JointVector::from_fn(|axis, _| place(u8::try_from(axis).unwrap())),
            velocity: JointVector::zeros(),
            acceleration: JointVector::zeros(),
            jaw_position: place(6),
            jaw_velocity: 0.0,
            enabled: true,
        };
        let _ = self.arm.write(&command, &SafeTail::hold(&command));
        let next = self.now.plus_ns(self.arm.plan().cycle_ns);
        self.arm.send_before(next);
    }
}
