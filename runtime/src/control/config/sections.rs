//! The sections of the configuration files, each checked against its ranges.

use hal::config::{ConfigError, Source};
use hal::joints::INSERTION;
use hal::psm::{JAW_MAX, JAW_MIN, POSITION_MAX, POSITION_MIN, VELOCITY_MAX};
use nalgebra::Vector3;

use super::{FORBIDDEN_MAX, FilterConfig, Geometry, GuardConfig, Sphere};
use crate::control::aggregate::Aggregation;
use crate::control::gate::GateLimits;
use crate::control::motion::{AXES, AxisLimits, JAW};
use crate::control::schema::{AggregationMode, ControlFile, LinearAxis, RotaryAxis, SafetyFile};

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
    Ok(AxisLimits {
        low: axis.low_rad,
        high: axis.high_rad,
        velocity: axis.velocity_rad_s,
        acceleration: axis.acceleration_rad_s2,
        jerk: axis.jerk_rad_s3,
    })
}

fn linear(source: &Source, name: &str, axis: &LinearAxis) -> Result<AxisLimits, ConfigError> {
    let check = |key: &str, value: f64, low: f64, high: f64| {
        source.check_range(&format!("limits.{name}.{key}"), value, low, high)
    };
    // Shallower than 20 mm the wrist comes too near to the remote centre for the inverse kinematics.
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
    Ok(AxisLimits {
        low: axis.low_m,
        high: axis.high_m,
        velocity: axis.velocity_m_s,
        acceleration: axis.acceleration_m_s2,
        jerk: axis.jerk_m_s3,
    })
}

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
    Ok(GateLimits {
        age_ns_max: nanoseconds(gate.age_s_max),
        step_m_max: gate.step_m_max,
        step_rad_max: gate.step_rad_max,
        jump_m_max: gate.jump_m_max,
        jump_rad_max: gate.jump_rad_max,
    })
}

#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "checked: positive and below a minute"
)]
pub(super) fn nanoseconds(seconds: f64) -> u64 {
    (seconds * 1e9).round() as u64
}

pub(super) fn filter(source: &Source, file: &ControlFile) -> Result<FilterConfig, ConfigError> {
    let filter = &file.filter;
    source.check_range("filter.alpha_1_s", filter.alpha_1_s, 0.5, 50.0)?;
    source.check_range(
        "filter.margin_m",
        filter.margin_m,
        file.guard.margin_m,
        0.02,
    )?;
    source.check_range(
        "filter.tip_speed_fraction",
        filter.tip_speed_fraction,
        0.1,
        1.0,
    )?;
    source.check_range(
        "filter.acceleration_window_s",
        filter.acceleration_window_s,
        0.005,
        1.0,
    )?;
    source.check_range("filter.joint_weight", filter.joint_weight, 1e-6, 1.0)?;
    source.check_range(
        "filter.angular_speed_rad_s",
        filter.angular_speed_rad_s,
        0.1,
        20.0,
    )?;
    source.check_range(
        "filter.iterations_max",
        f64::from(filter.iterations_max),
        5.0,
        100.0,
    )?;
    Ok(FilterConfig {
        alpha_1_s: filter.alpha_1_s,
        margin_m: filter.margin_m,
        tip_speed_fraction: filter.tip_speed_fraction,
        acceleration_window_s: filter.acceleration_window_s,
        joint_weight: filter.joint_weight,
        angular_speed_rad_s: filter.angular_speed_rad_s,
        iterations_max: filter.iterations_max,
    })
}

pub(super) fn guard(source: &Source, file: &ControlFile) -> Result<GuardConfig, ConfigError> {
    source.check_range("guard.margin_m", file.guard.margin_m, 1e-4, 0.02)?;
    source.check_range("guard.recovery_m", file.guard.recovery_m, 1e-4, 0.02)?;
    Ok(GuardConfig {
        margin_m: file.guard.margin_m,
        recovery_m: file.guard.recovery_m,
    })
}

pub(super) fn check_fault(source: &Source, file: &ControlFile) -> Result<(), ConfigError> {
    source.check_range(
        "fault.tracking_yaw_pitch_rad",
        file.fault.tracking_yaw_pitch_rad,
        0.005,
        0.5,
    )?;
    source.check_range(
        "fault.tracking_insertion_m",
        file.fault.tracking_insertion_m,
        0.001,
        0.05,
    )?;
    source.check_range(
        "fault.tracking_wrist_rad",
        file.fault.tracking_wrist_rad,
        0.02,
        1.5,
    )
}

pub(super) fn geometry(source: &Source) -> Result<Geometry, ConfigError> {
    let file: SafetyFile = source.parse()?;
    let origin = file.scene_from_rcm.translation_m;
    let (low, high) = (file.workspace.min_m, file.workspace.max_m);
    for axis in 0..3 {
        source.check_range("scene_from_rcm.translation_m", origin[axis], -1.0, 1.0)?;
        source.check_range("workspace.min_m", low[axis], -1.0, 1.0)?;
        source.check_range("workspace.max_m", high[axis], low[axis] + 0.01, 1.0)?;
    }
    if file.forbidden.len() > FORBIDDEN_MAX {
        let count = file.forbidden.len().to_string();
        return Err(source.out_of_range(
            "forbidden",
            &count,
            &format!("at most {FORBIDDEN_MAX} regions"),
        ));
    }
    let rcm_in_scene_m = Vector3::from(origin);
    let mut forbidden = Vec::with_capacity(file.forbidden.len());
    for (index, sphere) in file.forbidden.into_iter().enumerate() {
        source.check_range(
            &format!("forbidden.{index}.radius_m"),
            sphere.radius_m,
            0.001,
            0.2,
        )?;
        for value in sphere.center_m {
            source.check_range(&format!("forbidden.{index}.center_m"), value, -1.0, 1.0)?;
        }
        let center_m = Vector3::from(sphere.center_m) - rcm_in_scene_m;
        forbidden.push(Sphere {
            name: sphere.name,
            center_m,
            radius_m: sphere.radius_m,
        });
    }
    Ok(Geometry {
        workspace_min_m: Vector3::from(low) - rcm_in_scene_m,
        workspace_max_m: Vector3::from(high) - rcm_in_scene_m,
        forbidden,
        scene_from_rcm_m: rcm_in_scene_m,
    })
}
