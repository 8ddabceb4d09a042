//! Verdicts: what a task's monitor sees, and what it shares with the others.
//!
//! Once a millisecond, after the physics, a `MonitorInput` is read from the world and given to the
//! `Judge`, which asks the task's `Monitor` and then looks at the clock. For handled things a
//! monitor first asks its `Safeguard`, in this order: pose not finite, fingers too deep, thing too
//! deep in hard ground, energy gain (all invalid); squeezed, thrown, ground pressed, fallen (all
//! lost). Success can only follow if none of these is so.

use std::collections::VecDeque;

use hal::config::{ConfigError, Source};
use hal::{Pose, TICK_S};
use nalgebra::Point3;
use serde::Deserialize;
use trocar_world::organ::Organ;
use trocar_world::tissue::TissueReport;
use trocar_world::{Grasp, World};

use super::criteria::Criteria;
use super::outcome::{Outcome, Reason};

/// Input of a monitor: the world after one millisecond.
#[derive(Clone, Debug)]
pub(crate) struct MonitorInput {
    /// What the task is about, scene frame: a thing, or the mark on a flap.
    pub(crate) thing_in_scene: Pose,
    /// How each arm holds it.
    pub(crate) grasps: Vec<Grasp>,
    /// Tip of each arm, scene frame.
    pub(crate) tips_in_scene: Vec<Pose>,
    /// Deepest overlap of the thing and the ground, m.
    pub(crate) sunk_m: f64,
    /// Sum of the forces that press on the ground, of instruments and of what they press down, N.
    pub(crate) ground_force_n: f64,
    /// The report of the flap, if there is one.
    pub(crate) tissue: Option<TissueReport>,
    /// Kinetic and potential energy of the thing, J, while no part of an instrument touches it.
    pub(crate) free_energy_j: Option<f64>,
}

impl MonitorInput {
    /// Reads the newest step. Allocates the two lists of arms. What a jaw holds of a flap counts as
    /// a grasp here too.
    pub(crate) fn of(world: &World) -> Self {
        let arms = 0..world.arm_count();
        let is_free = world.thing_count() > 0 && arms.clone().all(|arm| !world.is_touched(arm, 0));
        Self {
            thing_in_scene: world.subject_in_scene(),
            grasps: arms.clone().map(|arm| world.subject_grasp(arm)).collect(),
            tips_in_scene: arms.clone().map(|arm| world.tip_in_scene(arm)).collect(),
            sunk_m: world.subject_sunk_m(),
            ground_force_n: arms.map(|arm| world.ground_force_n(arm)).sum::<f64>()
                + (0..world.thing_count())
                    .map(|thing| world.thing_ground_force_n(thing))
                    .sum::<f64>(),
            tissue: world.tissue().map(|tissue| *tissue.report()),
            free_energy_j: is_free.then(|| world.energy_j(0)),
        }
    }
}

/// Watches one episode of one task, 1000 times a second.
pub(crate) trait Monitor: Send {
    /// Takes in the state after one millisecond. After success or failure it is not asked again.
    fn observe(&mut self, sight: &MonitorInput) -> Outcome;

    /// What has not happened as long as there is no success, in words.
    fn missing(&self) -> &'static str;

    /// What has to be so for success, and how it is in the state that was observed last.
    fn criteria(&self, sight: &MonitorInput) -> Criteria;
}

/// A monitor with the clock.
pub(crate) struct Judge {
    monitor: Box<dyn Monitor>,
    /// Time from the first observation at which a running episode is lost, s. Success in the same
    /// millisecond wins.
    limit_s: f64,
    steps: u64,
    outcome: Outcome,
}

impl Judge {
    /// A judge at the start of an episode.
    pub(crate) fn new(monitor: Box<dyn Monitor>, limit_s: f64) -> Self {
        Self {
            monitor,
            limit_s,
            steps: 0,
            outcome: Outcome::Running,
        }
    }

    /// Gives the episode so much more time, s.
    pub(crate) fn grant_s(&mut self, seconds: f64) {
        self.limit_s += seconds;
    }

    /// How the episode stands; once decided it stays.
    pub(crate) const fn outcome(&self) -> Outcome {
        self.outcome
    }

