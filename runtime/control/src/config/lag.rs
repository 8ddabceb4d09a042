//! How far arms are behind their commands, and what the margins must leave for it.

use hal::config::{ConfigError, Source, number_text};
use hal::joints::INSERTION;
use hal::psm::{FINGER_M, RCC_M, TOOL_M, WRIST_M};
use hal::{TICK_S, TimeNs};

use super::{ArmConfig, ControlConfig, Margins};
use crate::motion::{AXES, AxisLimits, JAW};
use crate::region::Block;

/// How long a measured arm is behind its setpoints, s: in free motion the simulated drives, with the dVRK's gains and a period each for the
/// setpoint's way there and the measurement's way back, are 0.52 mm behind at 0.141 m/s (five tasks, random policy).
const LAG_S: f64 = 0.004;

/// What of it is the drives' own, s.
const DRIVE_S: f64 = LAG_S - 2.0 * TICK_S;

/// Upper bounds of the speed of a finger tip, m/s.
pub(super) struct FingerSpeeds {
    /// At the limits.
    full_m_s: f64,
    /// What it gains at most during a stop.
    gained_m_s: f64,
}

impl FingerSpeeds {
    pub(super) fn new(
        tip_speed_m_s: f64,
        tip_angular_speed_rad_s: f64,
        axes: &[AxisLimits; AXES],
        arms: &[ArmConfig],
    ) -> Self {
        let [yaw, pitch, insertion, roll, wrist_pitch, wrist_yaw, jaw] =
            axes.each_ref().map(gained);
        // Yaw and pitch turn about axes at right angles, and insertion is at right angles to both.
        let swing = yaw.hypot(pitch);
        let turn = swing + roll + wrist_pitch;
        let tip = (wrist_distance_m(axes, arms) * swing).hypot(insertion) + WRIST_M * turn;
        // Stops keep the limits of the tip's speeds as well.
        let angular = (turn + wrist_yaw).min(tip_angular_speed_rad_s);
        Self {
            full_m_s: tip_speed_m_s
                + FINGER_M * (tip_angular_speed_rad_s + axes[JAW].velocity / 2.0),
            gained_m_s: tip.min(tip_speed_m_s) + FINGER_M * (angular + jaw / 2.0),
        }
    }
}

/// The speed that an axis gains during a stop until its acceleration has ended, rad/s (m/s).
fn gained(axis: &AxisLimits) -> f64 {
    axis.velocity
        .min(axis.acceleration * axis.acceleration / (2.0 * axis.jerk))
}

/// The greatest distance from the remote centre to the wrist, m: by the insertion's range, and by the workspace, in which the control point
/// stays. The wrist is bent by less than a right angle, so it is nearer than the control point.
fn wrist_distance_m(axes: &[AxisLimits; AXES], arms: &[ArmConfig]) -> f64 {
    let deepest_m = axes[INSERTION].high - RCC_M + TOOL_M;
    let corners = arms.iter().map(|arm| furthest_corner_m(&arm.workspace));
    deepest_m.min(corners.fold(0.0, f64::max))
}

/// From the frame's origin, m.
fn furthest_corner_m(workspace: &Block) -> f64 {
    let local_m = workspace.axes.inverse() * workspace.center_m;
    (local_m.abs() + workspace.half_m).norm()
}

/// The guard judges setpoints, and keeps how far the measured arm is off beyond its margin; what filter and tracking plan must leave that
/// free, or the guard would refuse it. What an instrument does between two of them must be within its margin, and by how much further than
/// it is measured to be the arm falls behind during a stop: with a jerk limit it is faster than at the stop's begin before it is slower.
///
/// No point of the instrument is further than half a tick's way from where it is at the nearer of two setpoints.
pub(super) fn check_tick(
    safety: &Source,
    margins: &Margins,
    speeds: &FingerSpeeds,
) -> Result<(), ConfigError> {
    let half_way_m = speeds.full_m_s * TICK_S / 2.0;
    safety.check_range("margins.guard_m", margins.guard_m, half_way_m, 0.02)?;
    let gained_m = speeds.gained_m_s * LAG_S;
    if margins.guard_m < half_way_m + gained_m {
        let allowed = format!(
            "at least {}: the {:.2} mm that a finger goes in half a tick and the {:.2} mm by which it falls further behind its setpoints \
             during a stop, in which an axis gains up to acceleration^2 / (2 jerk) of limits.yaw to limits.jaw",
            least_text(half_way_m + gained_m),
            1e3 * half_way_m,
            1e3 * gained_m
        );
        let found = number_text(margins.guard_m);
        return Err(safety.out_of_range("margins.guard_m", &found, &allowed));
    }
    let lag_m = speeds.full_m_s * LAG_S;
    if margins.filter_m >= margins.guard_m + lag_m {
        return Ok(());
    }
    let allowed = format!(
        "at least {}: the guard's {} and the {:.2} mm that a finger is behind its setpoints at full speed",
        least_text(margins.guard_m + lag_m),
        number_text(margins.guard_m),
        1e3 * lag_m
    );
    let found = number_text(margins.filter_m);
    Err(safety.out_of_range("margins.filter_m", &found, &allowed))
}

