//! Arms on CAN as the control thread reaches them. Hot path: bounded, no allocation, no lock; its system calls are the
//! arms' sockets.

use hal::{ARM_NAMES, Arm as _, ArmState, TICK_NS, TimeNs};
use trocar_canopen::master::axis::AxisHealth;
use trocar_canopen::master::{CanArm, Space};
use trocar_canopen::socket::SocketBus;

use super::super::arm_link::{ArmLink, Measured, Setpoint};
use super::CanOptions;
use super::happened::{Happened, Noticed};
use crate::mailbox::MailboxWriter;
use crate::per_arm::PerArm;
use crate::rt::{MonotonicClock, Periodic};
use crate::session::can_clock::CanClock;
use crate::session::summary::{CanArmSummary, CanBusSummary, CanSummary};

/// An arm of this machine's buses.
pub(super) type BusArm = CanArm<SocketBus<CanClock>>;

/// The arms, and who else wants to know of them.
pub(super) struct CanLink {
    pub(super) arms: PerArm<BusArm>,
    measured: MailboxWriter<PerArm<ArmState>>,
    noticed: MailboxWriter<Noticed>,
    happened: PerArm<Happened>,
}

impl CanLink {
    pub(super) fn new(
        arms: PerArm<BusArm>,
        measured: MailboxWriter<PerArm<ArmState>>,
        noticed: MailboxWriter<Noticed>,
    ) -> Self {
        let happened = arms.as_ref().map(|_| Happened::default());
        Self {
            arms,
            measured,
            noticed,
            happened,
        }
    }

    /// What has stopped each arm, if something did, in words and with the arm's name.
    pub(super) fn fault_texts(&self) -> Vec<String> {
        let named = self.arms.iter().zip(ARM_NAMES);
        named
            .filter_map(|(arm, name)| arm.fault().map(|fault| format!("{name}: {fault}")))
            .collect()
    }

    /// How the drives and the buses have been.
    pub(super) fn summary(&self, can: &CanOptions) -> CanSummary {
        let arms = self.arms.iter().zip(&can.config.arms).zip(ARM_NAMES);
        let arms: Vec<CanArmSummary> = arms
            .map(|((arm, place), name)| arm_summary(arm, &place.interfaces, name))
            .collect();
        let first = self.arms.first.plan();
        CanSummary {
            cycle_us: first.cycle_ns / 1000,
            bit_rate_bit_s: first.bit_rate,
            actuator_space: first.space == Space::Actuator,
            arms,
        }
    }

    /// Takes all drives down through the states of CiA 402, all arms at once, and stops their nodes.
    pub(super) fn take_down(&mut self, clock: MonotonicClock) {
        let first = clock.now().plus_ns(TICK_NS);
        let longest_ns = self.arms.iter().map(CanArm::take_down_ns).max();
        let end = first.plus_ns(longest_ns.unwrap_or(0));
        let mut periodic = Periodic::new(clock, first, TICK_NS);
        loop {
            let now = periodic.wait().due;
            let down = self.arms.iter_mut().map(|arm| arm.take_down(now));
            // Each arm has its turn, whether the ones before it are down or not.
            if down.fold(true, |all, one| all & one) || now >= end {
                break;
            }
        }
        self.arms.iter_mut().for_each(CanArm::shut_down);
    }

    fn notice(&mut self, now: TimeNs) {
        let happened = self.arms.as_ref().map(|arm| Happened {
            fault: arm.fault(),
            passives: arm.cycle().line_health().map(|health| health.passives),
        });
        if happened != self.happened {
            self.happened = happened;
            self.noticed.put((now, happened));
        }
    }
}

fn arm_summary(arm: &BusArm, interfaces: &[String], name: &'static str) -> CanArmSummary {
    let (plan, cycle) = (arm.plan(), arm.cycle());
    let health = cycle.axis_health();
    let sum = |count: fn(&AxisHealth) -> u64| health.iter().map(count).sum();
    let fault = arm.fault();
    let lines = cycle
        .line_health()
        .iter()
        .zip(0..plan.lines)
        .zip(interfaces);
    CanArmSummary {
        arm: name,
        buses: lines
            .map(|((health, line), interface)| CanBusSummary {
                interface: interface.clone(),
                planned_per_mille: plan.traffic(line).load().per_mille(),
                frames_lost: health.lost,
                error_passive: health.passives,
                frames_foreign: health.foreign,
            })
            .collect(),
        answers_missed: sum(|axis| axis.missed),
        answers_late: sum(|axis| axis.late),
        answers_rejected: sum(|axis| axis.rejected),
        syncs_left_out: cycle.left_out(),
        commands_refused: arm.refused(),
        fault: fault.map(|fault| fault.to_string()),
        fault_node: fault
            .and_then(|fault| fault.who())
            .map(|who| who.node.raw()),
    }
}

impl ArmLink for CanLink {
    fn read(&mut self, now: TimeNs) -> Option<PerArm<Measured>> {
        let PerArm { first, second } = &mut self.arms;
        let measured = PerArm {
            first: first.read(now),
            second: second.as_mut().map(|arm| arm.read(now)),
        };
        self.notice(now);
        let states = PerArm {
            first: measured.first.ok(),
            second: measured.second.map(Result::ok),
        };
        let second = match states.second {
            None => Some(None),
            Some(state) => state.map(Some),
        };
        if let (Some(first), Some(second)) = (states.first, second) {
            self.measured.put(PerArm { first, second });
        }
        Some(measured)
    }

    fn write(&mut self, setpoints: &PerArm<Setpoint>) {
        for (arm, (command, tail)) in self.arms.iter_mut().zip(setpoints.iter()) {
            // A fault is told at the next reading too, and there the controller hears of it.
            let _told = arm.write(command, tail);
        }
    }
}
