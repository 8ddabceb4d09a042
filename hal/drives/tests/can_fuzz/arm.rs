//! A whole arm's life: bring-up, motion to and fro, a fault perhaps, and some time after it.

use hal::{Arm as _, ArmCommand, JointVector, SafeTail, TICK_NS, TimeNs};
use trocar_canopen::master::{ArmPlan, Bus as _, CanArm, Fault, Offline};
use trocar_drives::AxisConfig;
use trocar_drives::node::Node;
use trocar_drives::{IdealMotor, Network};

use crate::life::Scenario;
use crate::memory;
use crate::noisy::Noisy;
use crate::promises::{Stamped, SyncPeriod, SyncPeriods, stop_ns};
use crate::seen::Seen;

/// Cycles for which an arm is watched after it has come to rest, or after everything has happened
/// to it.
const CYCLES_AFTER: u64 = 20;

/// What came of many lives.
#[derive(Clone, Debug, Default)]
pub(crate) struct Tally {
    pub(crate) seen: Seen,
    pub(crate) lives: u64,
    /// Bring-ups that came to nothing.
    pub(crate) spoiled: u64,
    pub(crate) cycles: u64,
    pub(crate) enabled_cycles: u64,
    /// SYNCs given and left out.
    pub(crate) syncs: u64,
    pub(crate) left_out: u64,
    /// Most bytes that a life held, and those of one in which nothing happens.
    pub(crate) bytes_max: i64,
    pub(crate) bytes_quiet: i64,
    pub(crate) faults: [u64; 12],
}

fn kind(fault: Fault) -> usize {
    match fault {
        Fault::BusOff { .. } => 0,
        Fault::Down { .. } => 1,
        Fault::CannotSend { .. } => 2,
        Fault::ForeignMaster { .. } => 3,
        Fault::NodeLost(_) => 4,
        Fault::Rebooted(_) => 5,
        Fault::LeftOperational(..) => 6,
        Fault::Emergency(..) => 7,
        Fault::Silent(..) | Fault::Unusable(..) | Fault::Unsteady(_) => 8,
        Fault::NotEnabled(..) => 9,
        Fault::FollowingError(..) => 10,
        Fault::PowerLost(_) => 11,
    }
}

/// Drives at this part of their ranges.
fn network(plan: &ArmPlan, part: f64) -> Network<Stamped> {
    let mut net = Network::new(plan.lines, plan.bit_rate, 64);
    for axis in &plan.axes {
        let place = axis.range.0 + part * (axis.range.1 - axis.range.0);
        let motor = IdealMotor {
            // A whole count, as a drive tells it: the ends of a range are none.
            position_counts: (place * axis.counts_per_unit).trunc(),
            stuck: false,
        };
        let motor = Stamped::new(motor);
        net.add(
            axis.line,
            Node::new(axis.node, &AxisConfig::of(axis, 0)),
            motor,
        );
    }
    net
}

fn bring_up(noisy: Noisy, plan: &ArmPlan) -> Option<CanArm<Noisy>> {
    let scanned = Offline::new(noisy, plan).unwrap().scan().ok()?;
    let mapped = scanned.check_identity().ok()?.map().ok()?;
    mapped.home().ok()?.enable().ok()
}

/// One life; tells the first thing in it that must not be.
pub(crate) fn live(shipped: &ArmPlan, life: &Scenario, tally: &mut Tally) -> Result<(), String> {
    memory::begin();
    let plan = life.buses.plan(shipped);
    let part = f64::from(life.place) / 1000.0;
    let noisy = Noisy::new(network(&plan, part), &plan, life);
    let seen = noisy.seen();
    tally.lives += 1;
    match bring_up(noisy, &plan) {
        Some(arm) => lead(arm, life, part, tally),
        None => tally.spoiled += 1,
    }
    let bytes = memory::most();
    tally.bytes_max = tally.bytes_max.max(bytes);
    let mut seen = seen.borrow_mut();
    if life.bursts.is_empty() {
        tally.bytes_quiet = tally.bytes_quiet.max(bytes);
    }
    let quiet = tally.bytes_quiet;
    seen.must(bytes <= quiet + quiet / 4, || {
        format!("{bytes} bytes were held instead of {quiet}")
    });
    tally.seen.add(&seen);
    seen.wrong.take().map_or(Ok(()), Err)
}

/// All axes to and fro around this part of their ranges, and out of these if it is near an end.
fn swing(plan: &ArmPlan, part: f64, now: TimeNs, cycle: u32) -> ArmCommand {
    let part = part + (f64::from(cycle) * 0.02).sin() * 0.05;
    let place = |axis: usize| {
        let (low, high) = plan.axes[axis].range;
        low + part * (high - low)
    };
    ArmCommand {
        stamp: now,
        position: JointVector::from_fn(|axis, _| place(axis)),
        velocity: JointVector::zeros(),
        acceleration: JointVector::zeros(),
        jaw_position: place(6),
        jaw_velocity: 0.0,
        enabled: true,
    }
}

/// A controller that is silent in every seventh cycle, as fast as the bus or faster.
fn lead(mut arm: CanArm<Noisy>, life: &Scenario, part: f64, tally: &mut Tally) {
    let plan = *arm.plan();
    let seen = arm.bus_mut().seen();
    arm.bus_mut().begin();
    let pace = u64::from(life.pace).min(plan.cycle_ns / TICK_NS).max(1);
    let enough = (CYCLES_AFTER + stop_ns(&plan) / plan.cycle_ns) * pace;
    let (mut after, mut cycle, mut beats) = (0, 0, SyncPeriods::default());
    while after < enough && seen.borrow().wrong.is_none() {
        let stall_ns = arm.bus_mut().take_stall_ns();
        let period_ns = plan.cycle_ns / pace + stall_ns;
        let due = arm.bus_mut().now().plus_ns(period_ns);
        arm.bus_mut().wait(due);
        let now = arm.bus_mut().now();
        cycle += 1;
        let command = swing(&plan, part, now, cycle);
        let beat = SyncPeriod::of(&mut arm);
        let before = memory::requests();
        let measured = arm.read(now);
        let kept = beats.check(&mut arm, &beat, now, measured.as_ref().ok());
        if cycle % 7 > 0 {
            let _ = arm.write(&command, &SafeTail::hold(&command));
            arm.send_before(now.plus_ns(plan.cycle_ns / pace));
        }
        let taken = memory::requests() - before;
        let bad = seen.borrow().wrong.is_some() || kept.is_err();
        seen.borrow_mut()
            .must(taken == 0 || bad, || "the cycle took memory".to_owned());
        if let Err(what) = kept {
            seen.borrow_mut().must(false, || what);
        }
        tally.cycles += 1;
        tally.enabled_cycles += u64::from(arm.cycle().is_enabled());
        let over = arm.bus_mut().is_over();
        if arm.fault().is_some() {
            arm.bus_mut().latch();
        }
        after += u64::from(over || arm.fault().is_some());
    }
    tally.syncs += beats.syncs;
    tally.left_out += beats.left_out;
    let (ages, _) = arm.bus_mut().ages();
    let (checked, older_max) = (ages.checked, ages.older_max);
    let mut seen = seen.borrow_mut();
    seen.ages += checked;
    seen.older_max = seen.older_max.max(older_max);
    if let Some(fault) = arm.fault() {
        tally.faults[kind(fault)] += 1;
    }
}
