//! What a run's result says of drives and buses.
//!
//! Counters are those of the master's cycles alone; what the kernel counts on the interfaces is in
//! the log ([`super::bus_log`]).

use hal::ARM_NAMES;
use trocar_canopen::master::Space;
use trocar_canopen::master::axis::AxisHealth;

use super::options::CanOptions;
use crate::rig::can::{BusArm, CanRig};
use crate::session::summary::{CanArmSummary, CanBusSummary, CanSummary};

/// How the drives of `rig` and their buses have been.
///
/// Cycle, bit rate and space are those of the first arm. To be called after the arms were taken
/// down, which decides `confirmed_down`.
pub(super) fn summary(rig: &CanRig, can: &CanOptions) -> CanSummary {
    let arms = rig.arms.iter().zip(rig.confirmed_down.iter());
    let arms = arms.zip(&can.config.arms).zip(ARM_NAMES);
    let arms: Vec<CanArmSummary> = arms
        .map(|(((arm, down), place), name)| CanArmSummary {
            confirmed_down: *down,
            ..arm_summary(arm, &place.interfaces, name)
        })
        .collect();
    let first = rig.arms.first.plan();
    CanSummary {
        cycle_us: first.cycle_ns / 1000,
        bit_rate_bit_s: first.bit_rate,
        actuator_space: first.space == Space::Actuator,
        arms,
    }
}

/// Answers are summed over the arm's axes, buses are one entry each; `confirmed_down` is left to
/// the caller. A fault of a bus may have no node.
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
        confirmed_down: false,
        fault: fault.map(|fault| fault.to_string()),
        fault_node: fault
            .and_then(|fault| fault.who())
            .map(|who| who.node.raw()),
    }
}
