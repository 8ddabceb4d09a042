//! How far arms are behind their commands, and what the margins must leave for it.
//!
//! A lag in time becomes one in space by a speed: with `v` the bound of a finger tip's speed, `g`
//! what it gains during a stop, `T` the tick and `L` the time by which a measured arm is behind its
//! commands, the guard's margin must be at least `v T / 2 + g L` and the filter's `v L` more than
//! the guard's. A scene that has less is refused when it is loaded.

use hal::config::{ConfigError, Source, number_text};
use hal::joints::INSERTION;
use hal::psm::{FINGER_M, RCC_M, TOOL_M, WRIST_M};
use hal::{TICK_S, TimeNs};

use super::{ArmConfig, ControlConfig, Margins};
use crate::motion::{AXES, AxisLimits, JAW};
use crate::region::Block;

/// How long a measured arm is behind its setpoints, s: in free motion the simulated drives, with
/// the dVRK's gains and a period each for the setpoint's way there and the measurement's way back,
/// are 0.52 mm behind at 0.141 m/s (five tasks, random policy).
const LAG_S: f64 = 0.004;

/// What of it is the drives' own, s.
const DRIVE_S: f64 = LAG_S - 2.0 * TICK_S;

/// The largest margin, m.
const MARGIN_M_MAX: f64 = 0.02;

/// Upper bounds of the speed of a finger tip, m/s.
pub(super) struct FingerSpeeds {
    /// At the limits.
    full_m_s: f64,
    /// What it gains at most during a stop.
    gained_m_s: f64,
    /// The wrist's distance from the remote centre for which that is, m.
    wrist_m: f64,
}

impl FingerSpeeds {
    /// `full = v_tip + FINGER (w_tip + v_jaw / 2)`. What is gained adds up the axes' gains with the
    /// levers of a chain that is stretched to `wrist_m`, and is capped at the tip's own limits.
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
        // The shaft, about which it rolls, and the wrist's pitch axis are at right angles too.
        let turn = swing + roll.hypot(wrist_pitch);
        let wrist_m = wrist_distance_m(axes, arms);
        let tip = (wrist_m * swing).hypot(insertion) + WRIST_M * turn;
        // Stops keep the limits of the tip's speeds as well.
        let angular = (turn + wrist_yaw).min(tip_angular_speed_rad_s);
        Self {
            full_m_s: tip_speed_m_s
                + FINGER_M * (tip_angular_speed_rad_s + axes[JAW].velocity / 2.0),
            gained_m_s: tip.min(tip_speed_m_s) + FINGER_M * (angular + jaw / 2.0),
            wrist_m,
        }
    }
}

/// The speed that an axis gains during a stop until its acceleration has ended, rad/s (m/s).
///
/// With full acceleration at the beginning of the stop the jerk needs `a / j` to end it, in which
/// the speed grows by `a^2 / (2 j)`; never by more than its limit.
fn gained(axis: &AxisLimits) -> f64 {
    axis.velocity
        .min(axis.acceleration * axis.acceleration / (2.0 * axis.jerk))
}

/// The greatest distance from the remote centre to the wrist, m: by the insertion's range, and by
/// the workspace, in which the control point stays. The wrist is bent by less than a right angle,
/// so it is nearer than the control point. At the shipped limits the insertion's range alone keeps
/// the gain so low that the shipped margins hold it in every workspace.
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

