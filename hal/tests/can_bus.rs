//! The master and the emulated drives on a real bus: the kernel's sockets between two threads.
//!
//! `make test-can` runs these where the interfaces are, which is why a plain `cargo test` leaves them out.
#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread;
use std::time::{Duration, Instant};

use hal::can::bus::Network;
use hal::can::bus::network::IdealMotor;
use hal::can::master::{ArmPlan, AxisPlan, Bus, Fault, Offline, Received, Space, Trouble};
use hal::can::node::{AxisConfig, Node};
use hal::can::od::table::PRODUCT_CODE;
use hal::can::socket::{Clock, SocketBus};
use hal::can::{CanId, Frame, NodeId, Payload};
use hal::{Arm, ArmCommand, JointVector, SafeTail, TimeNs};

const MS: u64 = 1_000_000;
const COUNTS: f64 = 1e5;

/// Real time since the test began.
#[derive(Clone, Copy, Debug)]
struct Real(Instant);

impl Real {
    #[expect(clippy::disallowed_methods, reason = "a real bus has a real clock")]
    fn start() -> Self {
        Self(Instant::now())
    }
}

impl Clock for Real {
    fn now(&self) -> TimeNs {
        TimeNs(u64::try_from(self.0.elapsed().as_nanos()).unwrap())
    }

    #[expect(clippy::disallowed_methods, reason = "a real bus has a real clock")]
    fn wait(&mut self, until: TimeNs) {
        thread::sleep(Duration::from_nanos(until.since(self.now())));
    }
}

fn socket(name: &str) -> SocketBus<Real> {
    SocketBus::open(&[name.to_owned()], Real::start()).unwrap()
}

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::new(CanId::new(id).unwrap(), Payload::new(data).unwrap())
}

