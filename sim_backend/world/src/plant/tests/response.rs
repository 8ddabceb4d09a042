//! Steps of every drive against the arithmetic of the shipped gains, worked out here anew.
//!
//! With viscous friction b, a drive under its PD law is `inertia x'' + (d + b) x' + p (x - target) =
//! 0`. In steps of h, velocity first, that is the recurrence `e'' = (1 + a - c) e' - a e` of the
//! error e with `a = (1 - h d / J) / (1 + h b / J)` and `c = (h^2 p / J) / (1 + h b / J)`, which
//! the two roots of its characteristic polynomial solve.

use core::f64::consts::{PI, TAU};

use hal::psm::ACTUATORS;
use hal::{JointVector, TimeNs};

use super::{FREE, setpoint, shipped};
use crate::plant::{
    AXIS_COUNT, AxisVector, Plant, PlantConfig, actuator_positions, joint_positions,
};

/// A step on each actuator, rad (m): none reaches a limit of effort or current.
const STEP: AxisVector = [0.02, 0.02, 0.001, 0.012, 0.012, 0.012, 0.012];
const SUBSTEPS_PER_S: f64 = 4000.0;

fn start() -> AxisVector {
    actuator_positions(&[0.0, 0.0, 0.12, 0.0, 0.0, 0.0, 0.6])
}

fn quantum(axis: usize) -> f64 {
    TAU / ACTUATORS[axis].encoder_counts_per_turn / ACTUATORS[axis].gear_ratio
}

/// Actuator `axis` after each of `milliseconds` as a share of the step.
fn stepped(config: &PlantConfig, axis: usize, milliseconds: usize) -> Vec<f64> {
    let start = start();
    let from = joint_positions(&start);
    let mut plant = Plant::new(config, &JointVector::from_column_slice(&from[..6]), from[6]);
    let mut target = start;
    target[axis] += STEP[axis];
    let target = joint_positions(&target);
    let mut command = setpoint(
        JointVector::from_column_slice(&target[..6]),
        JointVector::zeros(),
    );
    command.jaw_position = target[6];
    plant.command(&command);
    let mut shares = Vec::with_capacity(milliseconds);
    for _ in 0..milliseconds {
        plant.step(&FREE);
        let now = actuator_positions(&plant.joints());
        shares.push((now[axis] - start[axis]) / STEP[axis]);
        for other in (0..AXIS_COUNT).filter(|&other| other != axis) {
            assert!(
                (now[other] - start[other]).abs() <= 2.0 * quantum(other),
                "{axis} moves {other}"
            );
        }
    }
    shares
}

/// The drives without Coulomb friction, whose response is linear but for the encoders' counts.
fn smooth() -> PlantConfig {
    PlantConfig {
        coulomb: [0.0; AXIS_COUNT],
        ..shipped()
    }
}

/// The recurrence's solution after each millisecond.
fn expected(config: &PlantConfig, axis: usize, milliseconds: usize) -> Vec<f64> {
    assert_eq!(config.substeps, 4);
    let (h, inertia) = (1.0 / SUBSTEPS_PER_S, config.inertia[axis]);
    let drag = 1.0 + h * config.viscous[axis] / inertia;
    let a = (1.0 - h * ACTUATORS[axis].d / inertia) / drag;
    let c = h * h * ACTUATORS[axis].p / inertia / drag;
    // Error 1 at rest, then 1 - c after the first step.
    let (sum, product) = (1.0 + a - c, a);
    let spread = 0.25 * sum * sum - product;
    let error = |steps: f64| {
        if spread > 0.0 {
            let (slow, fast) = (0.5 * sum + spread.sqrt(), 0.5 * sum - spread.sqrt());
            let weight = (1.0 - c - fast) / (slow - fast);
            weight * slow.powf(steps) + (1.0 - weight) * fast.powf(steps)
        } else {
            let angle = (-spread).sqrt().atan2(0.5 * sum);
            let radius = product.sqrt();
            let beside = ((1.0 - c) / radius - angle.cos()) / angle.sin();
            radius.powf(steps) * ((steps * angle).cos() + beside * (steps * angle).sin())
        }
    };
    (1..=u32::try_from(milliseconds).unwrap())
        .map(|millisecond| 1.0 - error(f64::from(4 * millisecond)))
        .collect()
}

/// Time at which a response first reaches `share`, s.
fn reaches(response: &[f64], share: f64) -> f64 {
    let index = response.iter().position(|&at| at >= share).unwrap();
    let before = if index == 0 { 0.0 } else { response[index - 1] };
    let part = (share - before) / (response[index] - before);
    1e-3 * (f64::from(u32::try_from(index).unwrap()) + part)
}