/// A margin that is enough, in hundredths of a millimetre.
fn least_text(margin_m: f64) -> String {
    format!("{:.5}", (margin_m * 1e5).ceil() / 1e5)
}

impl ControlConfig {
    /// What a person should know before arms are enabled whose setpoints take effect at a SYNC every `cycle_ns`: a line for each margin that
    /// is smaller than their lag, none if the margins hold it.
    ///
    /// A drive goes to a setpoint within the cycle after the SYNC, which is a cycle of lag. What it then measures is read from the next SYNC on,
    /// up to the last period before the one after: measured arms are up to three cycles behind, less a period. To both comes the drive's
    /// own lag, for which the simulated drives' stands.
    #[must_use]
    pub fn lag_beyond_margins(&self, cycle_ns: u64) -> Vec<String> {
        let cycle_s = TimeNs(cycle_ns).seconds();
        let measured_s = DRIVE_S + 3.0 * cycle_s - TICK_S;
        let arm_s = (DRIVE_S + cycle_s).max(LAG_S);
        let speeds = FingerSpeeds::new(
            self.tip_speed_m_s,
            self.tip_angular_speed_rad_s,
            &self.axes,
            &self.arms,
        );
        let Margins {
            filter_m, guard_m, ..
        } = self.margins;
        let free_m = guard_m - speeds.full_m_s * TICK_S / 2.0;
        let between_m = filter_m - guard_m;
        let (lag_m, gained_m) = (speeds.full_m_s * measured_s, speeds.gained_m_s * arm_s);
        let mut lines = Vec::new();
        if lag_m > between_m {
            lines.push(format!(
                "arms with a SYNC every {:.1} ms are measured up to {:.1} ms behind their commands, {:.2} mm at full speed, and margins.filter_m = \
                 {} leaves {:.2} mm beyond margins.guard_m: slower limits, a shorter cycle, or at least {} hold it",
                1e3 * cycle_s,
                1e3 * measured_s,
                1e3 * lag_m,
                number_text(filter_m),
                1e3 * between_m,
                least_text(guard_m + lag_m)
            ));
        }
        if gained_m > free_m {
            lines.push(format!(
                "arms with a SYNC every {:.1} ms fall further behind by up to {:.2} mm during a stop, and margins.guard_m = {} leaves {:.2} mm: \
                 they may overstep a boundary by {:.2} mm; lower accelerations, a shorter cycle, or at least {} hold it",
                1e3 * cycle_s,
                1e3 * gained_m,
                number_text(guard_m),
                1e3 * free_m,
                1e3 * (gained_m - free_m),
                least_text(guard_m - free_m + gained_m)
            ));
        }
        lines
    }
}

#[cfg(test)]
mod tests {
    use crate::config::ControlConfig;
    use hal::config::Source;

    /// The shipped limits with `control` replaced, in needle lift's scene with `safety` replaced.
    fn loaded(control: &[(&str, &str)], safety: &[(&str, &str)]) -> Result<ControlConfig, String> {
        let changed = |source: &Source, changes: &[(&str, &str)]| {
            let mut text = source.text().to_owned();
            for (from, to) in changes {
                assert!(text.contains(from), "{from}");
                text = text.replace(from, to);
            }
            text
        };
        let control = changed(&ControlConfig::default_control(), control);
        let safety = changed(&ControlConfig::needle_lift_safety(), safety);
        ControlConfig::load(
            &Source::embedded("control.toml", &control),
            &Source::embedded("safety.toml", &safety),
        )
        .map_err(|error| error.to_string())
    }

    fn said(control: &[(&str, &str)], safety: &[(&str, &str)]) -> String {
        loaded(control, safety).map_or_else(|error| error, |_| "loaded".to_owned())
    }

