//! Facts about the drives, against the arithmetic of the shipped gains.

use core::f64::consts::TAU;

use hal::psm::{ACTUATORS, EFFORT_MAX};
use hal::{ArmCommand, JOINT_COUNT, JointVector, TimeNs};

use super::{
    AXIS_COUNT, AxisVector, Load, Plant, PlantConfig, actuator_efforts, actuator_positions,
};
use crate::shipped;

const FREE: Load = Load {
    efforts: [0.0; AXIS_COUNT],
    squeeze_damping: 0.0,
};

fn shipped() -> PlantConfig {
    shipped::world("needle-lift").plant
}

fn home() -> JointVector {
    JointVector::from([0.0, 0.0, 0.12, 0.0, 0.0, 0.0])
}

fn plant() -> Plant {
    Plant::new(&shipped(), &home(), 0.3)
}

fn setpoint(position: JointVector, velocity: JointVector) -> ArmCommand {
    ArmCommand {
        stamp: TimeNs(0),
        position,
        velocity,
        acceleration: JointVector::zeros(),
        jaw_position: 0.3,
        jaw_velocity: 0.0,
        enabled: true,
    }
}

/// Lag behind a ramp of `rate` on `joint`, as a time, s.
fn ramp_lag_s(joint: usize, rate: f64, velocity_is_sent: bool) -> f64 {
    // The lag of the gains alone: friction adds its own share.
    let none = [0.0; AXIS_COUNT];
    let config = PlantConfig {
        coulomb: none,
        viscous: none,
        ..shipped()
    };
    let mut plant = Plant::new(&config, &home(), 0.3);
    let mut wanted = home();
    for _ in 0..600 {
        wanted[joint] += rate * 1e-3;
        let mut velocity = JointVector::zeros();
        velocity[joint] = if velocity_is_sent { rate } else { 0.0 };
        plant.command(&setpoint(wanted, velocity));
        plant.step(&FREE);
    }
    (wanted[joint] - plant.joints()[joint]) / rate
}

#[test]
fn a_ramp_without_velocity_lags_by_the_ratio_of_the_gains() {
    for (joint, rate, expected_s) in [
        (0, 0.3, 0.050),
        (1, 0.3, 0.041_7),
        (2, 0.05, 0.033_3),
        (3, 1.0, 0.015),
    ] {
        let lag = ramp_lag_s(joint, rate, false);
        assert!(
            (lag - expected_s).abs() < 0.002,
            "joint {joint} lags {lag} s"
        );
    }
}

#[test]
fn a_ramp_with_velocity_does_not_lag() {
    for (joint, rate) in [(0, 0.3), (1, 0.3), (2, 0.05), (3, 1.0), (4, 1.0), (5, 1.0)] {
        let lag = ramp_lag_s(joint, rate, true);
        assert!(lag.abs() < 0.002, "joint {joint} lags {lag} s");
    }
}

#[test]
fn steps_settle_within_the_friction_band_on_every_joint() {
    let steps = JointVector::from([0.02, -0.02, 0.003, 0.1, -0.1, 0.1]);
    let mut plant = plant();
    plant.command(&setpoint(home() + steps, JointVector::zeros()));
    for _ in 0..1500 {
        plant.step(&FREE);
    }
    let band = [5e-4, 7e-4, 9e-5, 1.5e-3, 1.2e-3, 1.5e-3];
    for joint in 0..JOINT_COUNT {
        let error = (plant.joints()[joint] - home()[joint] - steps[joint]).abs();
        assert!(error < band[joint], "joint {joint} rests {error} away");
        assert!(plant.joint_velocities()[joint].abs() < 1e-6);
    }
}

#[test]
fn load_deflects_yaw_by_load_over_gain() {
    let config = PlantConfig {
        coulomb: [0.0; AXIS_COUNT],
        ..shipped()
    };
    let mut plant = Plant::new(&config, &home(), 0.3);
    let mut load = FREE;
    load.efforts[0] = 1.0;
    for _ in 0..2000 {
        plant.step(&load);
    }
    assert!(
        (plant.joints()[0] - 1.0 / 120.0).abs() < 2e-5,
        "{}",
        plant.joints()[0]
    );
}

