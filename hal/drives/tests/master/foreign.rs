//! Another node on the bus that commands our drives, from one set-point to a whole second master.

use super::faults::moving;
use super::*;

/// Greatest speed of a drive, units/s, and its quick stop, units/s^2, as bring-up has set them.
const FASTEST: f64 = 1.1 * SPEED;
const QUICK: f64 = FASTEST / 0.02;
/// Where a drive may be, units.
const REACH: f64 = 5.0;
const LOOK_NS: u64 = MS / 4;

/// An arm with a stranger on its bus, and a watch over its motors.
struct Shared {
    bench: Bench,
    before: [f64; TAIL_AXES],
    /// How far an axis was from where it is led, at most since the stranger came.
    off: f64,
}

impl Shared {
    fn new(mut bench: Bench) -> Self {
        let before = bench.motors();
        Self {
            bench,
            before,
            off: 0.0,
        }
    }

    /// Lets `ns` pass, in which no motor is faster than it may be or where it may not be.
    fn pass(&mut self, ns: u64) {
        let end = self.bench.net().now().plus_ns(ns);
        while self.bench.net().now() < end {
            let then = self.bench.net().now().plus_ns(LOOK_NS).min(end);
            let seconds = TimeNs(then.since(self.bench.net().now())).seconds();
            self.bench.net().wait(then);
            let motors = self.bench.motors();
            for (axis, (now, before)) in motors.iter().zip(self.before).enumerate() {
                // Drives and motors go by half milliseconds.
                let reach = FASTEST * (seconds + 0.0005) + 1e-6;
                assert!((now - before).abs() <= reach, "{axis}: {before} {now}");
                assert!(now.abs() <= REACH, "{axis}: {now}");
                let off = (now - self.bench.position[axis]).abs();
                self.off = self.off.max(off);
            }
            self.before = motors;
        }
    }

    /// A cycle of ours in which the stranger says `frames`, `after_ns` after our set-points.
    fn cycle(&mut self, after_ns: u64, frames: &[Frame]) {
        self.pass(after_ns);
        for frame in frames {
            self.bench.net().intrude(0, *frame);
        }
        let due = self.bench.now.plus_ns(self.bench.cycle_ns);
        let left_ns = due.since(self.bench.net().now());
        self.pass(left_ns);
        let _ = self.bench.cycle(0.0);
    }
}

fn set_point(node: u16, control: u8, target: i32) -> Frame {
    let [a, b, c, d] = target.to_le_bytes();
    frame(0x200 + node, &[control, 0, a, b, c, d])
}

/// A set point of another node after ours is a fault and however many follow the axis stops.
#[test]
fn foreign_set_points_are_a_fault_and_the_axis_stops() {
    // From long before the next SYNC to so short that it is on the wire when the SYNC is due.
    for after_ns in [1_200_000, 1_900_000, 1_999_000] {
        for target in [i32::MAX, 60_000] {
            let mut shared = Shared::new(moving());
            let _ = shared.bench.cycles(5, 0.0);
            shared.off = 0.0;
            let stranger = [set_point(3, 0x0F, target)];
            shared.cycle(after_ns, &stranger);
            shared.cycle(after_ns, &stranger);
            let fault = shared.bench.arm.fault().map(|fault| fault.to_string());
            let told = "bus 0: another node sends 203h, which only this master may";
            assert_eq!(fault.as_deref(), Some(told), "{after_ns} {target}");
            for _ in 0..100 {
                shared.cycle(after_ns, &stranger);
            }
            // The two cycles until it is noticed and answered, and a quick stop.
            let furthest = 2.0 * 0.002 * FASTEST + FASTEST * FASTEST / (2.0 * QUICK);
            assert!(shared.off < furthest, "{after_ns} {target}: {}", shared.off);
            shared.bench.assert_stopped_for_good(told);
        }
    }
}

#[test]
fn the_later_one_of_two_set_points_before_a_sync_counts() {
    // Why it must be noticed: so a drive goes where the stranger wants for as long as it takes.
    let mut bench = Bench::new();
    bench.cycles(5, 0.0).unwrap();
    let here = bench.motors()[2];
    let near_sync = bench.now.plus_ns(1_999_000);
    bench.net().wait(near_sync);
    let target = whole_i32(here * COUNTS) + 300;
    bench.net().intrude(0, set_point(3, 0x0F, target));
    bench.cycle(0.0).unwrap();
    bench.dead_for(MS);
    assert!(bench.motors()[2] > here + 0.001, "{}", bench.motors()[2]);
}

fn whole_i32(value: f64) -> i32 {
    i32::try_from(trocar_canopen::number::whole(value)).unwrap()
}

/// A whole second master leads an axis as far as its drive's limits and no further.
#[test]
fn second_master_is_held_by_the_drives_limits() {
    let plan = plan(1, 4 * MS);
    for way in [4000, -4000] {
        let mut shared = Shared::new(Bench::on(&plan));
        let mut at_end = 0;
        while at_end < 50 {
            // It enables the drive anew in every cycle, with a SYNC of its own, and leads it on by
            // less than its window.
            shared.pass(1_800_000);
            let target = whole_i32(shared.before[2] * COUNTS) + way;
            shared.bench.net().intrude(0, frame(0x000, &[0x01, 3]));
            for control in [0x06, 0x07, 0x0F, 0x0F] {
                for said in [set_point(3, control, target), frame(0x080, &[])] {
                    shared.bench.net().intrude(0, said);
                    shared.pass(250_000);
                }
            }
            shared.cycle(0, &[]);
            at_end += u32::from(shared.before[2].abs() > REACH - 1e-6);
            assert!(shared.bench.now < TimeNs(20_000 * MS), "it is led there");
        }
        let fault = shared.bench.arm.fault();
        assert!(matches!(fault, Some(Fault::ForeignMaster { .. })));
        // The others were let go, and stayed where they were.
        assert!(!shared.bench.torques()[3] && shared.before[3] < 0.5);
    }
}
