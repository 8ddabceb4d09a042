//! The scripted expert: lifts the needle from wherever it lies, a little differently with each seed.
//!
//! It sees the scene's true state, once a policy step, and answers with the tip target of that instant. Targets form a
//! smooth path from rest to rest, so that they can be recorded as demonstrations. It follows the needle if that moves,
//! and starts over when the fingers closed on nothing or the needle slipped out.

#[cfg(test)]
mod closed_loop;
mod motion;
mod phase;
mod style;

use hal::{Chunk, Pose, TimeNs, TipTarget};
use nalgebra::{Matrix3, Point3, Rotation3, Translation3, UnitQuaternion, Vector3};

pub use phase::Phase;

use crate::needle::NeedleShape;
use crate::organ::OrganShape;
use crate::rng::Rng;
use crate::simulation::SceneState;
use crate::task::TaskConfig;
use motion::{Motion, Placement};
use phase::Event;
use style::Style;

/// Time between two steps of the expert, ns: 40 control ticks.
pub const STEP_NS: u64 = 40 * hal::TICK_NS;

/// Targets in one chunk of the expert: 0.4 s.
pub const CHUNK_LEN: usize = 10;

/// Distance between the closed finger tips and the organ at the grasp, m. The less, the further the tips reach beyond
/// the wire.
const TIP_CLEARANCE_M: f64 = 0.000_1;

/// Thickness of a finger around the wire, m.
const FINGER_REACH_M: f64 = 0.0015;

/// A step's share of following a moving needle, m and rad.
const FOLLOW_STEP_M: f64 = 0.0008;
const FOLLOW_STEP_RAD: f64 = 0.04;

/// How far the measured tip may be from its target at the end of a motion, m, and how long to wait for it, s.
const ARRIVED_M: f64 = 0.0006;
const ARRIVED_PATIENCE_S: f64 = 0.6;

/// How long to wait for both fingers after the jaw's motion has ended, s.
const GRIP_PATIENCE_S: f64 = 0.5;

/// Steps without touch by both fingers after which the needle counts as lost.
const LOST_STEPS: u32 = 4;

/// Time to rest with an open jaw after a failed attempt, s.
const REOPEN_S: f64 = 0.3;

/// What the expert wants at one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ExpertStep {
    /// Where the tip should be now, in the RCM frame.
    pub target: TipTarget,
    /// What the expert is doing.
    pub phase: Phase,
    /// Attempts at a grasp begun so far, this one included.
    pub attempts: u32,
}

/// The scripted expert of the needle lift.
#[derive(Clone, Debug)]
pub struct Expert {
    needle: NeedleShape,
    organ: OrganShape,
    scene_from_rcm: Pose,
    rng: Rng,
    style: Style,
    phase: Phase,
    motion: Option<Motion>,
    attempts: u32,
    untouched_steps: u32,
}

impl Expert {
    /// An expert for `task`; its habits hang on `seed`, apart from the scene's own randomness.
    #[must_use]
    pub fn new(task: &TaskConfig, seed: u64) -> Self {
        let mut rng = Rng::stream(seed, "expert");
        let style = Style::draw(&mut rng);
        Self {
            needle: task.needle,
            organ: task.organ,
            scene_from_rcm: task.scene_from_rcm,
            rng,
            style,
            phase: Phase::Approach,
            motion: None,
            attempts: 1,
            untouched_steps: 0,
        }
    }