#[test]
fn every_drive_steps_as_its_recurrence_says() {
    for (axis, step) in STEP.into_iter().enumerate() {
        let found = stepped(&smooth(), axis, 400);
        // The controller sees whole counts: half a count at the input is at most about half a count
        // at the output.
        let tolerance = quantum(axis) / step;
        for (millisecond, (found, expected)) in
            found.iter().zip(expected(&smooth(), axis, 400)).enumerate()
        {
            assert!(
                (found - expected).abs() <= tolerance,
                "drive {axis} at {millisecond} ms: {found} against {expected}"
            );
        }
    }
}

#[test]
fn rise_and_overshoot_are_those_of_a_second_order_system() {
    let config = smooth();
    for axis in 0..AXIS_COUNT {
        let found = stepped(&config, axis, 400);
        let (p, d) = (ACTUATORS[axis].p, ACTUATORS[axis].d + config.viscous[axis]);
        let natural = (p / config.inertia[axis]).sqrt();
        let damping = 0.5 * d / (p * config.inertia[axis]).sqrt();
        // Delay to one half and rise from a tenth to nine tenths, by the closed form of continuous
        // time.
        let error = |time_s: f64| {
            let root = (1.0 - damping * damping).abs().sqrt();
            let (turn, share) = (natural * root * time_s, damping / root);
            let shape = if damping < 1.0 {
                turn.cos() + share * turn.sin()
            } else {
                turn.cosh() + share * turn.sinh()
            };
            (-damping * natural * time_s).exp() * shape
        };
        let closed: Vec<f64> = (1..=400_u32)
            .map(|millisecond| 1.0 - error(1e-3 * f64::from(millisecond)))
            .collect();
        let rise = |response: &[f64]| reaches(response, 0.9) - reaches(response, 0.1);
        let (found_s, closed_s) = (rise(&found), rise(&closed));
        assert!(
            (found_s / closed_s - 1.0).abs() < 0.03,
            "drive {axis} rises in {found_s} s, not {closed_s}"
        );
        let overshoot = found.iter().fold(0.0_f64, |most, &at| most.max(at)) - 1.0;
        let closed = if damping < 1.0 {
            (-PI * damping / (1.0 - damping * damping).sqrt()).exp()
        } else {
            0.0
        };
        assert!(
            (overshoot - closed).abs() < 0.002 + quantum(axis) / STEP[axis],
            "drive {axis} overshoots by {overshoot}, not {closed}"
        );
    }
}

/// What is left of a step is within coulomb friction over the gain.
#[test]
fn step_error_is_within_friction_over_gain() {
    let config = shipped();
    for axis in 0..AXIS_COUNT {
        let found = stepped(&config, axis, 1500);
        let left = (found[1499] - 1.0).abs() * STEP[axis];
        let band = config.coulomb[axis] / ACTUATORS[axis].p + quantum(axis);
        assert!(left <= band, "drive {axis}: {left} of {band}");
        assert!(
            (found[1499] - found[1400]).abs() < 1e-12,
            "drive {axis} creeps"
        );
    }
}

#[test]
fn a_drive_without_torque_runs_down_as_its_friction_says() {
    // J v' = -b v - c: v = (v0 + c / b) exp(-b t / J) - c / b until it stands.
    let config = shipped();
    for axis in [0, 1, 2, 3] {
        let mut plant = Plant::new(
            &config,
            &JointVector::from([0.0, 0.0, 0.12, 0.0, 0.0, 0.0]),
            0.6,
        );
        let mut command = setpoint(
            JointVector::from([0.0, 0.0, 0.12, 0.0, 0.0, 0.0]),
            JointVector::zeros(),
        );
        command.enabled = false;
        plant.command(&command);
        let mut load = FREE;
        load.efforts[axis] = 5.0 * config.coulomb[axis] / if axis == 3 { 1.5632 } else { 1.0 };
        for _ in 0..50 {
            plant.step(&load);
        }
        let speed = |plant: &Plant| actuator_positions(&plant.joint_velocities())[axis].abs();
        let (inertia, b, c) = (
            config.inertia[axis],
            config.viscous[axis],
            config.coulomb[axis],
        );
        let start = speed(&plant);
        let stands_s = inertia / b * (1.0 + start * b / c).ln();
        let mut time_s = 0.0;
        while time_s < stands_s + 0.01 {
            plant.step(&FREE);
            time_s += 1e-3;
            let expected = ((start + c / b) * (-b * time_s / inertia).exp() - c / b).max(0.0);
            assert!(
                (speed(&plant) - expected).abs() < 0.01 * start,
                "drive {axis} at {time_s} s: {} against {expected}",
                speed(&plant)
            );
        }
        assert!(plant.measured(TimeNs(0)).effort.norm() < 1e-12);
        assert!(speed(&plant) < 1e-12);
    }
}
