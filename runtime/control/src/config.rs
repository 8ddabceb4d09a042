//! The controller's configuration: `config/control.toml` and a task's `safety.toml`, parsed once
//! and checked once.

mod lag;
mod scene;
mod sections;

use hal::Pose;
use hal::config::{ConfigError, Source};

use super::aggregate::Aggregation;
use super::gate::GateLimits;
use super::motion::{AXES, AxisLimits};
use super::region::{Block, Region};
use super::schema::ControlFile;
use lag::{FingerSpeeds, check_tick};
use scene::{Scene, check_reach, scene};
use sections::{aggregation, axes, check_fault, filter, gate, nanoseconds, supervision};

/// Most forbidden regions of a task.
pub const FORBIDDEN_MAX: usize = 8;

/// Everything that the controller depends on, in SI units and the RCM frame.
#[derive(Clone, Debug, PartialEq)]
pub struct ControlConfig {
    /// Limits of the joints and the jaw.
    pub axes: [AxisLimits; AXES],
    /// Highest speed of the control point, m/s.
    pub tip_speed_m_s: f64,
    /// Highest turning speed of the tip, rad/s.
    pub tip_angular_speed_rad_s: f64,
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
    /// Time over which the speed limits rise to their full height after the arm was enabled, ns.
    pub soft_start_ns: u64,
    /// The safety filter.
    pub filter: FilterConfig,
    /// Distances to boundaries.
    pub margins: Margins,
    /// Deviation of the measured tip from the commanded one at which the controller faults.
    pub following_error_max: FollowingError,
    /// Whether a run in real time ends with a fault, or its arms hold until the operator clears it.
    /// For whoever calls the controller.
    pub fault_ends_run: bool,
    /// What becomes of a policy process that dies or hangs. The controller knows no processes: it
    /// is for whoever calls it.
    pub supervision: Supervision,
    /// Measured closing effort of the jaw at which it closes no further, N m.
    pub jaw_closing_effort_n_m_max: f64,
    /// The arms, one or two, and where each may be.
    pub arms: Vec<ArmConfig>,
    /// What two arms keep between them; none for one arm.
    pub between_arms: Option<BetweenArms>,
}

/// How a policy process is supervised.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Supervision {
    /// How often one that died or hangs is started again in a run; with 0 the run ends with it.
    pub restarts: u32,
    /// Time before the first restart, ns; it doubles with each next one.
    pub backoff_ns: u64,
    /// How long it may take to be ready again, and an external policy to come back, ns.
    pub return_ns: u64,
    /// For how long a camera of a robot may show the very same pixels, however often it stamps
    /// them, ns; any time if not given.
    pub frozen_ns: Option<u64>,
}

/// The safety filter's numbers.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FilterConfig {
    /// Approach speed per distance to a boundary, 1/s.
    pub alpha_1_s: f64,
    /// The filter's limits on the tip's speed and turning speed over the limits themselves.
    pub speed_fraction: f64,
    /// How far ahead the filter looks with the acceleration limit, s.
    pub acceleration_window_s: f64,
    /// Weight of joint changes against tip changes.
    pub joint_weight: f64,
    /// Iterations after which the QP has failed.
    pub iterations_max: u32,
}

/// How far a measured tip may be from the commanded one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FollowingError {
    /// The control point, m.
    pub tip_m: f64,
    /// The tip's rotation, rad.
    pub turn_rad: f64,
}

/// Distances to boundaries, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Margins {
    /// What the filter keeps from every boundary.
    pub filter_m: f64,
    /// What every verified stop keeps from every boundary.
    pub guard_m: f64,
    /// How much worse a stop of an arm that was enabled beyond a boundary may get.
    pub recovery_m: f64,
}

/// Least gaps between the surfaces of two instruments, m. Two tips may meet: handing over is their
/// work.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BetweenArms {
    /// Between the shafts.
    pub shaft_to_shaft_m: f64,
    /// Between one's wrist and fingers and the other's shaft.
    pub tip_to_shaft_m: f64,
}

/// One arm: where it stands, and where its instrument may be.
#[derive(Clone, Debug, PartialEq)]
pub struct ArmConfig {
    /// Its name in logs and topics.
    pub name: String,
    /// Where its remote centre is.
    pub scene_from_rcm: Pose,
    /// Box that control point and finger tips stay in, RCM frame.
    pub workspace: Block,
    /// Regions that no part may touch, RCM frame, at most [`FORBIDDEN_MAX`].
    pub forbidden: Vec<Region>,
}

impl ControlConfig {
    /// The defaults of the controller that are built into the program.
    #[must_use]
    pub fn default_control() -> Source {
        Source::embedded("config/control.toml", include_str!("../control.toml"))
    }

    /// The boundaries of needle lift that are built into the program.
    #[must_use]
    pub fn needle_lift_safety() -> Source {
        Source::embedded(
            "config/tasks/needle-lift/safety.toml",
            include_str!("../safety.toml"),
        )
    }