    /// What has not happened as long as there is no success, in words.
    pub(crate) fn missing(&self) -> &'static str {
        self.monitor.missing()
    }

    /// What has to be so for success, and how it is in the state that was observed last.
    pub(crate) fn criteria(&self, sight: &MonitorInput) -> Criteria {
        self.monitor.criteria(sight)
    }

    /// Takes in the state after one millisecond.
    pub(crate) fn observe(&mut self, sight: &MonitorInput) {
        if self.outcome != Outcome::Running {
            return;
        }
        self.steps += 1;
        self.outcome = self.monitor.observe(sight);
        if self.outcome == Outcome::Running && seconds(self.steps) >= self.limit_s {
            self.outcome = Outcome::Failure(Reason::TimeLimit {
                missing: self.monitor.missing(),
                limit_s: self.limit_s,
            });
        }
    }
}

/// Time over which speed and overlaps are judged, steps: one step alone may be a solver's hiccup.
const JUDGED_STEPS: usize = 20;

/// A count of observations as time, s.
#[expect(
    clippy::cast_precision_loss,
    reason = "episodes are far shorter than 2^53 steps"
)]
pub(super) fn seconds(steps: u64) -> f64 {
    steps as f64 * TICK_S
}

/// Counts how long something has been so; true once it has lasted.
pub(super) fn lasts(steps: &mut usize, is_so: bool) -> bool {
    *steps = if is_so { *steps + 1 } else { 0 };
    *steps >= JUDGED_STEPS
}

/// Share of a limit below which a force must fall to count as let go of: at the limit itself one
/// tick decides nothing.
const LET_GO: f64 = 0.8;

/// How hard the ground may be pressed.
#[derive(Clone, Copy, Debug, PartialEq, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct PressLimit {
    /// Force, N: instruments and what they press down together.
    pub force_n_max: f64,
    /// How long it may be above that, s; it ends once the force falls below four fifths of the
    /// limit.
    pub seconds_max: f64,
}

impl PressLimit {
    pub(super) fn check(&self, source: &Source) -> Result<(), ConfigError> {
        source.check_range("success.press.force_n_max", self.force_n_max, 0.1, 100.0)?;
        source.check_range("success.press.seconds_max", self.seconds_max, 0.02, 10.0)
    }
}

/// Watches how hard the ground is pressed.
#[derive(Clone, Debug)]
pub(super) struct PressWatch {
    ground: &'static str,
    limit: PressLimit,
    /// Steps in a row above the limit, with the hysteresis of [`LET_GO`].
    steps: u64,
}

impl PressWatch {
    pub(super) const fn new(ground: &'static str, limit: PressLimit) -> Self {
        Self {
            ground,
            limit,
            steps: 0,
        }
    }

    /// Takes in a step; says what is wrong once it has lasted.
    pub(super) fn failure(&mut self, sight: &MonitorInput) -> Option<Reason> {
        let force_n = sight.ground_force_n;
        let is_pressed = if self.steps == 0 {
            force_n > self.limit.force_n_max
        } else {
            force_n > LET_GO * self.limit.force_n_max
        };
        self.steps = if is_pressed { self.steps + 1 } else { 0 };
        let seconds = seconds(self.steps);
        (seconds > self.limit.seconds_max).then_some(Reason::Pressed {
            ground: self.ground,
            force_n,
            seconds,
        })
    }
}

/// What no handled thing may go beyond.
#[derive(Clone, Copy, Debug)]
pub(super) struct Limits {
    /// Largest penetration depth of fingers and thing, m; deeper is a fault of the simulation.
    pub(super) penetration_m: f64,
    /// Largest penetration depth of the thing and hard ground, m; likewise. None on soft ground.
    pub(super) sunk_m: Option<f64>,
    /// Speed of the point that is watched, m/s.
    pub(super) speed_m_s: f64,
    /// Force of one finger, N.
    pub(super) force_n: f64,
    /// Energy that it may gain while no instrument touches it, J: what the ground's give returns.
    /// More is a fault of the simulation.
    pub(super) gain_j: f64,
}

impl Limits {
    /// Checks them under the keys that `[success]` of a scene file has for `thing`.
    pub(super) fn check(&self, source: &Source, thing: &str) -> Result<(), ConfigError> {
        let check = |key: &str, value, low, high| {
            source.check_range(&format!("success.{key}"), value, low, high)
        };
        check("penetration_m_max", self.penetration_m, 0.000_01, 0.01)?;
        if let Some(sunk_m) = self.sunk_m {
            check("sunk_m_max", sunk_m, 0.000_01, 0.01)?;
        }
        let of_thing = |what: &str| format!("{thing}_{what}");
        check(&of_thing("speed_m_s_max"), self.speed_m_s, 0.05, 10.0)?;
        check(&of_thing("force_n_max"), self.force_n, 0.1, 100.0)?;
        check(&of_thing("gain_j_max"), self.gain_j, 1e-7, 0.01)
    }
}

