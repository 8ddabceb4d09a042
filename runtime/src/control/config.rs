//! The controller's configuration: `config/control.toml` and a task's `safety.toml`, parsed once and checked once.

mod sections;

use hal::JOINT_COUNT;
use hal::config::{ConfigError, Source};
use hal::joints::INSERTION;
use nalgebra::Vector3;

use super::aggregate::Aggregation;
use super::gate::GateLimits;
use super::motion::{AXES, AxisLimits};
use super::schema::ControlFile;
use sections::{aggregation, axes, check_fault, filter, gate, geometry, guard, nanoseconds};

/// Most forbidden regions of a task.
pub const FORBIDDEN_MAX: usize = 4;

/// Everything that the controller hangs on, in SI units and the RCM frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlConfig {
    /// Limits of the joints and the jaw.
    pub axes: [AxisLimits; AXES],
    /// Highest speed of the control point, m/s.
    pub tip_speed_m_s: f64,
    /// How chunks are blended.
    pub aggregation: Aggregation,
    /// Age of the newest chunk's observation at which the arm stops following it, ns.
    pub stale_ns: u64,
    /// What the input gate lets through.
    pub gate: GateLimits,
    /// Velocity per position error, 1/s.
    pub tracking_gain_1_s: f64,
    /// Time over which the target's velocity is taken, ns.
    pub lookahead_ns: u64,
    /// The safety filter.
    pub filter: FilterConfig,
    /// The guard.
    pub guard: GuardConfig,
    /// Position error of each joint at which the controller faults, rad (m).
    pub tracking_error_max: [f64; JOINT_COUNT],
    /// Where the instrument may be.
    pub geometry: Geometry,
}

/// The safety filter's numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilterConfig {
    /// Approach speed per distance to a boundary, 1/s.
    pub alpha_1_s: f64,
    /// Distance that the filter keeps from every boundary, m.
    pub margin_m: f64,
    /// The filter's tip speed limit over the limit itself.
    pub tip_speed_fraction: f64,
    /// How far ahead the filter looks with the acceleration limit, s.
    pub acceleration_window_s: f64,
    /// Weight of joint changes against tip changes.
    pub joint_weight: f64,
    /// Turning speed that weighs as much as the tip speed limit, rad/s.
    pub angular_speed_rad_s: f64,
    /// Iterations after which the QP has failed.
    pub iterations_max: u32,
}

/// The guard's numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GuardConfig {
    /// Distance that every verified stop keeps from every boundary, m.
    pub margin_m: f64,
    /// How much worse an arm that was enabled beyond a boundary may get, m.
    pub recovery_m: f64,
}

/// Where the instrument may be, in the RCM frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Geometry {
    /// Lower corner of the box for the control point and the finger tips, m.
    pub workspace_min_m: Vector3<f64>,
    /// Upper corner of that box, m.
    pub workspace_max_m: Vector3<f64>,
    /// Spheres that the instrument may not touch, at most [`FORBIDDEN_MAX`].
    pub forbidden: Vec<Sphere>,
    /// Where the RCM is in the scene, m; the frames are parallel.
    pub scene_from_rcm_m: Vector3<f64>,
}

/// A sphere in the RCM frame.
#[derive(Clone, Debug, PartialEq)]
pub struct Sphere {
    /// What it stands for.
    pub name: String,
    /// Centre, m.
    pub center_m: Vector3<f64>,
    /// Radius, m.
    pub radius_m: f64,
}

impl ControlConfig {
    /// The defaults of the controller that are built into the program.
    #[must_use]
    pub fn default_control() -> Source {
        Source::embedded(
            "config/control.toml",
            include_str!("../../../config/control.toml"),
        )
    }

    /// The boundaries of needle lift that are built into the program.
    #[must_use]
    pub fn needle_lift_safety() -> Source {
        Source::embedded(
            "config/tasks/needle-lift/safety.toml",
            include_str!("../../../config/tasks/needle-lift/safety.toml"),
        )
    }