/// No command drives a motor beyond its current or a joint beyond its effort.
#[test]
fn motors_keep_their_current_and_effort_limits() {
    let mut plant = plant();
    let far = home() + JointVector::from([1.0, -0.9, 0.1, 3.0, 1.0, -1.0]);
    let mut command = setpoint(far, JointVector::from([9.0, -9.0, 1.0, 50.0, 30.0, -30.0]));
    command.jaw_position = -0.6;
    plant.command(&command);
    let mut strongest = 0.0_f64;
    for _ in 0..300 {
        plant.step(&FREE);
        let state = plant.measured(TimeNs(0));
        let joint: AxisVector = core::array::from_fn(|axis| {
            if axis < JOINT_COUNT {
                state.effort[axis]
            } else {
                state.jaw_effort
            }
        });
        for (axis, effort) in actuator_efforts(&joint).iter().enumerate() {
            let drive = &ACTUATORS[axis];
            let limit = drive.current_max_a * drive.torque_constant_n_m_a * drive.gear_ratio;
            assert!(
                effort.abs() <= limit * (1.0 + 1e-12),
                "actuator {axis}: {effort}"
            );
            strongest = strongest.max(effort.abs() / limit);
        }
        assert!(joint[0].abs() <= EFFORT_MAX[0] * (1.0 + 1e-6));
    }
    assert!(strongest > 0.999, "the command was meant to saturate");
}

#[test]
fn encoders_report_whole_counts() {
    let quanta = [7.72e-6, 7.72e-6, 1.296e-6, 134e-6];
    let mut plant = plant();
    let mut wanted = home();
    for tick in 0..200 {
        wanted.add_scalar_mut(if tick % 2 == 0 { 3.3e-4 } else { -1.1e-4 });
        plant.command(&setpoint(wanted, JointVector::zeros()));
        plant.step(&FREE);
        let state = plant.measured(TimeNs(0));
        let joints: AxisVector = core::array::from_fn(|axis| {
            if axis < JOINT_COUNT {
                state.position[axis]
            } else {
                state.jaw_position
            }
        });
        for (axis, actuator) in actuator_positions(&joints).iter().enumerate() {
            let quantum =
                TAU / ACTUATORS[axis].encoder_counts_per_turn / ACTUATORS[axis].gear_ratio;
            assert!((quantum / quanta[axis.min(3)] - 1.0).abs() < 2e-3);
            let counts = actuator / quantum;
            assert!(
                (counts - counts.round()).abs() < 1e-6,
                "actuator {axis}: {counts} counts"
            );
        }
    }
}

#[test]
fn disabled_drives_hold_nothing() {
    let mut plant = plant();
    let mut command = setpoint(home(), JointVector::zeros());
    command.enabled = false;
    plant.command(&command);
    let mut load = FREE;
    load.efforts[0] = 1.0;
    for _ in 0..500 {
        plant.step(&load);
    }
    assert!(plant.joints()[0] > 0.5);
    assert!(plant.measured(TimeNs(0)).effort.norm() < 1e-12);
}

#[test]
fn closed_fingers_stop_each_other() {
    let mut plant = plant();
    let mut command = setpoint(home(), JointVector::zeros());
    command.jaw_position = -0.5;
    plant.command(&command);
    let mut lowest = 0.0_f64;
    for _ in 0..1000 {
        plant.step(&FREE);
        lowest = lowest.min(plant.joints()[JOINT_COUNT]);
    }
    let state = plant.measured(TimeNs(0));
    assert!(lowest > -0.03, "overshoot to {lowest}");
    assert!((state.jaw_effort + shipped().jaw_effort_max_n_m).abs() < 1e-9);
    assert!(plant.joints()[JOINT_COUNT] > -0.003 && state.jaw_velocity.abs() < 1e-6);
}

mod response;