/// The guard judges setpoints, and keeps how far the measured arm is off beyond its margin; what
/// filter and tracking plan must leave that free, or the guard would refuse it. What an instrument
/// does between two of them must be within its margin, and by how much further than it is measured
/// to be the arm falls behind during a stop: with a jerk limit it is faster than at the stop's
/// begin before it is slower.
///
/// No point of the instrument is further than half a tick's way from where it is at the nearer of
/// two setpoints.
pub(super) fn check_tick(
    safety: &Source,
    margins: &Margins,
    speeds: &FingerSpeeds,
) -> Result<(), ConfigError> {
    let half_way_m = speeds.full_m_s * TICK_S / 2.0;
    safety.check_range("margins.guard_m", margins.guard_m, half_way_m, MARGIN_M_MAX)?;
    let gained_m = speeds.gained_m_s * LAG_S;
    if margins.guard_m < half_way_m + gained_m {
        let allowed = format!(
            "[{}, {}]: it must be at least the {:.3} mm that a finger goes in half a tick and the {:.3} mm by which it falls further behind its \
             setpoints during a stop, with the wrist up to {:.3} m from the remote centre (workspace, limits.insertion.high_m) and each axis \
             gaining up to acceleration^2 / (2 jerk) of limits.yaw to limits.jaw",
            least_text(half_way_m + gained_m),
            number_text(MARGIN_M_MAX),
            1e3 * half_way_m,
            1e3 * gained_m,
            speeds.wrist_m
        );
        let found = number_text(margins.guard_m);
        return Err(safety.out_of_range("margins.guard_m", &found, &allowed));
    }
    let lag_m = speeds.full_m_s * LAG_S;
    if margins.filter_m >= margins.guard_m + lag_m {
        return Ok(());
    }
    let allowed = format!(
        "[{}, {}]: it must be at least the guard's {} and the {:.3} mm that a finger is behind its setpoints at full speed",
        least_text(margins.guard_m + lag_m),
        number_text(MARGIN_M_MAX),
        number_text(margins.guard_m),
        1e3 * lag_m
    );
    let found = number_text(margins.filter_m);
    Err(safety.out_of_range("margins.filter_m", &found, &allowed))
}

/// A margin that is enough, m: whole hundredths of a millimetre.
fn least_m(margin_m: f64) -> f64 {
    (margin_m * 1e5).ceil() / 1e5
}

fn least_text(margin_m: f64) -> String {
    format!("{:.5}", least_m(margin_m))
}

