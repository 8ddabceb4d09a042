//! The CAN arm's cycle for one arm and for two, and frames through the codecs, each beside what it
//! must be.

mod support;

use core::hint::black_box;
use hal::random::SplitMix64;
use std::error::Error;

use criterion::Criterion;
use hal::{Arm as _, ArmCommand, JointVector, SafeTail, TimeNs};
use trocar::rt::MonotonicClock;
use trocar_canopen::Outbox;
use trocar_canopen::bus_load::bits::least;
use trocar_canopen::cia301::sdo::{Request, Response};
use trocar_canopen::cia301::{Cob, Emergency, NmtState};
use trocar_canopen::cia402::{Control, Status};
use trocar_canopen::master::config::CanConfig;
use trocar_canopen::master::{ArmPlan, Bus as _, CanArm, Offline};
use trocar_canopen::{CanId, Frame, Payload};
use trocar_drives::node::{AxisConfig, Node};
use trocar_drives::{IdealMotor, Network};

/// Cycles, and thousands of frames, that percentiles are taken over.
const CYCLES: u32 = 20_000;
const THOUSANDS: u32 = 2_000;
/// A control period.
const PERIOD_US: f64 = 1000.0;

type Net = Network<IdealMotor>;

/// An enabled arm on emulated drives, and its time.
struct Rig {
    arm: CanArm<Net>,
    now: TimeNs,
    cycle_ns: u64,
}

impl Rig {
    fn new(plan: &ArmPlan) -> Result<Self, Box<dyn Error>> {
        let mut net = Net::new(plan.lines, plan.bit_rate, 64);
        for axis in &plan.axes {
            let node = Node::new(axis.node, &AxisConfig::of(axis, 0));
            net.add(axis.line, node, IdealMotor::default());
        }
        let scanned = Offline::new(net, plan)?.scan()?;
        let mut arm = scanned.check_identity()?.map()?.home()?.enable()?;
        let now = arm.bus_mut().now();
        Ok(Self {
            arm,
            now,
            cycle_ns: plan.cycle_ns,
        })
    }

    /// Lets the drives answer.
    fn wait(&mut self) {
        self.now = self.now.plus_ns(self.cycle_ns);
        self.arm.bus_mut().wait(self.now);
    }

    /// What the control thread does with the arm in a cycle.
    fn cycle(&mut self) {
        let measured = self.arm.read(self.now);
        let command = ArmCommand {
            stamp: self.now,
            position: JointVector::zeros(),
            velocity: JointVector::zeros(),
            acceleration: JointVector::zeros(),
            jaw_position: 0.0,
            jaw_velocity: 0.0,
            enabled: true,
        };
        let written = self.arm.write(&command, &SafeTail::hold(&command));
        self.arm.send_before(self.now.plus_ns(self.cycle_ns));
        let _ = black_box((measured, written));
    }
}

/// Time in the cycle alone, without the buses in memory, beside the period in which it has to be
/// done.
fn cycles(criterion: &mut Criterion, name: &str, rigs: &mut [Rig]) {
    let clock = MonotonicClock::new();
    let spent = support::measure(criterion, name, CYCLES, || {
        rigs.iter_mut().for_each(Rig::wait);
        let start = clock.now();
        rigs.iter_mut().for_each(Rig::cycle);
        clock.now().since(start)
    });
    let us = |fraction| TimeNs(spent.percentile(fraction)).seconds() * 1e6;
    let figure = format!(
        "{name}: p50 {:.1} us, p99 {:.1} us, max {:.1} us of {} cycles",
        us(0.5),
        us(0.99),
        us(1.0),
        spent.count()
    );
    support::report(
        &figure,
        "p99 at most a tenth of the 1 ms period",
        PERIOD_US / 10.0 / us(0.99),
    );
}

/// Frames a second of `work`, which does a thousand, beside what `buses` can bring at 1 Mbit/s: an
/// empty frame without any stuffing is the shortest.
fn frame_rate(criterion: &mut Criterion, name: &str, buses: u32, mut work: impl FnMut()) {
    let clock = MonotonicClock::new();
    let spent = support::measure(criterion, name, THOUSANDS, || {
        let start = clock.now();
        work();
        clock.now().since(start)
    });
    let rate = 1000.0 / TimeNs(spent.percentile(0.5)).seconds();
    let limit = f64::from(buses) * 1e6 / f64::from(least(0));
    support::report(
        &format!("{name}: {rate:.0} frames/s"),
        &format!("more than {buses} buses can bring, {limit:.0} frames/s"),
        rate / limit,
    );
}

/// A thousand arbitrary frames.
fn frames() -> Vec<Frame> {
    let mut random = SplitMix64::new(1);
    let mut next = || random.next_u64().to_le_bytes();
    (0..1000)
        .map(|_| {
            let [low, high, ..] = next();
            let id = CanId::truncated(u16::from_le_bytes([low, high]));
            Frame::new(id, Payload::full(next()))
        })
        .collect()
}

/// A frame through every codec that could be meant by it, and back.
fn decode(frame: &Frame) -> u32 {
    let data = frame.data();
    let request = Request::parse(data).map(|request| request.emit());
    let response = Response::parse(data).map(|response| response.emit());
    let emergency = Emergency::parse(data);
    let heartbeat = NmtState::parse(data);
    let word = u16::from_le_bytes([data[0], data[1]]);
    let status = Status::parse(word).map(Status::emit);
    let control = Control::parse(word).map(Control::emit);
    let _ = black_box((request, response, emergency, heartbeat, status, control));
    u32::from(Cob::of(frame.id).id().raw())
}

fn codecs(criterion: &mut Criterion, config: &CanConfig) {
    let frames = frames();
    frame_rate(criterion, "can/codecs, 1000 frames", 3, || {
        black_box(frames.iter().map(decode).fold(0, u32::wrapping_add));
    });
    let axis = config.arms[0].plan.axes[0];
    let mut node = Node::new(axis.node, &AxisConfig::of(&axis, 0));
    let mut out = Outbox::default();
    node.power_on(TimeNs(0), &mut out);
    frame_rate(criterion, "can/emulated drive, 1000 frames", 1, || {
        for frame in &frames {
            node.on_frame(TimeNs(1), frame, &mut out);
            out.clear();
        }
    });
}

/// The shipped arm at 1 kHz on three buses.
fn three_buses(config: &CanConfig) -> ArmPlan {
    let mut plan = config.arms[0].plan;
    plan.lines = 3;
    plan.cycle_ns = 1_000_000;
    for (axis, line) in plan.axes.iter_mut().zip([0, 0, 0, 1, 1, 2, 2]) {
        axis.line = line;
    }
    plan
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut criterion = support::criterion();
    let config = CanConfig::load(&CanConfig::shipped())?;
    codecs(&mut criterion, &config);
    let mut fast = [Rig::new(&three_buses(&config))?];
    cycles(
        &mut criterion,
        "can/cycle, 7 axes at 1 kHz on three buses",
        &mut fast,
    );
    let rigs = config.arms.iter().map(|arm| Rig::new(&arm.plan));
    let mut rigs = rigs.collect::<Result<Vec<_>, _>>()?;
    cycles(&mut criterion, "can/cycle, 7 axes", &mut rigs[..1]);
    cycles(&mut criterion, "can/cycle, 14 axes", &mut rigs);
    criterion.final_summary();
    // A stopped arm would be cheaper.
    match rigs.iter().chain(&fast).find_map(|rig| rig.arm.fault()) {
        Some(fault) => Err(fault.to_string().into()),
        None => Ok(()),
    }
}
