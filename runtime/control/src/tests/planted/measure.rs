//! Rates by differences of places, and what an axis needs to stop by the textbook.

use super::super::adversary::eyes::Boundary;
use crate::config::ControlConfig;
use crate::motion::{AXES, Axes};
use crate::rows::Velocities;
use trocar_verify::tip_in_rcm;

/// Time over which rates are measured, s.
const STEP_S: f64 = 1e-5;

/// What a measured rate may be off, m/s.
pub(super) const RATE_TOLERANCE_M_S: f64 = 5e-5;

/// How the clearance changes per velocity of each axis.
pub(super) fn slope(config: &ControlConfig, boundary: Boundary, positions: &[Axes]) -> Velocities {
    core::array::from_fn(|variable| {
        let mut velocity = [0.0; 2 * AXES];
        velocity[variable] = 1.0;
        if variable < AXES * positions.len() {
            rate(config, boundary, positions, &velocity)
        } else {
            0.0
        }
    })
}

/// How fast the clearance grows when the arms move with `velocity`.
pub(super) fn rate(
    config: &ControlConfig,
    boundary: Boundary,
    positions: &[Axes],
    velocity: &Velocities,
) -> f64 {
    let before = boundary.clearance(config, &moved(positions, velocity, -STEP_S));
    let after = boundary.clearance(config, &moved(positions, velocity, STEP_S));
    (after - before) / (2.0 * STEP_S)
}

fn moved(positions: &[Axes], velocity: &Velocities, time_s: f64) -> Vec<Axes> {
    let mut moved = positions.to_vec();
    for (arm, position) in moved.iter_mut().enumerate() {
        for (axis, value) in position.iter_mut().enumerate() {
            *value += velocity[AXES * arm + axis] * time_s;
        }
    }
    moved
}

/// Speed and turning speed of the tip of `arm`, each as a share of its limit.
pub(super) fn tip_shares(
    config: &ControlConfig,
    positions: &[Axes],
    velocity: &Velocities,
    arm: usize,
) -> (f64, f64) {
    let tip = |time_s: f64| {
        let position = moved(positions, velocity, time_s)[arm];
        tip_in_rcm(&hal::JointVector::from_fn(|joint, _| position[joint]))
    };
    let (before, after) = (tip(-STEP_S), tip(STEP_S));
    let way_m = (after.translation.vector - before.translation.vector).norm();
    let turn_rad = before.rotation.angle_to(&after.rotation);
    (
        way_m / (2.0 * STEP_S) / config.tip_speed_m_s,
        turn_rad / (2.0 * STEP_S) / config.tip_angular_speed_rad_s,
    )
}

/// What an axis needs to stop from `speed`, by the textbook.
pub(super) fn stop_distance(speed: f64, acceleration: f64, jerk: f64) -> f64 {
    if speed >= acceleration * acceleration / jerk {
        speed * speed / (2.0 * acceleration) + speed * acceleration / (2.0 * jerk)
    } else {
        speed.powf(1.5) / jerk.sqrt()
    }
}
