//! Decides whether the needle has been lifted, and catches what would only look like it.

use core::fmt;
use std::collections::VecDeque;

use hal::Pose;
use nalgebra::Point3;
use serde::Deserialize;

use crate::needle::NeedleShape;
use crate::organ::OrganShape;
use crate::world::Grasp;

/// What counts as a lifted needle, and what ends the episode at once.
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
    /// When the episode ends without success, s.
    pub time_limit_s: f64,
    /// Depth by which the fingers may sink into the needle, m; deeper is a fault of the physics, not a grasp.
    pub penetration_m_max: f64,
    /// Speed of the middle of the needle's arc above which the needle counts as thrown, m/s.
    pub needle_speed_m_s_max: f64,
    /// Depth below the organ's surface at which the middle of the needle's arc counts as fallen off, m.
    pub sink_m_max: f64,
}

/// How an episode stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Outcome {
    /// Not decided yet.
    Running,
    /// The needle was lifted and held.
    Success,
    /// The episode is lost.
    Failure(Reason),
}

/// Why an episode was lost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Reason {
    /// Time ran out.
    TimeLimit {
        /// The limit, s.
        limit_s: f64,
    },
    /// The fingers sank into the needle.
    Penetration {
        /// How deep, m.
        depth_m: f64,
    },
    /// The needle moved faster than a careful lift moves it.
    Thrown {
        /// How fast, m/s.
        speed_m_s: f64,
    },
    /// The needle fell off the organ.
    OffOrgan,
    /// The needle's pose is no number any more.
    NotFinite,
}

impl fmt::Display for Outcome {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Running => f.write_str("running"),
            Self::Success => f.write_str("needle lifted and held"),
            Self::Failure(reason) => reason.fmt(f),
        }
    }
}

impl fmt::Display for Reason {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::TimeLimit { limit_s } => write!(f, "needle not lifted within {limit_s} s"),
            Self::Penetration { depth_m } => {
                write!(f, "fingers sank {:.2} mm into the needle", depth_m * 1e3)
            }
            Self::Thrown { speed_m_s } => write!(f, "needle thrown at {speed_m_s:.2} m/s"),
            Self::OffOrgan => f.write_str("needle fell off the organ"),
            Self::NotFinite => f.write_str("needle pose is not finite"),
        }
    }
}

/// Length of one observation of the monitor, s.
const STEP_S: f64 = 1e-3;

/// Time over which speed and penetration are judged, steps: one step alone may be a solver's hiccup.
const JUDGED_STEPS: usize = 20;

/// Points on the wire at which its clearance is measured.
const WIRE_POINTS: usize = 13;

/// Watches the needle, 1000 times a second.
#[derive(Clone, Debug)]
pub struct SuccessMonitor {
    config: SuccessConfig,
    middle: Point3<f64>,
    wire: Vec<Point3<f64>>,
    wire_radius_m: f64,
    organ: OrganShape,
    steps: u64,
    held_steps: u64,
    deep_steps: usize,
    middles: VecDeque<Point3<f64>>,
    outcome: Outcome,
}

impl SuccessMonitor {
    /// A monitor at the start of an episode.
    #[must_use]
    pub fn new(config: &SuccessConfig, needle: &NeedleShape, organ: &OrganShape) -> Self {
        Self {
            config: config.clone(),
            middle: Point3::new(needle.arc_radius_m, 0.0, 0.0),
            wire: needle.centre_line(WIRE_POINTS),
            wire_radius_m: needle.wire_radius_m,
            organ: *organ,
            steps: 0,
            held_steps: 0,
            deep_steps: 0,
            middles: VecDeque::with_capacity(JUDGED_STEPS + 1),
            outcome: Outcome::Running,
        }
    }

    /// How the episode stands; once decided it stays.
    #[must_use]
    pub const fn outcome(&self) -> Outcome {
        self.outcome
    }

    /// Takes in the state after one millisecond.
    pub fn observe(&mut self, needle_in_scene: &Pose, grasp: &Grasp) {
        if self.outcome != Outcome::Running {
            return;
        }
        self.steps += 1;
        let middle = needle_in_scene * self.middle;
        self.outcome = match self.failure(&middle, grasp) {
            Some(reason) => Outcome::Failure(reason),
            None => self.progress(needle_in_scene, &middle, grasp),
        };
    }

    fn progress(&mut self, needle_in_scene: &Pose, middle: &Point3<f64>, grasp: &Grasp) -> Outcome {
        let raised =
            middle.z - self.organ.height_m(middle.x, middle.y) >= self.config.lift_height_m;
        let force_n = grasp.left_force_n.min(grasp.right_force_n);
        let gripped = grasp.both_touch && force_n >= self.config.grip_force_n_min;
        let held =
            raised && gripped && self.clearance_m(needle_in_scene) >= self.config.clearance_m;
        self.held_steps = if held { self.held_steps + 1 } else { 0 };
        if seconds(self.held_steps) >= self.config.hold_s {
            Outcome::Success
        } else if seconds(self.steps) >= self.config.time_limit_s {
            Outcome::Failure(Reason::TimeLimit {
                limit_s: self.config.time_limit_s,
            })
        } else {
            Outcome::Running
        }
    }

    fn failure(&mut self, middle: &Point3<f64>, grasp: &Grasp) -> Option<Reason> {
        if !middle.coords.iter().all(|x| x.is_finite()) {
            return Some(Reason::NotFinite);
        }
        self.deep_steps = if grasp.penetration_m > self.config.penetration_m_max {
            self.deep_steps + 1
        } else {
            0
        };
        if self.deep_steps >= JUDGED_STEPS {
            return Some(Reason::Penetration {
                depth_m: grasp.penetration_m,
            });
        }
        self.middles.push_back(*middle);
        if self.middles.len() > JUDGED_STEPS {
            let before = self.middles.pop_front()?;
            let speed_m_s = (middle - before).norm() / seconds(JUDGED_STEPS as u64);
            if speed_m_s > self.config.needle_speed_m_s_max {
                return Some(Reason::Thrown { speed_m_s });
            }
        }
        self.off_organ(middle).then_some(Reason::OffOrgan)
    }

    fn off_organ(&self, middle: &Point3<f64>) -> bool {
        let height_m = middle.z - self.organ.height_m(middle.x, middle.y);
        !self.organ.covers(middle.x, middle.y) || height_m < -self.config.sink_m_max
    }

    /// Free space between the wire and the organ at its lowest point, m.
    fn clearance_m(&self, needle_in_scene: &Pose) -> f64 {
        self.wire
            .iter()
            .map(|point| needle_in_scene * point)
            .map(|point| point.z - self.organ.height_m(point.x, point.y) - self.wire_radius_m)
            .fold(f64::INFINITY, f64::min)
    }
}

#[expect(
    clippy::cast_precision_loss,
    reason = "episodes are far shorter than 2^53 steps"
)]
fn seconds(steps: u64) -> f64 {
    steps as f64 * STEP_S
}

#[cfg(test)]
mod tests;
