//! Two arms on one bus, as the shipped configuration has them: each master hears the other's
//! frames.

use std::cell::RefCell;
use std::collections::BTreeSet;
use std::rc::Rc;

use super::*;
use hal::config::Source;
use trocar_canopen::bus_load::Plan;
use trocar_canopen::bus_load::bits::duration_ns;
use trocar_canopen::master::link::{Bus, Received};

const SHIPPED: &str = include_str!("../../../../config/can.toml");
const BOTH_AT_250_HZ: &str = "cycle_us = 4000";

fn shipped(cycle: &str) -> CanConfig {
    let text = SHIPPED.replacen("\ncycle_us = 2000", &format!("\n{cycle}"), 1);
    CanConfig::load(&Source::embedded("can.toml", &text)).unwrap()
}

/// Two arms beside each other, and the drives of both.
type Shared = Rc<RefCell<Net>>;

/// A master's end of a bus that others use too. What they have to do in the meantime they do while
/// it waits.
struct Seat {
    net: Shared,
    master: usize,
    beside: Option<Rc<RefCell<Driven>>>,
}

impl Bus for Seat {
    fn now(&self) -> TimeNs {
        self.net.borrow().now()
    }

    fn send(&mut self, line: u8, frames: &[Frame]) -> usize {
        self.net.borrow_mut().send_as(self.master, line, frames)
    }

    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received)) {
        self.net.borrow_mut().receive_as(self.master, line, sink);
    }

    fn flush(&mut self, line: u8) {
        self.net.borrow_mut().flush_as(self.master, line);
    }

    fn wait(&mut self, until: TimeNs) {
        if let Some(beside) = &self.beside {
            beside.borrow_mut().live_until(until);
        }
        self.net.borrow_mut().advance(until);
    }
}

/// An arm whose controller moves every axis by the same share of its range in every cycle.
struct Driven {
    arm: CanArm<Seat>,
    plan: ArmPlan,
    due: TimeNs,
    start: ArmState,
    cycles: u32,
    moving: bool,
    newest: Result<ArmState, ArmError>,
}

/// Share of an axis's range that it goes in a cycle.
const STEP: f64 = 2e-4;

impl Driven {
    fn bring_up(
        net: &Shared,
        master: usize,
        beside: Option<Rc<RefCell<Self>>>,
        plan: &ArmPlan,
    ) -> Self {
        let seat = Seat {
            net: Rc::clone(net),
            master,
            beside,
        };
        let scanned = Offline::new(seat, plan).unwrap().scan().unwrap();
        let mapped = scanned.check_identity().unwrap().map().unwrap();
        let mut arm = mapped.home().unwrap().enable().unwrap();
        let now = arm.bus_mut().now();
        let start = arm.read(now).unwrap();
        Self {
            arm,
            plan: *plan,
            due: now.plus_ns(plan.cycle_ns),
            start,
            cycles: 0,
            moving: true,
            newest: Ok(start),
        }
    }

    /// Where an axis is told to be after so many cycles, units.
    fn wanted(&self, axis: usize) -> f64 {
        let (low, high) = self.plan.axes[axis].range;
        let start = if axis < 6 {
            self.start.position[axis]
        } else {
            self.start.jaw_position
        };
        start + STEP * (high - low) * f64::from(self.cycles)
    }

    /// The cycles that are due until then.
    fn live_until(&mut self, until: TimeNs) {
        while self.due <= until {
            let now = self.due;
            self.arm.bus_mut().wait(now);
            self.newest = self.arm.read(now);
            self.cycles += u32::from(self.moving);
            let command = ArmCommand {
                stamp: now,
                position: JointVector::from_fn(|axis, _| self.wanted(axis)),
                velocity: JointVector::zeros(),
                acceleration: JointVector::zeros(),
                jaw_position: self.wanted(6),
                jaw_velocity: 0.0,
                enabled: true,
            };
            let _ = self.arm.write(&command, &SafeTail::hold(&command));
            self.due = now.plus_ns(self.plan.cycle_ns);
            self.arm.send_before(self.due);
        }
    }

    /// Whether it is where it should be, but for the last few cycles.
    fn assert_follows(&self) {
        assert_eq!(self.arm.fault(), None);
        let state = self.newest.unwrap();
        for axis in 0..6 {
            let (low, high) = self.plan.axes[axis].range;
            let behind = (self.wanted(axis) - state.position[axis]) / (STEP * (high - low));
            assert!(
                (2.0..4.5).contains(&behind),
                "axis {axis}: {behind} cycles behind"
            );
        }
    }
}

/// Both arms, enabled one after the other while the first one already moves.
struct Both {
    net: Shared,
    arms: [Rc<RefCell<Driven>>; 2],
}

impl Both {
    fn new(config: &CanConfig) -> Self {
        let plans = [0, 1].map(|arm: usize| config.arms[arm].plan);
        let mut net = Net::new(1, plans[0].bit_rate, 64);
        for (axis, serial) in plans.iter().flat_map(|plan| &plan.axes).zip(1..) {
            let middle = (axis.range.0 + axis.range.1) / 2.0;
            let motor = IdealMotor {
                position_counts: middle * axis.counts_per_unit,
                stuck: false,
            };
            net.add(
                0,
                Node::new(axis.node, &AxisConfig::of(axis, serial)),
                motor,
            );
        }
        assert_eq!(net.add_master(64), 1);
        let net = Rc::new(RefCell::new(net));
        let first = Rc::new(RefCell::new(Driven::bring_up(&net, 0, None, &plans[0])));
        let beside = Some(Rc::clone(&first));
        let mut second = Driven::bring_up(&net, 1, beside, &plans[1]);
        second.arm.bus_mut().beside = None;
        Self {
            net,
            arms: [first, Rc::new(RefCell::new(second))],
        }
    }

