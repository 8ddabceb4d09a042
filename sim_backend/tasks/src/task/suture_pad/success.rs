//! Decides whether the needle is through the hole, and catches what would only look like it.

use hal::Pose;
use hal::config::{ConfigError, Source};
use nalgebra::Point3;
use serde::Deserialize;
use trocar_world::organ::Organ;

use super::{PadShape, SuturePad};
use crate::task::judge::{DwellTimer, Limits, PressLimit, Safeguard, is_off};
use crate::task::{Criteria, Monitor, MonitorInput, Outcome};

/// What counts as a needle through the hole, and what ends the episode at once.
///
/// Success: for `hold_s` without a break the wire leads from before the lip through the hole, and
/// its point is `through_m` behind the lip. Whether a hand holds it does not matter.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SuccessConfig {
    /// How far behind the lip the needle's point must be, m.
    pub through_m: f64,
    /// How long the needle must stay so without a break, s.
    pub hold_s: f64,
    /// Largest penetration depth of the fingers and the needle, m; deeper is a fault of the
    /// simulation.
    pub penetration_m_max: f64,
    /// Largest penetration depth of the needle and the pad, or the fold of an organ, m; deeper is a
    /// fault of the simulation.
    pub sunk_m_max: f64,
    /// Speed of the needle's point above which the needle counts as thrown, m/s.
    pub needle_speed_m_s_max: f64,
    /// Force of one finger on the needle above which it counts as crushed, N.
    pub needle_force_n_max: f64,
    /// Energy that the needle may gain while no instrument touches it, J: more is a fault of the
    /// simulation.
    pub needle_gain_j_max: f64,
    /// How hard the ground may be pressed.
    pub press: PressLimit,
}

/// Depth below a patient's organ at which the middle of the needle's arc counts as fallen off, m,
/// as in the needle lift.
const SINK_M: f64 = 0.005;

/// Points on the wire at which its way through the hole is followed: 0.6 mm apart.
const WIRE_POINTS: usize = 113;

impl SuccessConfig {
    pub(super) fn check(&self, source: &Source) -> Result<(), ConfigError> {
        let check = |key: &str, value, low, high| {
            source.check_range(&format!("success.{key}"), value, low, high)
        };
        check("through_m", self.through_m, 0.001, 0.03)?;
        check("hold_s", self.hold_s, 0.05, 10.0)?;
        self.limits().check(source, "needle")?;
        self.press.check(source)
    }

    const fn limits(&self) -> Limits {
        Limits {
            penetration_m: self.penetration_m_max,
            sunk_m: Some(self.sunk_m_max),
            speed_m_s: self.needle_speed_m_s_max,
            force_n: self.needle_force_n_max,
            gain_j: self.needle_gain_j_max,
        }
    }
}

/// Watches the needle.
pub(super) struct SuccessMonitor {
    config: SuccessConfig,
    /// Where the hole is; on a patient too, whose fold has the same one.
    pad: PadShape,
    /// The patient's organ; none on the pad.
    organ: Option<Organ>,
    /// The wire in the needle frame, its point last.
    wire: Vec<Point3<f64>>,
    held: DwellTimer,
    safeguard: Safeguard,
}

impl SuccessMonitor {
    /// A monitor at the start of an episode.
    pub(super) fn new(scene: &SuturePad) -> Self {
        let (config, organ) = (scene.success.clone(), scene.organ());
        let ground = if organ.is_some() { "organ" } else { "pad" };
        let limits = config.limits();
        Self {
            organ,
            pad: scene.pad,
            wire: scene.needle.centre_line(WIRE_POINTS),
            held: DwellTimer::default(),
            safeguard: Safeguard::new("needle", ground, limits, config.press),
            config,
        }
    }

    /// The verdict of the safeguard, by the speed of the needle's point. Off the pad counts as
    /// fallen when the middle of the arc is beside the plate or below its top.
    fn end(&mut self, sight: &MonitorInput) -> Option<Outcome> {
        let point = sight.thing_in_scene * self.wire[WIRE_POINTS - 1];
        let middle = sight.thing_in_scene * self.wire[WIRE_POINTS / 2];
        let pad = &self.pad;
        let fallen = || match &self.organ {
            Some(organ) => is_off(organ, &middle, SINK_M),
            None => !pad.covers(middle.x, middle.y) || middle.z < 0.0,
        };
        self.safeguard.end(&point, sight, fallen)
    }

    /// Whether the wire leads from before the lip through the hole to its point behind the lip.
    /// Followed from the blunt end: that has to be before the lip, every point within the lip's
    /// thickness inside the square hole, and the needle's point far enough behind. A needle that
    /// goes around the lip has points beside the hole there and fails.
    fn is_through(&self, needle_in_scene: &Pose) -> bool {
        let pad = &self.pad;
        let point = needle_in_scene * self.wire[WIRE_POINTS - 1];
        if point.y < pad.lip_back_m() + self.config.through_m {
            return false;
        }
        let hole = pad.hole();
        let mut ends = [false; 2];
        for (index, point) in self.wire.iter().enumerate() {
            let point = needle_in_scene * point;
            if point.y < pad.lip_front_m {
                ends[0] |= index == 0;
            } else if point.y <= pad.lip_back_m() {
                let aside_m = (point.x - hole.x).abs().max((point.z - hole.z).abs());
                if aside_m > pad.hole_half_m {
                    return false;
                }
            } else if point.y >= pad.lip_back_m() + self.config.through_m {
                ends[1] |= index == WIRE_POINTS - 1;
            }
        }
        ends == [true; 2]
    }
}

impl Monitor for SuccessMonitor {
    fn observe(&mut self, sight: &MonitorInput) -> Outcome {
        if let Some(end) = self.end(sight) {
            return end;
        }
        let through = self.is_through(&sight.thing_in_scene);
        self.held.outcome(through, self.config.hold_s)
    }

    fn missing(&self) -> &'static str {
        "needle not through the hole"
    }

    fn criteria(&self, sight: &MonitorInput) -> Criteria {
        let (config, needle) = (&self.config, &sight.thing_in_scene);
        let behind_m = (needle * self.wire[WIRE_POINTS - 1]).y - self.pad.lip_back_m();
        Criteria::default()
            .at_least(
                "needle's point behind the lip",
                "m",
                behind_m,
                config.through_m,
            )
            .so(
                "wire through the hole from before it",
                self.is_through(needle),
            )
            .at_least("for so long", "s", self.held.seconds(), config.hold_s)
    }
}
