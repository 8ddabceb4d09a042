//! The sections of the configuration files, each checked against its ranges.
//!
//! A number out of its range is a [`ConfigError`] with file, line, key, value and range. The ranges
//! are what mechanism and controller can do at all; the shipped files are well within them.

use hal::config::{ConfigError, Source, number_text};
use hal::joints::INSERTION;
use hal::psm::{JAW_MAX, JAW_MIN, POSITION_MAX, POSITION_MIN, VELOCITY_MAX};

use super::{FilterConfig, Supervision};
use crate::aggregate::Aggregation;
use crate::gate::GateLimits;
use crate::motion::{AXES, AxisLimits, JAW};
use crate::schema::{AggregationMode, ControlFile, LinearAxis, RotaryAxis};
use crate::stop::AxisStop;

/// The longest that an axis may take to come to rest, s: what waits for a stop counts on it.
const STOP_S_MAX: f64 = 0.4;

/// In joint order, then the jaw. Positions and velocities are bounded by the mechanism's own limits
/// in `hal::psm`.
pub(super) fn axes(source: &Source, file: &ControlFile) -> Result<[AxisLimits; AXES], ConfigError> {
    let limits = &file.limits;
    Ok([
        rotary(source, "yaw", &limits.yaw, 0)?,
        rotary(source, "pitch", &limits.pitch, 1)?,
        linear(source, "insertion", &limits.insertion)?,
        rotary(source, "roll", &limits.roll, 3)?,
        rotary(source, "wrist_pitch", &limits.wrist_pitch, 4)?,
        rotary(source, "wrist_yaw", &limits.wrist_yaw, 5)?,
        rotary(source, "jaw", &limits.jaw, JAW)?,
    ])
}

fn rotary(
    source: &Source,
    name: &str,
    axis: &RotaryAxis,
    index: usize,
) -> Result<AxisLimits, ConfigError> {
    let (low, high) = if index == JAW {
        (JAW_MIN, JAW_MAX)
    } else {
        (POSITION_MIN[index], POSITION_MAX[index])
    };
    let check = |key: &str, value: f64, low: f64, high: f64| {
        source.check_range(&format!("limits.{name}.{key}"), value, low, high)
    };
    check("low_rad", axis.low_rad, low, high)?;
    check("high_rad", axis.high_rad, axis.low_rad, high)?;
    check(
        "velocity_rad_s",
        axis.velocity_rad_s,
        0.01,
        VELOCITY_MAX[index],
    )?;
    check("acceleration_rad_s2", axis.acceleration_rad_s2, 0.1, 200.0)?;
    check("jerk_rad_s3", axis.jerk_rad_s3, 1.0, 20_000.0)?;
    let limits = AxisLimits {
        low: axis.low_rad,
        high: axis.high_rad,
        velocity: axis.velocity_rad_s,
        acceleration: axis.acceleration_rad_s2,
        jerk: axis.jerk_rad_s3,
    };
    check_stop(source, name, &limits)?;
    Ok(limits)
}

fn linear(source: &Source, name: &str, axis: &LinearAxis) -> Result<AxisLimits, ConfigError> {
    let check = |key: &str, value: f64, low: f64, high: f64| {
        source.check_range(&format!("limits.{name}.{key}"), value, low, high)
    };
    // Shallower than 20 mm the wrist comes too near to the remote centre for the inverse
    // kinematics.
    check("low_m", axis.low_m, 0.02, POSITION_MAX[INSERTION])?;
    check("high_m", axis.high_m, axis.low_m, POSITION_MAX[INSERTION])?;
    check(
        "velocity_m_s",
        axis.velocity_m_s,
        0.001,
        VELOCITY_MAX[INSERTION],
    )?;
    check("acceleration_m_s2", axis.acceleration_m_s2, 0.01, 20.0)?;
    check("jerk_m_s3", axis.jerk_m_s3, 0.1, 2_000.0)?;
    let limits = AxisLimits {
        low: axis.low_m,
        high: axis.high_m,
        velocity: axis.velocity_m_s,
        acceleration: axis.acceleration_m_s2,
        jerk: axis.jerk_m_s3,
    };
    check_stop(source, name, &limits)?;
    Ok(limits)
}

/// An axis must be able to come to rest soon: from full speed with its acceleration the wrong way.
fn check_stop(source: &Source, name: &str, limits: &AxisLimits) -> Result<(), ConfigError> {
    let stop = AxisStop::new(0.0, limits.velocity, limits.acceleration, limits);
    if stop.duration_s() <= STOP_S_MAX {
        return Ok(());
    }
    let found = format!("a stop of {} s", number_text(stop.duration_s()));
    let allowed = format!("at most {STOP_S_MAX} s from full speed and acceleration");
    Err(source.out_of_range(&format!("limits.{name}"), &found, &allowed))
}