    /// Parses and checks both files.
    ///
    /// # Errors
    /// [`ConfigError`] naming file, line, key and allowed range.
    pub fn load(control: &Source, safety: &Source) -> Result<Self, ConfigError> {
        let file: ControlFile = control.parse()?;
        let geometry = geometry(safety)?;
        let axes = axes(control, &file)?;
        let speed = file.limits.tip_speed_m_s;
        control.check_range("limits.tip_speed_m_s", speed, 0.001, 0.5)?;
        control.check_range("tracking.gain_1_s", file.tracking.gain_1_s, 0.1, 100.0)?;
        control.check_range(
            "tracking.lookahead_s",
            file.tracking.lookahead_s,
            0.001,
            0.2,
        )?;
        check_fault(control, &file)?;
        let fault = &file.fault;
        let tracking_error_max = core::array::from_fn(|joint| match joint {
            0 | 1 => fault.tracking_yaw_pitch_rad,
            INSERTION => fault.tracking_insertion_m,
            _ => fault.tracking_wrist_rad,
        });
        Ok(Self {
            axes,
            tip_speed_m_s: speed,
            aggregation: aggregation(control, &file)?,
            stale_ns: nanoseconds(file.aggregation.stale_s),
            gate: gate(control, &file)?,
            tracking_gain_1_s: file.tracking.gain_1_s,
            lookahead_ns: nanoseconds(file.tracking.lookahead_s),
            filter: filter(control, &file)?,
            guard: guard(control, &file)?,
            tracking_error_max,
            geometry,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::ControlConfig;
    use hal::config::Source;

    fn message(from: &str, to: &str) -> String {
        let control = ControlConfig::default_control();
        let changed = control.text().replacen(from, to, 1);
        assert_ne!(changed, control.text());
        let source = Source::embedded("control.toml", &changed);
        ControlConfig::load(&source, &ControlConfig::needle_lift_safety())
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn the_committed_files_load() {
        let config = ControlConfig::load(
            &ControlConfig::default_control(),
            &ControlConfig::needle_lift_safety(),
        )
        .unwrap();
        assert!((config.geometry.workspace_min_m.z + 0.155).abs() < 1e-12);
        assert_eq!(config.geometry.forbidden.len(), 1);
    }

    #[test]
    fn unknown_keys_and_wild_values_are_named_with_line_and_range() {
        assert!(message("gain_1_s", "gian_1_s").contains("gian_1_s"));
        let wild = message("tip_speed_m_s = 0.08", "tip_speed_m_s = 8.0");
        assert_eq!(
            wild,
            "control.toml:6: limits.tip_speed_m_s = 8 is outside [0.001, 0.5]"
        );
        assert!(message("alpha_1_s = 5.0", "alpha_1_s = nan").contains("filter.alpha_1_s = NaN"));
        assert!(
            message("high_rad = 1.5", "high_rad = -2.0")
                .contains("limits.yaw.high_rad = -2 is outside [-1.5, 1.588]")
        );
        assert!(message("mode = \"ensemble\"", "mode = \"mean\"").contains("mean"));
    }

    #[test]
    fn a_small_or_crowded_scene_is_refused() {
        let control = ControlConfig::default_control();
        let safety = ControlConfig::needle_lift_safety();
        let flat = safety
            .text()
            .replace("max_m = [0.06, 0.05, 0.09]", "max_m = [0.06, 0.05, -0.01]");
        let error = ControlConfig::load(&control, &Source::embedded("s.toml", &flat))
            .unwrap_err()
            .to_string();
        assert!(error.contains("workspace.max_m = -0.01"), "{error}");
        let sphere = "\n[[forbidden]]\nname = \"x\"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.01\n";
        let crowded = format!("{}{}", safety.text(), sphere.repeat(4));
        let error = ControlConfig::load(&control, &Source::embedded("s.toml", &crowded))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("forbidden = 5 is outside at most 4 regions"),
            "{error}"
        );
    }
}