/// What ends the episode of a handled thing, but for its success.
#[derive(Clone, Debug)]
pub(super) struct Safeguard {
    ground: &'static str,
    watch: FailureMonitor,
    press: PressWatch,
}

impl Safeguard {
    /// Of a thing that belongs on `ground`.
    pub(super) fn new(
        thing: &'static str,
        ground: &'static str,
        limits: Limits,
        press: PressLimit,
    ) -> Self {
        Self {
            ground,
            watch: FailureMonitor::new(thing, limits),
            press: PressWatch::new(ground, press),
        }
    }

    /// How the episode ends, if it does, with one of the thing's points at `point`. `fallen` tells
    /// whether the thing has left its ground, and is only asked of a pose that is finite.
    pub(super) fn end(
        &mut self,
        point: &Point3<f64>,
        sight: &MonitorInput,
        fallen: impl FnOnce() -> bool,
    ) -> Option<Outcome> {
        if let Some(end) = self.watch.end(point, sight) {
            return Some(end);
        }
        if let Some(reason) = self.press.failure(sight) {
            return Some(Outcome::Failure(reason));
        }
        fallen().then_some(Outcome::Failure(Reason::Fallen {
            thing: self.watch.thing,
            ground: self.ground,
        }))
    }
}

/// Whether a needle, the middle of whose arc is at `middle`, has fallen off `organ` or below its
/// surface by more than `sink_m`.
pub(super) fn is_off(organ: &Organ, middle: &Point3<f64>, sink_m: f64) -> bool {
    let height_m = middle.z - organ.height_m(middle.x, middle.y);
    !organ.covers(middle.x, middle.y) || height_m < -sink_m
}

/// Free space between `organ` and a wire of `radius_m` at its lowest point, m; negative where it is
/// below the surface. `wire` is points of its centre line, needle frame.
pub(super) fn clearance_m(
    wire: &[Point3<f64>],
    radius_m: f64,
    needle_in_scene: &Pose,
    organ: &Organ,
) -> f64 {
    let clearances_m = wire.iter().map(|point| {
        let point = needle_in_scene * point;
        point.z - organ.height_m(point.x, point.y) - radius_m
    });
    clearances_m.fold(f64::INFINITY, f64::min)
}

/// For how long the goal has been met without a break.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct DwellTimer {
    steps: u64,
}

impl DwellTimer {
    /// For how long, s.
    pub(super) fn seconds(self) -> f64 {
        seconds(self.steps)
    }

    /// Takes in a step: success once the goal has been met for `hold_s`.
    pub(super) fn outcome(&mut self, is_met: bool, hold_s: f64) -> Outcome {
        self.steps = if is_met { self.steps + 1 } else { 0 };
        if seconds(self.steps) >= hold_s {
            Outcome::Success
        } else {
            Outcome::Running
        }
    }
}

/// The checks that every handled thing passes. Crushing and throwing lose the episode; penetration,
/// energy gain and what is not finite make it invalid.
#[derive(Clone, Debug)]
pub(super) struct FailureMonitor {
    thing: &'static str,
    limits: Limits,
    /// Steps in a row with a finger too deep in the thing; [`JUDGED_STEPS`] of them decide.
    deep_steps: usize,
    /// Likewise with the thing too deep in hard ground.
    sunk_steps: usize,
    /// Likewise with too much force of a finger.
    hard_steps: usize,
    /// Least energy since an instrument last touched it, J; infinite while one does.
    least_energy_j: f64,
    /// Where the watched point was in the last [`JUDGED_STEPS`] steps, oldest first, scene frame,
    /// m: over these its mean speed is judged.
    points: VecDeque<Point3<f64>>,
}

impl FailureMonitor {
    pub(super) fn new(thing: &'static str, limits: Limits) -> Self {
        Self {
            thing,
            limits,
            deep_steps: 0,
            sunk_steps: 0,
            hard_steps: 0,
            least_energy_j: f64::INFINITY,
            points: VecDeque::with_capacity(JUDGED_STEPS + 1),
        }
    }