    /// The target for `now`; to be called every [`STEP_NS`].
    ///
    /// The first call starts from where the tip is measured.
    pub fn step(&mut self, now: TimeNs, scene: &SceneState) -> ExpertStep {
        let start = Placement {
            tip_in_scene: self.scene_from_rcm * scene.tip_in_rcm,
            jaw: scene.jaw,
        };
        let mut motion = self.motion.unwrap_or_else(|| self.begin(now, start, scene));
        if let Some(goal) = self.moving_goal(scene) {
            motion.drift_end(&goal, FOLLOW_STEP_M, FOLLOW_STEP_RAD);
        }
        if let Some(event) = self.event(now, &motion, scene) {
            let next = self.phase.next(event);
            if next != self.phase {
                self.enter(next);
                motion = self.begin(now, motion.at(now), scene);
            }
        }
        self.motion = Some(motion);
        let placement = motion.at(now);
        let tip_in_rcm = self.scene_from_rcm.inv_mul(&placement.tip_in_scene);
        ExpertStep {
            target: TipTarget::new(&tip_in_rcm, placement.jaw),
            phase: self.phase,
            attempts: self.attempts,
        }
    }

    /// The target for `now` and those that would follow if the arm kept up and the needle stayed as it is.
    pub fn chunk(&mut self, now: TimeNs, scene: &SceneState, sequence: u64) -> Chunk {
        let mut target = self.step(now, scene).target;
        let mut targets = [target; CHUNK_LEN];
        let mut ahead = self.clone();
        let mut imagined = *scene;
        let mut due = now;
        for slot in targets.iter_mut().skip(1) {
            due = due.plus_ns(STEP_NS);
            imagined.tip_in_rcm = target.tip_in_rcm();
            imagined.jaw = target.jaw;
            target = ahead.step(due, &imagined).target;
            *slot = target;
        }
        Chunk::new(now, sequence, STEP_NS, &targets)
    }

    /// Book-keeping on entering a phase.
    fn enter(&mut self, phase: Phase) {
        if phase == Phase::Open {
            // A person does not repeat a failed attempt exactly.
            self.style = Style::draw(&mut self.rng);
            self.attempts += 1;
        }
        self.phase = phase;
        self.untouched_steps = 0;
    }

    /// The motion of the present phase.
    fn begin(&self, now: TimeNs, from: Placement, scene: &SceneState) -> Motion {
        let style = &self.style;
        let straight = Vector3::zeros();
        match self.phase {
            Phase::Approach => {
                let to = Placement {
                    tip_in_scene: self.poise_pose(scene),
                    jaw: style.open_rad,
                };
                Motion::new(from, to, style.bow_m, now, style.approach)
            }
            Phase::Poise => Motion::rest(from, now, style.poise_s),
            Phase::Descend => {
                let to = Placement {
                    tip_in_scene: self.grasp_pose(scene),
                    jaw: style.open_rad,
                };
                Motion::new(from, to, straight, now, style.descend)
            }
            Phase::Close => Motion::new(
                from,
                Placement {
                    jaw: style.grip_rad,
                    ..from
                },
                straight,
                now,
                style.close,
            ),
            Phase::Lift => Motion::new(
                from,
                raised(from, style.lift_height_m),
                straight,
                now,
                style.lift,
            ),
            Phase::Hold => Motion::rest(from, now, 0.0),
            Phase::Open => Motion::new(
                from,
                Placement {
                    jaw: style.open_rad,
                    ..from
                },
                straight,
                now,
                style.close,
            ),
            Phase::Retreat => Motion::new(
                from,
                raised(from, style.poise_height_m),
                straight,
                now,
                style.descend,
            ),
        }
    }

    /// The goal of a phase that follows the needle.
    fn moving_goal(&self, scene: &SceneState) -> Option<Pose> {
        match self.phase {
            Phase::Approach | Phase::Poise => Some(self.poise_pose(scene)),
            Phase::Descend => Some(self.grasp_pose(scene)),
            Phase::Close | Phase::Lift | Phase::Hold | Phase::Open | Phase::Retreat => None,
        }
    }

