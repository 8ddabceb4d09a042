//! The master against emulated drives on buses in memory, in virtual time.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

mod answers;
mod bringup;
mod buses;
mod client;
mod corrupted;
mod faults;
mod foreign;
mod fuzz;
mod homing;
mod motion;
mod settings;
mod stops;
mod transmit_queue;
mod two_arms;
mod unused;
mod upset;
mod watched;
mod withdrawn;

use hal::tail::TAIL_AXES;
use hal::{Arm, ArmCommand, ArmError, ArmState, JointVector, SafeTail, TimeNs};
use trocar_canopen::master::*;
use trocar_canopen::{CanId, Frame, NodeId, Payload};
use trocar_drives::dictionary::table::PRODUCT_CODE;
use trocar_drives::node::{AxisConfig, Node};
use trocar_drives::{IdealMotor, Network, Tampering};

type Net = Network<IdealMotor>;

const MS: u64 = 1_000_000;
const COUNTS: f64 = 1e5;
/// Greatest speed of every axis, units/s.
const SPEED: f64 = 2.0;

fn node(axis: usize) -> NodeId {
    NodeId::new(u8::try_from(axis + 1).unwrap()).unwrap()
}

/// Seven axes, nodes 1 to 7, dealt to `lines` buses in turn of 3, 2 and 2.
fn plan(lines: u8, cycle_ns: u64) -> ArmPlan {
    let line_of = |axis: usize| match (lines, axis) {
        (1, _) => 0,
        (_, 0..=2) => 0,
        (_, 3..=4) => 1,
        _ => lines - 1,
    };
    ArmPlan {
        lines,
        bit_rate: 1_000_000,
        cycle_ns,
        sync_id: CanId::new(0x80).unwrap(),
        sync_counter: 0,
        master: NodeId::new(127).unwrap(),
        heartbeat_ms: 100,
        brake_ns: 0,
        homing: [None; TAIL_AXES],
        space: Space::Joint,
        axes: core::array::from_fn(|axis| AxisPlan {
            node: node(axis),
            line: line_of(axis),
            identity: (0, PRODUCT_CODE),
            counts_per_unit: COUNTS,
            counts_per_turn: 10_000,
            range: (-5.0, 5.0),
            speed_max: SPEED,
            following_max: 0.1,
            torque_rated: 1.0,
        }),
    }
}

fn axis_config(axis: usize) -> AxisConfig {
    AxisConfig {
        serial: u32::try_from(100 + axis).unwrap(),
        range: (-500_000, 500_000),
        speed_max: 400_000,
        decelerations: (10_000_000, 20_000_000),
        following_window: 5_000,
        ..AxisConfig::default()
    }
}

fn drive(axis: usize) -> Node {
    Node::new(node(axis), &axis_config(axis))
}

/// The drives of `plan`, each motor at 0.1 units times its place.
fn network(plan: &ArmPlan) -> Net {
    network_of(plan, drive)
}

fn network_of(plan: &ArmPlan, drive: impl Fn(usize) -> Node) -> Net {
    let mut net = Network::new(plan.lines, plan.bit_rate, 64);
    for (axis, place) in (0..TAIL_AXES).zip(1_u8..) {
        let motor = IdealMotor {
            position_counts: f64::from(place) * 0.1 * COUNTS,
            stuck: false,
        };
        net.add(plan.axes[axis].line, drive(axis), motor);
    }
    net
}

/// An enabled arm with a controller that tells it where to be.
struct Bench {
    arm: CanArm<Net>,
    cycle_ns: u64,
    now: TimeNs,
    position: [f64; TAIL_AXES],
    enabled: bool,
}

impl Bench {
    fn on(plan: &ArmPlan) -> Self {
        Self::with(network(plan), plan)
    }

    fn with(net: Net, plan: &ArmPlan) -> Self {
        let arm = Offline::new(net, plan)
            .unwrap()
            .scan()
            .unwrap()
            .check_identity()
            .unwrap()
            .map()
            .unwrap()
            .home()
            .unwrap()
            .enable()
            .unwrap();
        Self::of(arm, plan)
    }

