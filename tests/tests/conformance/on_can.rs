//! An arm on buses in memory, with emulated drives.

use hal::config::Source;
use hal::psm::HOME_INSERTION_M;
use hal::{Arm, TimeNs};
use trocar_canopen::cia301::emcy::ErrorCode;
use trocar_canopen::cia301::{Cob, emcy};
use trocar_canopen::master::config::CanConfig;
use trocar_canopen::master::{ArmPlan, Bus as _, CanArm, Offline, Space};
use trocar_drives::node::{AxisConfig, Node};
use trocar_drives::{IdealMotor, Network, Tampering};

use crate::rig::{Axes, Nature, Rig};

type Net = Network<IdealMotor>;

/// Where the motors are found, in joints.
const FOUND: Axes = [0.05, -0.04, HOME_INSERTION_M, 0.3, -0.2, 0.1, 0.4];

const SHIPPED: &str = include_str!("../../../config/can.toml");

/// The first arm of the shipped configuration with some of its text replaced.
pub(crate) fn plan(changes: &[(&str, &str)]) -> ArmPlan {
    let text = changes.iter().fold(SHIPPED.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replacen(from, to, 1)
    });
    let config = CanConfig::load(&Source::embedded("can.toml", &text)).unwrap();
    config.arms[0].plan
}

/// A cycle of 1 ms on three buses.
pub(crate) const THREE_BUSES: [(&str, &str); 3] = [
    ("\ncycle_us = 2000", "\ncycle_us = 1000"),
    (
        "interfaces = [\"vcan0\"]",
        "interfaces = [\"vcan0\", \"vcan1\", \"vcan2\"]",
    ),
    (
        "lines = [0, 0, 0, 0, 0, 0, 0]",
        "lines = [0, 0, 0, 1, 1, 2, 2]",
    ),
];

/// The drives of `plan` on its buses.
pub(crate) fn network(plan: &ArmPlan) -> Net {
    let mut net = Net::new(plan.lines, plan.bit_rate, 64);
    let found = plan.space.from_joints(&FOUND);
    for (axis, units) in plan.axes.iter().zip(found) {
        let motor = IdealMotor {
            position_counts: units * axis.counts_per_unit,
            stuck: false,
        };
        net.add(
            axis.line,
            Node::new(axis.node, &AxisConfig::of(axis, 0)),
            motor,
        );
    }
    net
}

fn bring_up(net: Net, plan: &ArmPlan) -> CanArm<Net> {
    let scanned = Offline::new(net, plan).unwrap().scan().unwrap();
    let mapped = scanned.check_identity().unwrap().map().unwrap();
    mapped.home().unwrap().enable().unwrap()
}

/// An enabled arm.
pub(crate) struct OnCan {
    plan: ArmPlan,
    /// There is one but while it is brought up.
    arm: Option<CanArm<Net>>,
    now: TimeNs,
    period_ns: u64,
}

/// A fresh arm of `plan` for a controller with a period of `period_ns`.
pub(crate) fn make(plan: &ArmPlan, period_ns: u64) -> Box<dyn Rig> {
    let mut arm = bring_up(network(plan), plan);
    Box::new(OnCan {
        plan: *plan,
        now: arm.bus_mut().now(),
        arm: Some(arm),
        period_ns,
    })
}

impl OnCan {
    fn net(&mut self) -> &mut Net {
        self.arm.as_mut().unwrap().bus_mut()
    }
}

impl Rig for OnCan {
    fn arm(&mut self) -> &mut dyn Arm {
        self.arm.as_mut().unwrap()
    }

    fn now(&self) -> TimeNs {
        self.now
    }

    fn pass(&mut self) {
        let now = self.now.plus_ns(self.period_ns);
        // A controller that is faster than the bus says when it reads next, as the runtime does.
        if self.period_ns < self.plan.cycle_ns {
            self.arm.as_mut().unwrap().send_before(now);
        }
        self.now = now;
        self.net().wait(now);
    }

    fn nature(&self) -> Nature {
        let cycle_ns = self.plan.cycle_ns;
        Nature {
            period_ns: self.period_ns,
            // The answers to a SYNC are read from the next one on, until the one after that.
            age_max_ns: 2 * cycle_ns - self.period_ns,
            settle_ns: 20_000_000,
            bridged: 2 * cycle_ns / self.period_ns,
        }
    }

    fn deafen(&mut self, periods: u64) -> bool {
        let until = self.now.plus_ns(periods * self.period_ns);
        self.net().tamper(Box::new(move |_, now, frame| {
            let answer = matches!(Cob::of(frame.id), Cob::TransmitPdo(..));
            if answer && now < until {
                Tampering::Drop
            } else {
                Tampering::Pass
            }
        }));
        true
    }

    fn fail(&mut self, axis: u8, code: u16) -> bool {
        let node = self.plan.axes[usize::from(axis)].node;
        self.net().poke(node, |now, drive, out| {
            drive.fail(now, ErrorCode(code), emcy::register::CURRENT, out);
        });
        true
    }

    fn reset(&mut self) -> bool {
        let net = self.arm.take().unwrap().release();
        let mut arm = bring_up(net, &self.plan);
        self.now = arm.bus_mut().now();
        self.arm = Some(arm);
        true
    }
}

/// The plans that are tested, and the controller's period on each.
pub(crate) fn plans() -> [(&'static str, ArmPlan, u64); 4] {
    let (one, three) = (plan(&[]), plan(&THREE_BUSES));
    let coupled = ArmPlan {
        space: Space::Actuator,
        ..plan(&[("space = \"joint\"", "space = \"actuator\"")])
    };
    [
        ("one bus at 500 Hz", one, one.cycle_ns),
        (
            "one bus at 500 Hz under a controller at 1 kHz",
            one,
            1_000_000,
        ),
        ("three buses at 1 kHz", three, three.cycle_ns),
        ("actuators on one bus", coupled, coupled.cycle_ns),
    ]
}