/// Waits for `count` things on the bus.
fn receive(bus: &mut SocketBus<Real>, count: usize) -> Vec<Received> {
    let mut all = Vec::new();
    while all.len() < count {
        bus.receive(0, &mut |received| all.push(received));
        let later = bus.now().plus_ns(MS);
        bus.wait(later);
    }
    all
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn frames_cross_in_batches_and_in_order() {
    let (mut a, mut b) = (socket("vcan1"), socket("vcan1"));
    let frames: Vec<Frame> = (0..50).map(|n| frame(0x100 + n, &[1, 2, 3])).collect();
    assert_eq!(a.send(0, &frames), 50);
    let received = receive(&mut b, 50);
    let expected: Vec<Received> = frames.into_iter().map(Received::Frame).collect();
    assert_eq!(received, expected);
    // A socket does not hear itself.
    let mut own = 0;
    a.receive(0, &mut |_| own += 1);
    assert_eq!(own, 0);
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn a_slow_reader_is_told_how_many_frames_it_missed() {
    let (mut a, mut b) = (socket("vcan1"), socket("vcan1"));
    for n in 0..4000 {
        a.send(0, &[frame(0x123, &u16::to_le_bytes(n))]);
    }
    let (mut frames, mut lost) = (0, 0);
    let mut count = |received: Received| match received {
        Received::Frame(_) => frames += 1,
        Received::Trouble(Trouble::Lost(n)) => lost += n,
        Received::Trouble(_) => {}
    };
    b.receive(0, &mut count);
    // The count comes with the first frame that is queued after the loss.
    a.send(0, &[frame(0x123, &[])]);
    b.receive(0, &mut count);
    assert!(lost > 0 && frames + lost == 4001, "{frames} {lost}");
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn error_frames_of_the_kernel_are_heard_as_trouble() {
    let mut bus = socket("vcan1");
    let sent = std::process::Command::new("cansend")
        .args(["vcan1", "20000040#0000000000000000"])
        .status()
        .unwrap();
    assert!(sent.success());
    assert_eq!(receive(&mut bus, 1), [Received::Trouble(Trouble::BusOff)]);
}

fn node(axis: u8) -> NodeId {
    NodeId::new(axis + 1).unwrap()
}

/// A slow beat: inside user-mode Linux a system call takes a hundred microseconds.
fn plan() -> ArmPlan {
    ArmPlan {
        lines: 1,
        bit_rate: 1_000_000,
        cycle_ns: 20 * MS,
        sync_id: CanId::new(0x80).unwrap(),
        sync_counter: 0,
        master: NodeId::new(127).unwrap(),
        heartbeat_ms: 500,
        space: Space::Joint,
        axes: core::array::from_fn(|axis| AxisPlan {
            node: node(u8::try_from(axis).unwrap()),
            line: 0,
            identity: (0, PRODUCT_CODE),
            counts_per_unit: COUNTS,
            range: (-5.0, 5.0),
            speed_max: 2.0,
            following_max: 0.1,
            torque_rated: 1.0,
        }),
    }
}

/// Seven drives on `name` until `stop`; gives where their motors are then.
fn drives(name: &str, stop: &AtomicBool) -> [f64; 7] {
    let mut bus = socket(name);
    let mut net: Network<IdealMotor> = Network::new(1, 1_000_000, 1000);
    for axis in 0..7 {
        let config = AxisConfig {
            range: (-500_000, 500_000),
            speed_max: 400_000,
            ..AxisConfig::default()
        };
        net.add(0, Node::new(node(axis), &config), IdealMotor::default());
    }
    while !stop.load(Ordering::Relaxed) {
        let mut heard = Vec::new();
        bus.receive(0, &mut |received| {
            if let Received::Frame(frame) = received {
                heard.push(frame);
            }
        });
        net.send(0, &heard);
        net.advance(bus.now());
        let mut said = Vec::new();
        net.receive(0, &mut |received| {
            if let Received::Frame(frame) = received {
                said.push(frame);
            }
        });
        bus.send(0, &said);
        let later = bus.now().plus_ns(MS);
        bus.wait(later);
    }
    core::array::from_fn(|axis| {
        net.motor(node(u8::try_from(axis).unwrap()))
            .unwrap()
            .position_counts
            / COUNTS
    })
}

#[test]
#[ignore = "needs a CAN bus: make test-can"]
fn the_master_leads_seven_drives_over_sockets_and_stops_at_bus_off() {
    let stop = Arc::new(AtomicBool::new(false));
    let told = Arc::clone(&stop);
    let emulator = thread::spawn(move || drives("vcan0", &told));
    let plan = plan();
    let bus = socket("vcan0");
    let homed = Offline::new(bus, &plan).unwrap().scan().unwrap();
    let homed = homed
        .check_identity()
        .unwrap()
        .map()
        .unwrap()
        .home()
        .unwrap();
    let mut arm = homed.enable().unwrap();
    let mut at = arm.bus_mut().now();
    let mut wanted = 0.0;
    let mut measured = 0.0;
    for _ in 0..100 {
        at = at.plus_ns(plan.cycle_ns);
        arm.bus_mut().wait(at);
        measured = arm.read(at).unwrap().position[3];
        wanted += 0.005;
        let command = ArmCommand {
            stamp: at,
            position: JointVector::repeat(wanted),
            velocity: JointVector::zeros(),
            acceleration: JointVector::zeros(),
            jaw_position: wanted,
            jaw_velocity: 0.0,
            enabled: true,
        };
        arm.write(&command, &SafeTail::hold(&command)).unwrap();
    }
    assert!((wanted - measured).abs() < 0.03, "{wanted} {measured}");
    let sent = std::process::Command::new("cansend")
        .args(["vcan0", "20000040#0000000000000000"])
        .status()
        .unwrap();
    assert!(sent.success());
    for _ in 0..10 {
        at = at.plus_ns(plan.cycle_ns);
        arm.bus_mut().wait(at);
        let _ = arm.read(at);
    }
    assert_eq!(arm.fault(), Some(Fault::BusOff { line: 0 }));
    stop.store(true, Ordering::Relaxed);
    let motors = emulator.join().unwrap();
    assert!(
        motors.iter().all(|m| (m - wanted).abs() < 0.05),
        "{motors:?}"
    );
}