/// The decay is checked in every mode and used in `ensemble` alone.
pub(super) fn aggregation(source: &Source, file: &ControlFile) -> Result<Aggregation, ConfigError> {
    let decay = file.aggregation.decay;
    source.check_range("aggregation.decay", decay, -1.0, 1.0)?;
    source.check_range("aggregation.stale_s", file.aggregation.stale_s, 0.05, 30.0)?;
    Ok(match file.aggregation.mode {
        AggregationMode::Ensemble => Aggregation::Ensemble { decay },
        AggregationMode::WholeChunk => Aggregation::WholeChunk,
        AggregationMode::Newest => Aggregation::Newest,
    })
}

pub(super) fn gate(source: &Source, file: &ControlFile) -> Result<GateLimits, ConfigError> {
    let gate = &file.gate;
    source.check_range("gate.age_s_max", gate.age_s_max, 0.01, 10.0)?;
    source.check_range("gate.step_m_max", gate.step_m_max, 1e-4, 0.1)?;
    source.check_range("gate.step_rad_max", gate.step_rad_max, 1e-3, 3.2)?;
    source.check_range("gate.jump_m_max", gate.jump_m_max, 1e-3, 0.5)?;
    source.check_range("gate.jump_rad_max", gate.jump_rad_max, 1e-2, 3.2)?;
    source.check_range("gate.resume_m_max", gate.resume_m_max, 1e-4, 0.5)?;
    source.check_range("gate.resume_rad_max", gate.resume_rad_max, 1e-3, 3.2)?;
    Ok(GateLimits {
        age_ns_max: nanoseconds(gate.age_s_max),
        step_m_max: gate.step_m_max,
        step_rad_max: gate.step_rad_max,
        jump_m_max: gate.jump_m_max,
        jump_rad_max: gate.jump_rad_max,
        resume_m_max: gate.resume_m_max,
        resume_rad_max: gate.resume_rad_max,
    })
}

/// Rounded to the nearest; the caller has checked the range.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "checked: positive and an hour at most"
)]
pub(super) fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

pub(super) fn filter(source: &Source, file: &ControlFile) -> Result<FilterConfig, ConfigError> {
    let filter = &file.filter;
    let check = |key: &str, value: f64, low: f64, high: f64| {
        source.check_range(&format!("filter.{key}"), value, low, high)
    };
    check("alpha_1_s", filter.alpha_1_s, 0.5, 50.0)?;
    check("speed_fraction", filter.speed_fraction, 0.1, 1.0)?;
    let window_s = filter.acceleration_window_s;
    check("acceleration_window_s", window_s, 0.005, 1.0)?;
    check("joint_weight", filter.joint_weight, 1e-6, 1.0)?;
    let iterations = f64::from(filter.iterations_max);
    check("iterations_max", iterations, 20.0, 1000.0)?;
    Ok(FilterConfig {
        alpha_1_s: filter.alpha_1_s,
        speed_fraction: filter.speed_fraction,
        acceleration_window_s: filter.acceleration_window_s,
        joint_weight: filter.joint_weight,
        iterations_max: filter.iterations_max,
    })
}

/// `frozen_s` of exactly 0 means no limit; anything else must be 0.1 s to an hour.
pub(super) fn supervision(source: &Source, file: &ControlFile) -> Result<Supervision, ConfigError> {
    let policy = &file.policy;
    source.check_range("policy.restarts", f64::from(policy.restarts), 0.0, 1000.0)?;
    source.check_range("policy.backoff_s", policy.backoff_s, 0.0, 60.0)?;
    source.check_range("policy.return_s", policy.return_s, 0.1, 3600.0)?;
    // Nothing but 0 is no limit.
    let frozen = policy.frozen_s.total_cmp(&0.0).is_ne();
    if frozen {
        source.check_range("policy.frozen_s", policy.frozen_s, 0.1, 3600.0)?;
    }
    Ok(Supervision {
        restarts: policy.restarts,
        backoff_ns: nanoseconds(policy.backoff_s),
        return_ns: nanoseconds(policy.return_s),
        frozen_ns: frozen.then(|| nanoseconds(policy.frozen_s)),
    })
}

pub(super) fn check_fault(source: &Source, file: &ControlFile) -> Result<(), ConfigError> {
    let fault = &file.fault;
    source.check_range("fault.tracking_tip_m", fault.tracking_tip_m, 0.001, 0.05)?;
    source.check_range(
        "fault.tracking_turn_rad",
        fault.tracking_turn_rad,
        0.02,
        1.5,
    )
}
