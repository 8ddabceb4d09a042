//! Decides whether the needle has been lifted, and catches what would only look like it.

use hal::config::{ConfigError, Source};
use nalgebra::Point3;
use serde::Deserialize;
use trocar_world::needle::NeedleShape;
use trocar_world::organ::Organ;

use crate::task::judge::{DwellTimer, Limits, PressLimit, Safeguard, clearance_m, is_off};
use crate::task::{Criteria, Monitor, MonitorInput, Outcome};

/// What counts as a lifted needle, and what ends the episode at once.
///
/// Success: for `hold_s` without a break both fingers press on the needle with `grip_force_n_min`
/// each, the middle of its arc is `lift_height_m` above the organ, and its whole wire `clearance_m`
/// free of it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SuccessConfig {
    /// Height of the middle of the needle's arc above the organ, m.
    pub lift_height_m: f64,
    /// How long the needle must be held up without a break, s.
    pub hold_s: f64,
    /// Force that each finger must put on the needle, N.
    pub grip_force_n_min: f64,
    /// Free space between the whole wire and the organ, m.
    pub clearance_m: f64,
    /// Largest penetration depth of the fingers and the needle, m; deeper is a fault of the
    /// simulation.
    pub penetration_m_max: f64,
    /// Speed of the middle of the needle's arc above which the needle counts as thrown, m/s.
    pub needle_speed_m_s_max: f64,
    /// Force of one finger on the needle above which it counts as crushed, N.
    pub needle_force_n_max: f64,
    /// Energy that the needle may gain while no instrument touches it, J: more is a fault of the
    /// simulation.
    pub needle_gain_j_max: f64,
    /// Depth below the organ's surface at which the middle of the needle's arc counts as fallen
    /// off, m: deeper than a press gets it, which is 1.5 mm with all that the drive gives.
    pub sink_m_max: f64,
    /// How hard the ground may be pressed.
    pub press: PressLimit,
}

impl SuccessConfig {
    pub(super) fn check(&self, source: &Source) -> Result<(), ConfigError> {
        let check = |key: &str, value, low, high| {
            source.check_range(&format!("success.{key}"), value, low, high)
        };
        check("lift_height_m", self.lift_height_m, 0.005, 0.1)?;
        check("hold_s", self.hold_s, 0.05, 10.0)?;
        check("grip_force_n_min", self.grip_force_n_min, 0.0, 10.0)?;
        check("clearance_m", self.clearance_m, 0.0, 0.05)?;
        check("sink_m_max", self.sink_m_max, 0.001, 0.1)?;
        self.limits().check(source, "needle")?;
        self.press.check(source)
    }

    const fn limits(&self) -> Limits {
        Limits {
            penetration_m: self.penetration_m_max,
            sunk_m: None,
            speed_m_s: self.needle_speed_m_s_max,
            force_n: self.needle_force_n_max,
            gain_j: self.needle_gain_j_max,
        }
    }
}

/// Points on the wire at which its clearance is measured.
const WIRE_POINTS: usize = 13;

/// Watches the needle.
#[derive(Clone, Debug)]
pub(super) struct SuccessMonitor {
    config: SuccessConfig,
    /// The middle of the arc, needle frame: its height and speed are judged.
    middle: Point3<f64>,
    /// Points of the centre line, needle frame; the lowest one decides about clearance.
    wire: Vec<Point3<f64>>,
    wire_radius_m: f64,
    organ: Organ,
    held: DwellTimer,
    safeguard: Safeguard,
}

impl SuccessMonitor {
    /// A monitor at the start of an episode.
    pub(super) fn new(config: &SuccessConfig, needle: &NeedleShape, organ: &Organ) -> Self {
        Self {
            config: config.clone(),
            middle: Point3::new(needle.arc_radius_m, 0.0, 0.0),
            wire: needle.centre_line(WIRE_POINTS),
            wire_radius_m: needle.wire_radius_m,
            organ: organ.clone(),
            held: DwellTimer::default(),
            safeguard: Safeguard::new("needle", "organ", config.limits(), config.press),
        }
    }

    /// Whether the needle is above the organ, in the grip of both fingers.
    fn lifted(&self, sight: &MonitorInput) -> Criteria {
        let (config, grasp) = (&self.config, &sight.grasps[0]);
        let middle = sight.thing_in_scene * self.middle;
        let height_m = middle.z - self.organ.height_m(middle.x, middle.y);
        let (wire, radius_m) = (&self.wire, self.wire_radius_m);
        let clearance_m = clearance_m(wire, radius_m, &sight.thing_in_scene, &self.organ);
        let force_n = grasp.left_force_n.min(grasp.right_force_n);
        let (force, height) = ("force of each finger", "height above the organ");
        Criteria::default()
            .so("between both fingers", grasp.both_touch)
            .at_least(force, "N", force_n, config.grip_force_n_min)
            .at_least(height, "m", height_m, config.lift_height_m)
            .at_least(
                "wire clear of the organ",
                "m",
                clearance_m,
                config.clearance_m,
            )
    }
}

impl Monitor for SuccessMonitor {
    fn observe(&mut self, sight: &MonitorInput) -> Outcome {
        let middle = sight.thing_in_scene * self.middle;
        let (organ, sink_m) = (&self.organ, self.config.sink_m_max);
        let fallen = || is_off(organ, &middle, sink_m);
        if let Some(end) = self.safeguard.end(&middle, sight, fallen) {
            return end;
        }
        let held = self.lifted(sight).are_met();
        self.held.outcome(held, self.config.hold_s)
    }

    fn missing(&self) -> &'static str {
        "needle not lifted"
    }

    fn criteria(&self, sight: &MonitorInput) -> Criteria {
        let (held_s, hold_s) = (self.held.seconds(), self.config.hold_s);
        self.lifted(sight)
            .at_least("for so long", "s", held_s, hold_s)
    }
}

#[cfg(test)]
mod tests;