    /// Yaw and pitch gain all of their speed during a stop.
    const RAISED: [(&str, &str); 1] = [(
        "acceleration_rad_s2 = 4.0\njerk_rad_s3 = 80.0",
        "acceleration_rad_s2 = 14.0\njerk_rad_s3 = 150.0",
    )];

    #[test]
    fn a_margin_within_which_a_tick_leads_is_refused() {
        let fast = [("tip_speed_m_s = 0.08", "tip_speed_m_s = 0.5")];
        let thin = said(&fast, &[("guard_m = 0.0003", "guard_m = 0.0001")]);
        assert!(
            thin.contains("margins.guard_m = 0.0001 is outside [0.00028"),
            "{thin}"
        );
        let wide = [
            ("guard_m = 0.0003", "guard_m = 0.0005"),
            ("filter_m = 0.0015", "filter_m = 0.0028"),
        ];
        assert_eq!(said(&fast, &wide), "loaded");
    }

    #[test]
    fn limits_at_which_an_arm_lags_beyond_its_margin_are_refused() {
        let judged = |speed: &str, filter_m: &str| {
            said(
                &[("tip_speed_m_s = 0.08", speed)],
                &[
                    ("filter_m = 0.0015", filter_m),
                    ("guard_m = 0.0003", "guard_m = 0.0005"),
                ],
            )
        };
        let raised = "tip_speed_m_s = 0.45";
        let text = judged(raised, "filter_m = 0.0015");
        assert!(
            text.contains("margins.filter_m = 0.0015 is outside at least 0.00255")
                && text.contains("2.04 mm that a finger is behind"),
            "{text}"
        );
        assert_eq!(judged(raised, "filter_m = 0.00255"), "loaded");
        let thin = judged("tip_speed_m_s = 0.08", "filter_m = 0.0009");
        assert!(
            thin.contains("margins.filter_m = 0.0009 is outside at least"),
            "{thin}"
        );
    }

    /// The margin that the message asks for is accepted, and what is just below it is not.
    #[test]
    fn limits_at_which_a_stop_lags_beyond_its_margin_are_refused() {
        let guard = |to: &'static str| said(&RAISED, &[("guard_m = 0.0003", to)]);
        let text = guard("guard_m = 0.0003");
        assert!(
            text.contains("margins.guard_m = 0.0003 is outside at least 0.00048")
                && text.contains("0.07 mm that a finger goes in half a tick")
                && text.contains("0.41 mm by which it falls further behind")
                && text.contains("limits.yaw to limits.jaw"),
            "{text}"
        );
        assert_eq!(guard("guard_m = 0.00048"), "loaded");
        assert!(guard("guard_m = 0.00047").contains("margins.guard_m"));
        // At the shipped limits a tenth of a millimetre is not enough, and what is shipped is.
        let shipped = said(&[], &[("guard_m = 0.0003", "guard_m = 0.0001")]);
        assert!(
            shipped.contains("margins.guard_m = 0.0001 is outside at least 0.00029"),
            "{shipped}"
        );
    }

    /// At 1 kHz, as the simulated drives, and at 500 Hz the shipped margins hold the lag; at 250 Hz neither of them does.
    #[test]
    fn margins_smaller_than_the_lag_on_can_are_named() {
        let config = loaded(&[], &[]).unwrap();
        for cycle_ns in [1_000_000, 2_000_000] {
            assert_eq!(config.lag_beyond_margins(cycle_ns), Vec::<String>::new());
        }
        let slow = config.lag_beyond_margins(4_000_000);
        let [filter, guard] = slow.as_slice() else {
            panic!("{slow:?}");
        };
        assert!(
            filter.contains("SYNC every 4.0 ms are measured up to 13.0 ms behind")
                && filter.contains("1.84 mm at full speed")
                && filter.contains("margins.filter_m = 0.0015 leaves 1.20 mm")
                && filter.ends_with("at least 0.00214 hold it"),
            "{filter}"
        );
        assert!(
            guard.contains("up to 0.32 mm during a stop")
                && guard.contains("margins.guard_m = 0.0003 leaves 0.23 mm")
                && guard.contains("overstep a boundary by 0.09 mm")
                && guard.ends_with("at least 0.00039 hold it"),
            "{guard}"
        );
        // What the lines ask for silences them: the filter's margin goes with the guard's.
        let wide = loaded(
            &[],
            &[
                ("guard_m = 0.0003", "guard_m = 0.00039"),
                ("filter_m = 0.0015", "filter_m = 0.00223"),
            ],
        );
        assert_eq!(
            wide.unwrap().lag_beyond_margins(4_000_000),
            Vec::<String>::new()
        );
    }
}