    /// Of an arm that is enabled.
    fn of(mut arm: CanArm<Net>, plan: &ArmPlan) -> Self {
        let now = arm.bus_mut().now();
        Self {
            arm,
            cycle_ns: plan.cycle_ns,
            now,
            position: core::array::from_fn(|axis| {
                0.1 * (1.0 + f64::from(u8::try_from(axis).unwrap()))
            }),
            enabled: true,
        }
    }

    fn new() -> Self {
        Self::on(&plan(1, 2 * MS))
    }

    fn command(&self) -> ArmCommand {
        ArmCommand {
            stamp: self.now,
            position: JointVector::from_column_slice(&self.position[..6]),
            velocity: JointVector::zeros(),
            acceleration: JointVector::zeros(),
            jaw_position: self.position[6],
            jaw_velocity: 0.0,
            enabled: self.enabled,
        }
    }

    fn read(&mut self) -> Result<ArmState, ArmError> {
        self.now = self.now.plus_ns(self.cycle_ns);
        let now = self.now;
        self.arm.bus_mut().wait(now);
        self.arm.read(now)
    }

    /// A cycle of a controller that moves every axis by `step`.
    fn cycle(&mut self, step: f64) -> Result<ArmState, ArmError> {
        let measured = self.read();
        for position in &mut self.position {
            *position += step;
        }
        let command = self.command();
        let _ = self.arm.write(&command, &SafeTail::hold(&command));
        self.send();
        measured
    }

    /// Lets the command leave now, as the runtime does.
    fn send(&mut self) {
        self.arm.send_before(self.now.plus_ns(self.cycle_ns));
    }

    fn cycles(&mut self, count: u32, step: f64) -> Result<ArmState, ArmError> {
        let mut last = self.cycle(step);
        for _ in 1..count {
            last = self.cycle(step);
        }
        last
    }

    /// Lets only time pass: the controller and everything about it is dead.
    fn dead_for(&mut self, ns: u64) {
        self.now = self.now.plus_ns(ns);
        let now = self.now;
        self.arm.bus_mut().wait(now);
    }

    fn net(&mut self) -> &mut Net {
        self.arm.bus_mut()
    }

    fn tamper(&mut self, mut decide: impl FnMut(&Frame) -> Tampering + 'static) {
        self.net()
            .tamper(Box::new(move |_, _, frame| decide(frame)));
    }

    fn motors(&mut self) -> [f64; TAIL_AXES] {
        core::array::from_fn(|axis| self.net().motor(node(axis)).unwrap().position_counts / COUNTS)
    }

    fn torques(&mut self) -> [bool; TAIL_AXES] {
        core::array::from_fn(|axis| {
            self.net()
                .node(node(axis))
                .unwrap()
                .power_state()
                .has_torque()
        })
    }

    /// After a fault: the arm reports it, all axes come to rest, lose their torque and never get it
    /// back.
    fn assert_stopped_for_good(&mut self, fault: &str) {
        assert_eq!(
            self.arm.fault().map(|f| f.to_string()).as_deref(),
            Some(fault)
        );
        let _ = self.cycles(50, 0.0);
        let rest = self.motors();
        let last = self.cycles(450, 0.001);
        assert!(matches!(last, Err(ArmError::DriveFault { .. })), "{last:?}");
        let later = self.motors();
        assert!(same(&rest, &later), "{rest:?} {later:?}");
        assert_eq!(self.torques(), [false; TAIL_AXES]);
        assert_eq!(
            self.arm.fault().map(|f| f.to_string()).as_deref(),
            Some(fault)
        );
    }
}

/// Whether two arms stand at the same place.
fn same(a: &[f64; TAIL_AXES], b: &[f64; TAIL_AXES]) -> bool {
    a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-9)
}

fn frame(id: u16, data: &[u8]) -> Frame {
    Frame::new(CanId::new(id).unwrap(), Payload::new(data).unwrap())
}
