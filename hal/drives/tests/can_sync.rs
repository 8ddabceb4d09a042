//! A master whose thread was kept from running: one SYNC a cycle, and none for the cycles that were
//! missed.
#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use hal::{Arm as _, ArmCommand, JointVector, SafeTail, TICK_NS, TimeNs};
use trocar_canopen::Frame;
use trocar_canopen::master::config::CanConfig;
use trocar_canopen::master::{ArmPlan, Bus, CanArm, Offline, Received};
use trocar_drives::AxisConfig;
use trocar_drives::node::Node;
use trocar_drives::{IdealMotor, Network};

/// A bus that notes when the master says SYNC, and how many set-points came before it.
struct Noting {
    net: Network<IdealMotor>,
    sync_id: u16,
    syncs: Vec<(TimeNs, usize)>,
    set_points: usize,
}

impl Bus for Noting {
    fn now(&self) -> TimeNs {
        self.net.now()
    }

    fn send(&mut self, line: u8, frames: &[Frame]) -> usize {
        for frame in frames {
            if frame.id.raw() == self.sync_id {
                let set_points = core::mem::take(&mut self.set_points);
                self.syncs.push((self.net.now(), set_points));
            }
            self.set_points += usize::from((0x201..=0x27F).contains(&frame.id.raw()));
        }
        self.net.send(line, frames)
    }

    fn receive(&mut self, line: u8, sink: &mut dyn FnMut(Received)) {
        self.net.receive(line, sink);
    }

    fn flush(&mut self, line: u8) {
        self.net.flush(line);
    }

    fn wait(&mut self, until: TimeNs) {
        self.net.advance(until);
    }
}

fn enabled(plan: &ArmPlan) -> CanArm<Noting> {
    let mut net = Network::new(plan.lines, plan.bit_rate, 64);
    for axis in &plan.axes {
        let motor = IdealMotor::default();
        net.add(
            axis.line,
            Node::new(axis.node, &AxisConfig::of(axis, 0)),
            motor,
        );
    }
    let bus = Noting {
        net,
        sync_id: plan.sync_id.raw(),
        syncs: Vec::new(),
        set_points: 0,
    };
    let scanned = Offline::new(bus, plan).unwrap().scan().unwrap();
    let mapped = scanned.check_identity().unwrap().map().unwrap();
    mapped.home().unwrap().enable().unwrap()
}

/// So many control periods with a command that stays where the arm is.
fn tick(arm: &mut CanArm<Noting>, now: &mut TimeNs, ticks: u64) {
    for _ in 0..ticks {
        *now = now.plus_ns(TICK_NS);
        arm.bus_mut().wait(*now);
        let command = ArmCommand {
            stamp: *now,
            position: JointVector::zeros(),
            velocity: JointVector::zeros(),
            acceleration: JointVector::zeros(),
            jaw_position: 0.0,
            jaw_velocity: 0.0,
            enabled: true,
        };
        let _ = arm.read(*now);
        let _ = arm.write(&command, &SafeTail::hold(&command));
        arm.send_before(now.plus_ns(TICK_NS));
    }
}

/// After a stall there is one SYNC a cycle and none for those that were missed.
#[test]
fn missed_syncs_are_not_made_up_for() {
    let plan = CanConfig::load(&CanConfig::shipped()).unwrap().arms[0].plan;
    let cycle_ns = plan.cycle_ns;
    // The odd ones end between two SYNCs.
    for stall_us in [3_000, 8_000, 13_400, 14_999, 17_000, 80_000, 1_000_700] {
        let mut arm = enabled(&plan);
        let mut now = arm.bus_mut().now();
        tick(&mut arm, &mut now, 100);
        assert_eq!(arm.fault(), None);
        now = now.plus_ns(stall_us * 1000);
        arm.bus_mut().wait(now);
        arm.bus_mut().syncs.clear();
        tick(&mut arm, &mut now, 40);
        let syncs = &arm.bus_mut().syncs;
        // 20 cycles, of which the first begins at once.
        assert!((20..=21).contains(&syncs.len()), "{stall_us}: {syncs:?}");
        for pair in syncs.windows(2) {
            let ((before, _), (sync, set_points)) = (pair[0], pair[1]);
            let gap_ns = sync.since(before);
            assert!(gap_ns >= cycle_ns - TICK_NS / 2, "{stall_us}: {gap_ns}");
            assert_eq!(set_points, 7, "{stall_us}: one for each axis");
        }
        // What a drive bridges is no fault, and nobody goes on after what none does.
        let bridged = stall_us < 9 * cycle_ns / 1000;
        assert_eq!(arm.fault().is_none(), bridged, "{stall_us}");
    }
}

/// Shares of the bus in the table of plans, %, without and with all possible stuffing.
const SEVEN_AXES_AT_500_HZ: (u64, u64) = (74, 90);
const THREE_AXES_AT_1_KHZ: (u64, u64) = (67, 81);
/// Two axes are not in it: SYNC, two set-points and two answers have 459 to 555 bits.
const TWO_AXES_AT_1_KHZ: (u64, u64) = (45, 56);

/// How busy each bus of an arm that is led was in a second, per mille.
fn busy(plan: &ArmPlan) -> Vec<u64> {
    let mut arm = enabled(plan);
    let mut now = arm.bus_mut().now();
    tick(&mut arm, &mut now, 20);
    let look = |arm: &mut CanArm<Noting>| -> Vec<u64> {
        let wires = (0..plan.lines).map(|line| arm.bus_mut().net.wire(line).busy().0);
        wires.collect()
    };
    let before = look(&mut arm);
    tick(&mut arm, &mut now, 1000);
    let after = look(&mut arm);
    assert_eq!(arm.fault(), None);
    let spent = after
        .iter()
        .zip(&before)
        .map(|(after, before)| after - before);
    spent.map(|ns| ns / 1_000_000).collect()
}

/// The buses of an arm that is led are as busy as the table says.
#[test]
fn measured_bus_load_matches_the_table() {
    let shipped = CanConfig::load(&CanConfig::shipped()).unwrap().arms[0].plan;
    let within = |per_mille: u64, (low, high): (u64, u64)| {
        // Heartbeats come on top, half a per cent of them.
        assert!(
            (low * 10..=high * 10 + 5).contains(&per_mille),
            "{per_mille} per mille, not {low} to {high} %"
        );
    };
    assert_eq!(shipped.check_load(), Ok(()));
    within(busy(&shipped)[0], SEVEN_AXES_AT_500_HZ);
    let mut fast = ArmPlan {
        cycle_ns: 1_000_000,
        ..shipped
    };
    let refused = fast.check_load().unwrap_err().to_string();
    assert!(refused.contains("181.1 % of the bus"), "{refused}");
    fast.lines = 3;
    for (axis, line) in fast.axes.iter_mut().zip([0, 0, 0, 1, 1, 2, 2]) {
        axis.line = line;
    }
    assert_eq!(fast.check_load(), Ok(()));
    let busy = busy(&fast);
    within(busy[0], THREE_AXES_AT_1_KHZ);
    within(busy[1], TWO_AXES_AT_1_KHZ);
    within(busy[2], TWO_AXES_AT_1_KHZ);
}