    /// Lets time pass for both; who is not alive gets nothing to do.
    fn live(&self, ns: u64, alive: [bool; 2]) {
        let until = self.net.borrow().now().plus_ns(ns);
        loop {
            let next = (0..2).filter(|n| alive[*n]);
            let next = next.min_by_key(|n| self.arms[*n].borrow().due);
            let Some(arm) = next
                .map(|n| &self.arms[n])
                .filter(|arm| arm.borrow().due <= until)
            else {
                break;
            };
            let due = arm.borrow().due;
            arm.borrow_mut().live_until(due);
        }
        self.net.borrow_mut().advance(until);
    }

    /// Motors of one arm, counts.
    fn motors(&self, arm: usize) -> Vec<f64> {
        let plan = self.arms[arm].borrow().plan;
        let mut net = self.net.borrow_mut();
        let motor = |axis: &AxisPlan| net.motor(axis.node).unwrap().position_counts;
        plan.axes.iter().map(motor).collect()
    }
}

/// What both arms put on their bus in a cycle.
fn traffic(config: &CanConfig) -> Plan {
    let [mut all, other] = [0, 1].map(|arm: usize| config.arms[arm].plan.traffic(0));
    all.traffic.extend(other.traffic);
    all.heartbeats.0 += other.heartbeats.0;
    all
}

#[test]
fn two_arms_share_a_bus_at_250_hz() {
    let config = shipped(BOTH_AT_250_HZ);
    config.check_load(2).unwrap();
    let both = Both::new(&config);
    let before = both.net.borrow().wire(0).busy().0;
    both.live(2_000 * MS, [true, true]);
    let busy_ns = both.net.borrow().wire(0).busy().0 - before;
    for arm in &both.arms {
        let arm = arm.borrow();
        arm.assert_follows();
        for health in arm.arm.cycle().axis_health() {
            assert_eq!((health.missed, health.late, health.rejected), (0, 0, 0));
        }
    }
    assert_eq!(both.net.borrow().wire(0).collisions(), 0);
    // Two seconds of 4 ms, at the bits that the plan counts with.
    let load = traffic(&config).load();
    let bound = |bits: u64| duration_ns(u32::try_from(bits).unwrap(), 1_000_000) * 500;
    assert!(
        (bound(load.least)..bound(load.most)).contains(&busy_ns),
        "{busy_ns} of {} to {}",
        bound(load.least),
        bound(load.most)
    );
}

#[test]
fn two_arms_at_500_hz_are_refused_with_the_arithmetic() {
    let error = shipped("cycle_us = 2000")
        .check_load(2)
        .unwrap_err()
        .to_string();
    assert!(
        error.contains("7 set-points x 115")
            && error.contains("% of the bus, of which at most 95 %"),
        "{error}"
    );
}

/// When one arm's process dies its drives stop and the other arm goes on.
#[test]
fn dead_process_stops_only_its_own_arm() {
    let both = Both::new(&shipped(BOTH_AT_250_HZ));
    both.live(500 * MS, [true, true]);
    let last_sync = both.arms[0].borrow().arm.cycle().sync().unwrap();
    let so_far = both.net.borrow().now().since(last_sync);
    both.live(50 * MS - so_far, [false, true]);
    let rest = both.motors(0);
    both.live(1_000 * MS, [false, true]);
    assert_eq!(both.motors(0), rest);
    both.arms[1].borrow().assert_follows();
}

#[test]
fn a_fault_of_one_arm_stops_only_its_own_drives() {
    let both = Both::new(&shipped(BOTH_AT_250_HZ));
    both.live(500 * MS, [true, true]);
    let node = both.arms[1].borrow().plan.axes[4].node;
    both.net.borrow_mut().poke(node, |now, drive, out| {
        drive.fail(now, trocar_canopen::cia301::emcy::ErrorCode(0x4310), 8, out);
    });
    both.live(1_000 * MS, [true, true]);
    let fault = both.arms[1].borrow().arm.fault().unwrap();
    assert_eq!(fault.who().map(|who| (who.axis, who.node)), Some((4, node)));
    assert_eq!(fault.code().0, 0x4310);
    let rest = both.motors(1);
    both.live(200 * MS, [true, true]);
    assert_eq!(both.motors(1), rest);
    both.arms[0].borrow().assert_follows();
}

#[test]
fn second_master_of_one_arm_stops_that_arm_alone() {
    let both = Both::new(&shipped(BOTH_AT_250_HZ));
    both.live(500 * MS, [true, true]);
    let stopped: Rc<RefCell<BTreeSet<u8>>> = Rc::default();
    let noted = Rc::clone(&stopped);
    both.net.borrow_mut().tamper(Box::new(move |_, _, frame| {
        if frame.id.raw() == 0 {
            noted.borrow_mut().insert(frame.data()[1]);
        }
        Tampering::Pass
    }));
    let stranger = frame(0x203, &[0x0F, 0, 0, 0, 0, 0]);
    both.net.borrow_mut().intrude(0, stranger);
    both.live(1_000 * MS, [true, true]);
    let fault = both.arms[0].borrow().arm.fault();
    assert!(matches!(fault, Some(Fault::ForeignMaster { .. })));
    assert_eq!(*stopped.borrow(), (1..=7).collect());
    both.arms[1].borrow().assert_follows();
}