    /// Parses and checks both files.
    ///
    /// # Errors
    /// [`ConfigError`] naming file, line, key and allowed range.
    pub fn load(control: &Source, safety: &Source) -> Result<Self, ConfigError> {
        let file: ControlFile = control.parse()?;
        let Scene {
            arms,
            margins,
            between_arms,
            jaw_closing_effort_n_m_max,
        } = scene(safety)?;
        let axes = axes(control, &file)?;
        let speed = file.limits.tip_speed_m_s;
        control.check_range("limits.tip_speed_m_s", speed, 0.001, 0.5)?;
        let turn = file.limits.tip_angular_speed_rad_s;
        control.check_range("limits.tip_angular_speed_rad_s", turn, 0.1, 20.0)?;
        let soft_start_s = file.tracking.soft_start_s;
        control.check_range("tracking.soft_start_s", soft_start_s, 0.0, 10.0)?;
        control.check_range("tracking.gain_1_s", file.tracking.gain_1_s, 0.1, 100.0)?;
        control.check_range(
            "tracking.lookahead_s",
            file.tracking.lookahead_s,
            0.001,
            0.2,
        )?;
        let finger_speeds = FingerSpeeds::new(speed, turn, &axes, &arms);
        check_reach(safety, &arms, &axes)?;
        check_tick(safety, &margins, &finger_speeds)?;
        check_fault(control, &file)?;
        Ok(Self {
            axes,
            tip_speed_m_s: speed,
            tip_angular_speed_rad_s: turn,
            aggregation: aggregation(control, &file)?,
            stale_ns: nanoseconds(file.aggregation.stale_s),
            gate: gate(control, &file)?,
            tracking_gain_1_s: file.tracking.gain_1_s,
            lookahead_ns: nanoseconds(file.tracking.lookahead_s),
            soft_start_ns: nanoseconds(soft_start_s),
            filter: filter(control, &file)?,
            margins,
            following_error_max: FollowingError {
                tip_m: file.fault.tracking_tip_m,
                turn_rad: file.fault.tracking_turn_rad,
            },
            fault_ends_run: file.fault.ends_run,
            supervision: supervision(control, &file)?,
            jaw_closing_effort_n_m_max,
            arms,
            between_arms,
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
        let [arm] = config.arms.as_slice() else {
            panic!("needle lift has one arm");
        };
        let floor_m = arm.workspace.center_m.z - arm.workspace.half_m.z;
        assert!((floor_m + 0.155).abs() < 1e-12);
        assert_eq!(arm.forbidden.len(), 1);
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
        assert!(
            message("jerk_rad_s3 = 80.0", "jerk_rad_s3 = 8.0").contains("limits.yaw = a stop of")
        );
        assert!(message("mode = \"ensemble\"", "mode = \"mean\"").contains("mean"));
    }

    /// A file of before has no such section, and a process is not restarted then.
    #[test]
    fn supervision_may_be_left_out_and_has_ranges() {
        let control = ControlConfig::default_control();
        let (without, _) = control.text().split_once("[policy]").unwrap();
        let safety = ControlConfig::needle_lift_safety();
        let load = |text: &str| ControlConfig::load(&Source::embedded("c.toml", text), &safety);
        let left_out = load(without).unwrap().supervision;
        assert_eq!(left_out, load(control.text()).unwrap().supervision);
        assert_eq!((left_out.restarts, left_out.backoff_ns), (0, 500_000_000));
        let wild = message("\nrestarts = 0", "\nrestarts = 5000");
        assert!(
            wild.contains("policy.restarts = 5000 is outside [0, 1000]"),
            "{wild}"
        );
        assert!(message("backoff_s = 0.5", "backoff_s = -1.0").contains("policy.backoff_s = -1"));
        assert!(message("return_s = 30.0", "return_s = 0.0").contains("policy.return_s = 0"));
        assert_eq!(left_out.frozen_ns, None);
        let frozen =
            |s: &str| message("\nrestarts = 0", &format!("\nrestarts = 0\nfrozen_s = {s}"));
        assert!(frozen("0.001").contains("policy.frozen_s = 0.001 is outside [0.1, 3600]"));
    }

    #[test]
    fn a_small_or_crowded_scene_is_refused() {
        let control = ControlConfig::default_control();
        let safety = ControlConfig::needle_lift_safety();
        let flat = safety.text().replace(
            "_max_m = [0.06, 0.05, 0.09]",
            "_max_m = [0.06, 0.05, -0.01]",
        );
        let error = ControlConfig::load(&control, &Source::embedded("s.toml", &flat))
            .unwrap_err()
            .to_string();
        assert!(error.contains("arm.0.workspace_max_m = -0.01"), "{error}");
        let sphere = "\n[[forbidden]]\nname = \"x\"\nshape = \"sphere\"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.01\n";
        let crowded = format!("{}{}", safety.text(), sphere.repeat(8));
        let error = ControlConfig::load(&control, &Source::embedded("s.toml", &crowded))
            .unwrap_err()
            .to_string();
        assert!(
            error.contains("forbidden = 9 is outside at most 8 regions"),
            "{error}"
        );
    }
}