    /// What has happened at this step, if anything.
    fn event(&mut self, now: TimeNs, motion: &Motion, scene: &SceneState) -> Option<Event> {
        let overdue_s = motion.overdue_s(now);
        if scene.grasp.both_touch {
            self.untouched_steps = 0;
        } else {
            self.untouched_steps += 1;
        }
        let settled = self.settled(motion, scene) || overdue_s > ARRIVED_PATIENCE_S;
        match self.phase {
            Phase::Approach | Phase::Poise | Phase::Retreat => {
                (overdue_s >= 0.0).then_some(Event::Arrived)
            }
            Phase::Descend => (overdue_s >= 0.0 && settled).then_some(Event::Arrived),
            Phase::Open => (overdue_s >= REOPEN_S).then_some(Event::Arrived),
            Phase::Close if overdue_s < self.style.settle_s => None,
            Phase::Close if scene.grasp.both_touch => Some(Event::Gripped),
            Phase::Close => (overdue_s > GRIP_PATIENCE_S).then_some(Event::Lost),
            Phase::Lift | Phase::Hold if self.untouched_steps >= LOST_STEPS => Some(Event::Lost),
            Phase::Lift => (overdue_s >= 0.0).then_some(Event::Arrived),
            Phase::Hold => None,
        }
    }

    /// Whether the measured tip is where the motion ends.
    fn settled(&self, motion: &Motion, scene: &SceneState) -> bool {
        let tip = (self.scene_from_rcm * scene.tip_in_rcm).translation.vector;
        (tip - motion.end().tip_in_scene.translation.vector).norm() < ARRIVED_M
    }

    /// The pose to wait in above the needle.
    fn poise_pose(&self, scene: &SceneState) -> Pose {
        let lift = Vector3::z() * self.style.poise_height_m + self.style.poise_offset_m;
        Translation3::from(lift) * self.grasp_pose(scene)
    }

    /// The pose of the control point in which closing the jaw grips the wire at the middle of its arc.
    ///
    /// The tool points straight down and opens across the wire; the finger tips stay clear of the organ.
    fn grasp_pose(&self, scene: &SceneState) -> Pose {
        let needle_in_scene = self.scene_from_rcm * scene.needle_in_rcm;
        let tangent = needle_in_scene * Vector3::y();
        // Of the two ways to lay the jaw across the wire, the one nearer to the home rotation.
        let mut yaw = (-tangent.x).atan2(tangent.y);
        if yaw.abs() > core::f64::consts::FRAC_PI_2 {
            yaw -= core::f64::consts::PI.copysign(yaw);
        }
        let rotation = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), yaw) * straight_down();
        let middle = needle_in_scene * Point3::new(self.needle.arc_radius_m, 0.0, 0.0);
        let grasp = middle + tangent * self.style.along_m;
        let floor = self.floor_m(&grasp, &(rotation * Vector3::y()));
        let tip_z = floor.max(grasp.z - self.needle.wire_radius_m) + TIP_CLEARANCE_M;
        Pose::from_parts(
            Translation3::new(grasp.x, grasp.y, tip_z + hal::psm::FINGER_M),
            rotation,
        )
    }

    /// The highest point of the organ under the closed fingers, m; open, their tips are higher than closed.
    fn floor_m(&self, grasp: &Point3<f64>, opening: &Vector3<f64>) -> f64 {
        [-FINGER_REACH_M, 0.0, FINGER_REACH_M]
            .into_iter()
            .map(|reach_m| grasp + opening * reach_m)
            .map(|point| self.organ.height_m(point.x, point.y))
            .fold(f64::NEG_INFINITY, f64::max)
    }
}

/// `placement`, higher by `height_m`.
fn raised(placement: Placement, height_m: f64) -> Placement {
    Placement {
        tip_in_scene: Translation3::new(0.0, 0.0, height_m) * placement.tip_in_scene,
        ..placement
    }
}

/// The tip rotation at home: approach along -z of the scene, jaw opening along x.
fn straight_down() -> UnitQuaternion<f64> {
    let columns = Matrix3::from_columns(&[Vector3::y(), Vector3::x(), -Vector3::z()]);
    UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(columns))
}
