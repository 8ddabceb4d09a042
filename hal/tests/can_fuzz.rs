//! Arbitrary frames on the bus of a whole arm, master and drives: no panic, no memory without bound and none at all in the
//! master's cycle, and no axis outside its range or faster than its drive may be.
//!
//! `make fuzz-can` throws ten million and more and says what came of them; `TROCAR_FUZZ_FRAMES` sets another number.
#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

#[path = "can_fuzz/frames.rs"]
mod frames;
#[path = "can_fuzz/memory.rs"]
mod memory;
#[path = "can_fuzz/noisy.rs"]
mod noisy;

use hal::can::bus::{IdealMotor, Network};
use hal::can::master::config::CanConfig;
use hal::can::master::{ArmPlan, Bus as _, CanArm, Fault, Offline};
use hal::can::node::Node;
use hal::{Arm as _, ArmCommand, JointVector, SafeTail};

use frames::Mood;
use noisy::{Noisy, Seen};

/// Cycles for which an arm is watched after it has failed.
const CYCLES_AFTER_FAULT: u32 = 40;
/// Cycles of an arm that does not fail.
const CYCLES_MAX: u32 = 600;

/// What came of many lives of an arm.
#[derive(Debug, Default)]
struct Tally {
    seen: Seen,
    lives: u64,
    /// Bring-ups that the frames ended.
    spoiled: u64,
    cycles: u64,
    enabled_cycles: u64,
    faults: [u64; 12],
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
        Fault::Silent(..) | Fault::Unsteady(_) => 8,
        Fault::NotEnabled(..) => 9,
        Fault::FollowingError(..) => 10,
        Fault::PowerLost(_) => 11,
    }
}

fn network(plan: &ArmPlan) -> Network<IdealMotor> {
    let mut net = Network::new(plan.lines, plan.bit_rate, 64);
    for axis in &plan.axes {
        let middle = (axis.range.0 + axis.range.1) / 2.0;
        let motor = IdealMotor {
            position_counts: middle * axis.counts_per_unit,
            stuck: false,
        };
        net.add(axis.line, Node::new(axis.node, &axis.drive(0)), motor);
    }
    net
}

/// Brings the arm up, in noise too if it is that kind of life.
fn bring_up(noisy: Noisy, plan: &ArmPlan) -> Option<CanArm<Noisy>> {
    let scanned = Offline::new(noisy, plan).unwrap().scan().ok()?;
    let mapped = scanned.check_identity().ok()?.map().ok()?;
    mapped.home().ok()?.enable().ok()
}

/// One life: from silent buses to some time after a fault. Gives the frames back that were thrown.
fn live(seed: u64, plan: &ArmPlan, tally: &mut Tally) {
    let mood = Mood::of(seed);
    let noisy = Noisy::new(network(plan), plan, seed, mood);
    let seen = noisy.seen();
    tally.lives += 1;
    match bring_up(noisy, plan) {
        Some(arm) => drive(arm, plan, mood, tally),
        None => tally.spoiled += 1,
    }
    tally.seen.add(&seen.borrow());
}

/// A controller that moves all axes to and fro.
fn drive(mut arm: CanArm<Noisy>, plan: &ArmPlan, mood: Mood, tally: &mut Tally) {
    arm.bus_mut().begin(mood);
    let (mut after, mut cycle) = (0, 0);
    let mut now = arm.bus_mut().now();
    while after < CYCLES_AFTER_FAULT && cycle < CYCLES_MAX {
        now = now.plus_ns(plan.cycle_ns);
        cycle += 1;
        arm.bus_mut().wait(now);
        let swing = (f64::from(cycle) * 0.02).sin() * 0.05;
        let place = |axis: usize| {
            let (low, high) = plan.axes[axis].range;
            (low + high) / 2.0 + swing * (high - low)
        };
        let command = ArmCommand {
            stamp: now,
            position: JointVector::from_fn(|axis, _| place(axis)),
            velocity: JointVector::zeros(),
            acceleration: JointVector::zeros(),
            jaw_position: place(6),
            jaw_velocity: 0.0,
            enabled: true,
        };
        let before = memory::requests();
        let _ = arm.read(now);
        if cycle % 7 > 0 {
            let _ = arm.write(&command, &SafeTail::hold(&command));
        }
        assert_eq!(memory::requests(), before, "the cycle took memory");
        tally.cycles += 1;
        tally.enabled_cycles += u64::from(arm.cycle().is_enabled());
        after += u32::from(arm.fault().is_some());
    }
    if let Some(fault) = arm.fault() {
        tally.faults[kind(fault)] += 1;
    }
}

/// The shipped plan, whose bus is nearly full, and three times as often one that leaves strangers half of the bus.
fn plan(seed: u64) -> ArmPlan {
    let config = CanConfig::load(&CanConfig::shipped()).unwrap();
    let shipped = config.arms[0].plan;
    let cycle_ns = if (seed / 8).is_multiple_of(4) {
        shipped.cycle_ns
    } else {
        2 * shipped.cycle_ns
    };
    ArmPlan {
        cycle_ns,
        ..shipped
    }
}

/// Lives until `frames` have been thrown; memory must not grow meanwhile.
fn throw(first_seed: u64, frames: u64) -> Tally {
    let mut tally = Tally::default();
    // What a life needs at most is what the first ones, of each kind, have needed, and half of that again.
    let mut bound = 0;
    for seed in first_seed.. {
        let plan = plan(seed);
        memory::begin();
        live(seed, &plan, &mut tally);
        let life = memory::most();
        if seed < first_seed + 32 {
            bound = bound.max(life);
        }
        assert!(
            life <= bound + bound / 2,
            "seed {seed}: {life} of {bound} bytes"
        );
        if tally.seen.thrown >= frames {
            break;
        }
    }
    tally
}

#[test]
fn arbitrary_frames_never_move_an_arm_outside_its_limits_nor_take_memory() {
    let tally = throw(1, 150_000);
    // It is no test if the arm is never enabled, never moves, or never fails.
    assert!(tally.enabled_cycles > 500, "{tally:?}");
    assert!(
        tally.seen.travelled > 1e5 && tally.spoiled < tally.lives,
        "{tally:?}"
    );
    let kinds = tally.faults.iter().filter(|count| **count > 0).count();
    assert!(kinds >= 3, "{tally:?}");
}

#[test]
#[ignore = "ten million frames: make fuzz-can"]
#[expect(clippy::print_stdout, reason = "figures for a person")]
fn ten_million_arbitrary_frames_never_move_an_arm_outside_its_limits_nor_take_memory() {
    let frames = std::env::var("TROCAR_FUZZ_FRAMES");
    let frames = frames.map_or(10_000_000, |text| text.parse().unwrap());
    let tally = throw(1_000_000, frames);
    assert!(tally.seen.thrown >= frames);
    println!("{tally:#?}");
}
