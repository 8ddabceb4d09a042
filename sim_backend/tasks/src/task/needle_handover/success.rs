//! Decides whether the needle has changed hands, and catches what would only look like it.

use hal::Pose;
use hal::config::{ConfigError, Source};
use nalgebra::Point3;
use serde::Deserialize;
use trocar_world::needle::NeedleShape;
use trocar_world::organ::Organ;

use super::NeedleHandover;
use crate::task::judge::{DwellTimer, Limits, PressLimit, Safeguard, clearance_m, is_off, seconds};
use crate::task::{Criteria, Monitor, MonitorInput, Outcome};

/// How long the needle may be between no arm's fingers before it counts as dropped, s: contacts
/// flicker.
const LOOSE_S: f64 = 0.02;

/// What counts as a handed-over needle, and what ends the episode at once.
///
/// Success has two stages. First the right arm alone holds the needle up for `given_s`; a needle
/// that then is in no hand for 20 ms has not been given. Afterwards the left arm alone holds it up
/// for `hold_s` without a break, the right arm being `away_m` from it. To hold is to press on it
/// with both fingers, with `grip_force_n_min` each, the other arm not touching it.
#[derive(Clone, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SuccessConfig {
    /// Free space between the whole wire and the organ, m, in either arm's hand.
    pub clearance_m: f64,
    /// Force that each finger of the holding arm must put on the needle, N.
    pub grip_force_n_min: f64,
    /// How long the right arm alone must have held the needle up, s.
    pub given_s: f64,
    /// Distance of the right arm's control point from the whole wire at the end, m.
    pub away_m: f64,
    /// How long the left arm alone must hold the needle up, s.
    pub hold_s: f64,
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

/// Points on the wire at which its clearance is measured.
const WIRE_POINTS: usize = 25;

impl SuccessConfig {
    pub(super) fn check(&self, source: &Source) -> Result<(), ConfigError> {
        let check = |key: &str, value, low, high| {
            source.check_range(&format!("success.{key}"), value, low, high)
        };
        check("clearance_m", self.clearance_m, 0.0, 0.05)?;
        check("grip_force_n_min", self.grip_force_n_min, 0.0, 10.0)?;
        check("given_s", self.given_s, 0.05, 10.0)?;
        check("away_m", self.away_m, 0.0, 0.1)?;
        check("hold_s", self.hold_s, 0.05, 10.0)?;
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

/// Watches the needle.
pub(super) struct SuccessMonitor {
    config: SuccessConfig,
    needle: NeedleShape,
    organ: Organ,
    /// Points of the centre line, needle frame, the pointed end last.
    wire: Vec<Point3<f64>>,
    /// For how many milliseconds the first arm alone has held it up without a break.
    given_steps: u64,
    /// Whether that has lasted, and the needle not been loose since.
    given: bool,
    /// For how long no arm has had it between its fingers.
    loose_steps: u64,
    held: DwellTimer,
    safeguard: Safeguard,
}

impl SuccessMonitor {
    /// A monitor at the start of an episode.
    pub(super) fn new(scene: &NeedleHandover) -> Self {
        let config = scene.success.clone();
        Self {
            needle: scene.needle,
            organ: scene.organ.clone(),
            wire: scene.needle.centre_line(WIRE_POINTS),
            given_steps: 0,
            given: false,
            loose_steps: 0,
            held: DwellTimer::default(),
            safeguard: Safeguard::new("needle", "organ", config.limits(), config.press),
            config,
        }
    }

    fn end(&mut self, sight: &MonitorInput) -> Option<Outcome> {
        let middle = sight.thing_in_scene * self.wire[WIRE_POINTS / 2];
        let (organ, sink_m) = (&self.organ, self.config.sink_m_max);
        let fallen = || is_off(organ, &middle, sink_m);
        self.safeguard.end(&middle, sight, fallen)
    }

    /// `all`, and whether one arm alone holds the needle, clear of the organ: the first, or once it
    /// is `given` the second, the first being away.
    fn holding(&self, all: Criteria, sight: &MonitorInput, given: bool) -> Criteria {
        let (config, needle) = (&self.config, &sight.thing_in_scene);
        let (first, second) = (&sight.grasps[0], &sight.grasps[1]);
        let (holder, other, fingers) = if given {
            (second, first, "between the second arm's fingers")
        } else {
            (first, second, "between the first arm's fingers")
        };
        let force_n = holder.left_force_n.min(holder.right_force_n);
        let alone = other.left_force_n <= 0.0 && other.right_force_n <= 0.0;
        let radius_m = self.needle.wire_radius_m;
        let clearance_m = clearance_m(&self.wire, radius_m, needle, &self.organ);
        let (force, clear) = ("force of each finger", "wire clear of the organ");
        let held = all
            .so(fingers, holder.both_touch)
            .at_least(force, "N", force_n, config.grip_force_n_min)
            .so("not touched by the other arm", alone)
            .at_least(clear, "m", clearance_m, config.clearance_m);
        if !given {
            return held;
        }
        let away_m = self.away_m(needle, &sight.tips_in_scene[0]);
        held.at_least("first arm away from the wire", "m", away_m, config.away_m)
    }

    /// How far the giver's hand is away from the wire, m.
    fn away_m(&self, needle_in_scene: &Pose, giver_tip: &Pose) -> f64 {
        let tip = Point3::from(giver_tip.translation.vector);
        let distances_m = self
            .wire
            .iter()
            .map(|point| (needle_in_scene * point - tip).norm());
        distances_m.fold(f64::INFINITY, f64::min)
    }
}

impl Monitor for SuccessMonitor {
    fn observe(&mut self, sight: &MonitorInput) -> Outcome {
        if let Some(end) = self.end(sight) {
            return end;
        }
        let (giver, taker) = (&sight.grasps[0], &sight.grasps[1]);
        let is_held = |by_second| {
            self.holding(Criteria::default(), sight, by_second)
                .are_met()
        };
        let (giving, taking) = (is_held(false), is_held(true));
        self.given_steps = if giving { self.given_steps + 1 } else { 0 };
        self.given |= seconds(self.given_steps) >= self.config.given_s;
        // A needle that was let fall has to be lifted and given again.
        let loose = !giver.both_touch && !taker.both_touch;
        self.loose_steps = if loose { self.loose_steps + 1 } else { 0 };
        self.given &= seconds(self.loose_steps) < LOOSE_S;
        self.held.outcome(self.given && taking, self.config.hold_s)
    }

    fn missing(&self) -> &'static str {
        if self.given {
            "needle not taken away"
        } else {
            "needle not lifted"
        }
    }

    fn criteria(&self, sight: &MonitorInput) -> Criteria {
        let (config, given) = (&self.config, self.given);
        let all = Criteria::default().so("lifted by the first arm", given);
        let (held_s, hold_s) = if given {
            (self.held.seconds(), config.hold_s)
        } else {
            (seconds(self.given_steps), config.given_s)
        };
        self.holding(all, sight, given)
            .at_least("for so long", "s", held_s, hold_s)
    }
}