    /// How the episode ends by what is wrong with a thing, one of whose points is at `point`.
    pub(super) fn end(&mut self, point: &Point3<f64>, sight: &MonitorInput) -> Option<Outcome> {
        let fault = self.fault(point, sight).map(Outcome::Invalid);
        fault.or_else(|| self.failure(point, sight).map(Outcome::Failure))
    }

    /// What is wrong with the simulation.
    fn fault(&mut self, point: &Point3<f64>, sight: &MonitorInput) -> Option<Reason> {
        let thing = self.thing;
        if !point.coords.iter().all(|x| x.is_finite()) {
            return Some(Reason::NotFinite { thing });
        }
        let depths_m = sight.grasps.iter().map(|grasp| grasp.penetration_m);
        let depth_m = depths_m.fold(0.0, f64::max);
        if lasts(&mut self.deep_steps, depth_m > self.limits.penetration_m) {
            return Some(Reason::Penetration { thing, depth_m });
        }
        let depth_m = sight.sunk_m;
        let is_sunk = self.limits.sunk_m.is_some_and(|most_m| depth_m > most_m);
        if lasts(&mut self.sunk_steps, is_sunk) {
            return Some(Reason::Sunk { thing, depth_m });
        }
        let energy_j = self.gain_j(sight.free_energy_j);
        (energy_j > self.limits.gain_j).then_some(Reason::Gained { thing, energy_j })
    }

    /// What harms the thing.
    fn failure(&mut self, point: &Point3<f64>, sight: &MonitorInput) -> Option<Reason> {
        let thing = self.thing;
        let most = |of: fn(&Grasp) -> f64| sight.grasps.iter().map(of).fold(0.0, f64::max);
        let force_n = most(|grasp| grasp.left_force_n.max(grasp.right_force_n));
        if lasts(&mut self.hard_steps, force_n > self.limits.force_n) {
            return Some(Reason::Squeezed { thing, force_n });
        }
        self.points.push_back(*point);
        if self.points.len() > JUDGED_STEPS {
            let before = self.points.pop_front()?;
            let speed_m_s = (point - before).norm() / seconds(JUDGED_STEPS as u64);
            if speed_m_s > self.limits.speed_m_s {
                return Some(Reason::Thrown { thing, speed_m_s });
            }
        }
        None
    }

    /// How far the energy is above its least value since an instrument last touched the thing.
    fn gain_j(&mut self, free_energy_j: Option<f64>) -> f64 {
        let Some(energy_j) = free_energy_j else {
            self.least_energy_j = f64::INFINITY;
            return 0.0;
        };
        self.least_energy_j = self.least_energy_j.min(energy_j);
        energy_j - self.least_energy_j
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::task::TaskConfig;

    const LIMIT: PressLimit = PressLimit {
        force_n_max: 6.0,
        seconds_max: 0.5,
    };

    /// Shows each force for its number of steps; gives the step at which the press had lasted too
    /// long.
    fn pressed(parts: &[(f64, usize)]) -> Option<usize> {
        let task = TaskConfig::shipped("needle-lift");
        let mut sight =
            MonitorInput::of(&World::new(&task.world, &task.scene.scenery(0), &task.arms));
        let mut watch = PressWatch::new("organ", LIMIT);
        let forces = parts
            .iter()
            .flat_map(|&(force_n, steps)| core::iter::repeat_n(force_n, steps));
        forces.enumerate().find_map(|(step, force_n)| {
            sight.ground_force_n = force_n;
            watch.failure(&sight).map(|_| step + 1)
        })
    }

    #[test]
    fn a_press_counts_once_it_has_lasted() {
        assert_eq!(pressed(&[(6.1, 500)]), None);
        assert_eq!(pressed(&[(6.1, 501)]), Some(501));
        assert_eq!(pressed(&[(5.9, 5000)]), None);
    }

    #[test]
    fn a_peak_decides_nothing_and_a_dip_excuses_nothing() {
        // Peaks with rest between them never add up.
        assert_eq!(
            pressed(&[(50.0, 400), (1.0, 1), (50.0, 400), (1.0, 1)]),
            None
        );
        // What trembles about the limit does.
        assert_eq!(pressed(&[(6.1, 300), (5.5, 10), (6.1, 300)]), Some(501));
    }
}