impl ControlConfig {
    /// What a person should know before arms are enabled whose setpoints take effect at a SYNC
    /// every `cycle_ns`: a line for each margin that is smaller than their lag, none if the margins
    /// hold it. The guard's comes first: the filter's is for the guard margin which that asks for.
    ///
    /// A drive goes to a setpoint within the cycle after the SYNC, which is a cycle of lag. What it
    /// then measures is read from the next SYNC on, up to the last period before the one after:
    /// measured arms are up to three cycles behind, less a period. To both comes the drive's own
    /// lag, for which the simulated drives' stands.
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
        let half_way_m = speeds.full_m_s * TICK_S / 2.0;
        let free_m = guard_m - half_way_m;
        let (lag_m, gained_m) = (speeds.full_m_s * measured_s, speeds.gained_m_s * arm_s);
        let mut lines = Vec::new();
        let mut guard_least_m = guard_m;
        if gained_m > free_m {
            guard_least_m = least_m(half_way_m + gained_m);
            lines.push(format!(
                "arms with a SYNC every {:.1} ms fall further behind by up to {:.3} mm during a stop, and margins.guard_m = {} leaves {:.3} mm: \
                 they may overstep a boundary by {:.3} mm; lower accelerations, a shorter cycle, or margins.guard_m >= {} hold it",
                1e3 * cycle_s,
                1e3 * gained_m,
                number_text(guard_m),
                1e3 * free_m,
                1e3 * (gained_m - free_m),
                number_text(guard_least_m)
            ));
        }
        let between_m = filter_m - guard_least_m;
        if lag_m > between_m {
            lines.push(format!(
                "arms with a SYNC every {:.1} ms are measured up to {:.1} ms behind their commands, {:.3} mm at full speed, and margins.filter_m = \
                 {} leaves {:.3} mm beyond a margins.guard_m of {}: slower limits, a shorter cycle, or margins.filter_m >= {} hold it",
                1e3 * cycle_s,
                1e3 * measured_s,
                1e3 * lag_m,
                number_text(filter_m),
                1e3 * between_m,
                number_text(guard_least_m),
                least_text(guard_least_m + lag_m)
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
            text.contains(
                "margins.filter_m = 0.0015 is outside [0.00255, 0.02]: it must be at least"
            ) && text.contains("2.045 mm that a finger is behind"),
            "{text}"
        );
        assert_eq!(judged(raised, "filter_m = 0.00255"), "loaded");
        let thin = judged("tip_speed_m_s = 0.08", "filter_m = 0.0009");
        assert!(
            thin.contains("margins.filter_m = 0.0009 is outside [0.00107, 0.02]"),
            "{thin}"
        );
    }

    /// The margin that the message asks for is accepted, and what is just below it is not.
    #[test]
    fn limits_at_which_a_stop_lags_beyond_its_margin_are_refused() {
        let guard = |to: &'static str| said(&RAISED, &[("guard_m = 0.0003", to)]);
        let text = guard("guard_m = 0.0003");
        assert!(
            text.contains("margins.guard_m = 0.0003 is outside [0.00048, 0.02]: it must be at least")
                && text.contains("0.071 mm that a finger goes in half a tick")
                && text.contains("0.399 mm by which it falls further behind")
                && text.contains("the wrist up to 0.174 m from the remote centre (workspace, limits.insertion.high_m)")
                && text.contains("limits.yaw to limits.jaw"),
            "{text}"
        );
        assert_eq!(guard("guard_m = 0.00048"), "loaded");
        assert!(guard("guard_m = 0.00047").contains("margins.guard_m"));
        // At the shipped limits a tenth of a millimetre is not enough, and what is shipped is.
        let shipped = said(&[], &[("guard_m = 0.0003", "guard_m = 0.0001")]);
        assert!(
            shipped.contains("margins.guard_m = 0.0001 is outside [0.00027, 0.02]"),
            "{shipped}"
        );
    }

    /// The insertion's range bounds how far away the wrist is, however large the workspace; one
    /// that can't be reached is said to be that.
    #[test]
    fn the_shipped_margins_hold_in_every_workspace_that_is_reached() {
        let judged = |low: &str, high: &str, guard: &str| {
            let low = format!("workspace_min_m = {low}");
            let high = format!("workspace_max_m = {high}");
            let changes = [
                ("workspace_min_m = [-0.06, -0.05, -0.005]", low.as_str()),
                ("workspace_max_m = [0.06, 0.05, 0.09]", high.as_str()),
                ("guard_m = 0.0003", guard),
            ];
            said(&[], &changes)
        };
        let (low, high) = ("[-0.3, -0.3, -0.2]", "[0.3, 0.3, 0.12]");
        assert_eq!(judged(low, high, "guard_m = 0.0003"), "loaded");
        let thin = judged(low, high, "guard_m = 0.00028");
        assert!(
            thin.contains("margins.guard_m = 0.00028 is outside [0.00029, 0.02]")
                && thin.contains("0.219 mm by which it falls further behind")
                && thin.contains("the wrist up to 0.219 m from the remote centre"),
            "{thin}"
        );
        let far = judged(
            "[-0.06, -0.05, -0.3]",
            "[0.06, 0.05, -0.25]",
            "guard_m = 0.0001",
        );
        assert!(
            far.contains("arm.0.workspace_max_m") && far.contains("can't reach"),
            "{far}"
        );
    }

    /// At 1 kHz, as the simulated drives, and at 500 Hz the shipped margins hold the lag; at 250 Hz
    /// neither of them does.
    #[test]
    fn margins_smaller_than_the_lag_on_can_are_named() {
        let config = loaded(&[], &[]).unwrap();
        for cycle_ns in [1_000_000, 2_000_000] {
            assert_eq!(config.lag_beyond_margins(cycle_ns), Vec::<String>::new());
        }
        let slow = config.lag_beyond_margins(4_000_000);
        let [guard, filter] = slow.as_slice() else {
            panic!("{slow:?}");
        };
        assert!(
            guard.contains("up to 0.297 mm during a stop")
                && guard.contains("margins.guard_m = 0.0003 leaves 0.229 mm")
                && guard.contains("overstep a boundary by 0.067 mm")
                && guard.ends_with("margins.guard_m >= 0.00037 hold it"),
            "{guard}"
        );
        assert!(
            filter.contains("SYNC every 4.0 ms are measured up to 13.0 ms behind")
                && filter.contains("1.836 mm at full speed")
                && filter.contains("margins.filter_m = 0.0015 leaves 1.130 mm")
                && filter.contains("beyond a margins.guard_m of 0.00037")
                && filter.ends_with("margins.filter_m >= 0.00221 hold it"),
            "{filter}"
        );
        // What the lines ask for silences them; the guard's alone does not, and neither does the
        // filter's.
        let with = |guard: &str, filter: &str| {
            let changes = [("guard_m = 0.0003", guard), ("filter_m = 0.0015", filter)];
            let changed = loaded(&[], &changes).unwrap();
            changed.lag_beyond_margins(4_000_000)
        };
        let (guard, filter) = ("guard_m = 0.00037", "filter_m = 0.00221");
        assert_eq!(with(guard, filter), Vec::<String>::new());
        assert_eq!(with(guard, "filter_m = 0.0022").len(), 1);
        assert_eq!(with("guard_m = 0.0003", filter).len(), 1);
    }
}
