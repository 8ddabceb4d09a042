//! Needle lift: grips the needle at the middle of its arc, wherever it lies, and lifts it.
//!
//! It follows the needle if that moves, and starts over when the fingers closed on nothing or the needle slipped out.

mod phase;
mod style;

use hal::{Pose, TimeNs, TipTarget};
use nalgebra::{Translation3, Vector3};

use super::hand::{ARRIVED_PATIENCE_S, raised, settled};
use super::motion::{Motion, Placement};
use super::wire::wire_grasp;
use super::{Script, Wish};
use crate::needle::NeedleShape;
use crate::organ::OrganShape;
use crate::rng::Rng;
use crate::simulation::SceneState;
use crate::task::TaskConfig;
use crate::task::needle_lift::NeedleLift;
use phase::{Event, Phase};
use style::Style;

/// A step's share of following a moving needle, m and rad.
const FOLLOW_STEP_M: f64 = 0.0008;
const FOLLOW_STEP_RAD: f64 = 0.04;

/// How long to wait for both fingers after the jaw's motion has ended, s.
const GRIP_PATIENCE_S: f64 = 0.5;

/// Steps without touch by both fingers after which the needle counts as lost.
const LOST_STEPS: u32 = 4;

/// Time to rest with an open jaw after a failed attempt, s.
const REOPEN_S: f64 = 0.3;

/// How much higher than success asks for to lift at least, m.
const SPARE_LIFT_M: f64 = 0.010;

/// The script of the needle lift.
#[derive(Clone, Debug)]
pub(super) struct Lifter {
    needle: NeedleShape,
    organ: OrganShape,
    /// How far to lift at least, m.
    lift_m_min: f64,
    scene_from_rcm: Pose,
    rng: Rng,
    style: Style,
    phase: Phase,
    motion: Option<Motion>,
    attempts: u32,
    untouched_steps: u32,
}

impl Script for Lifter {
    fn step(&mut self, now: TimeNs, scene: &SceneState) -> Wish {
        let start = Placement {
            tip_in_scene: self.scene_from_rcm * scene.first.tip_in_rcm,
            jaw: scene.first.jaw,
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
        Wish {
            first: TipTarget::new(&tip_in_rcm, placement.jaw),
            second: None,
        }
    }

    fn attempts(&self) -> u32 {
        self.attempts
    }
}

impl Lifter {
    pub(super) fn new(task: &TaskConfig, lift: &NeedleLift, seed: u64) -> Self {
        let mut rng = Rng::stream(seed, "expert");
        let style = Style::draw(&mut rng);
        Self {
            needle: lift.needle,
            organ: lift.organ,
            lift_m_min: lift.success.lift_height_m + SPARE_LIFT_M,
            scene_from_rcm: task.arms[0].scene_from_rcm,
            rng,
            style,
            phase: Phase::Approach,
            motion: None,
            attempts: 1,
            untouched_steps: 0,
        }
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
                raised(from, style.lift_height_m.max(self.lift_m_min)),
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
        if scene.first.grasp.both_touch {
            self.untouched_steps = 0;
        } else {
            self.untouched_steps += 1;
        }
        let tip_in_scene = self.scene_from_rcm * scene.first.tip_in_rcm;
        let settled = settled(motion, &tip_in_scene) || overdue_s > ARRIVED_PATIENCE_S;
        match self.phase {
            Phase::Approach | Phase::Poise | Phase::Retreat => {
                (overdue_s >= 0.0).then_some(Event::Arrived)
            }
            Phase::Descend => (overdue_s >= 0.0 && settled).then_some(Event::Arrived),
            Phase::Open => (overdue_s >= REOPEN_S).then_some(Event::Arrived),
            Phase::Close if overdue_s < self.style.settle_s => None,
            Phase::Close if scene.first.grasp.both_touch => Some(Event::Gripped),
            Phase::Close => (overdue_s > GRIP_PATIENCE_S).then_some(Event::Lost),
            Phase::Lift | Phase::Hold if self.untouched_steps >= LOST_STEPS => Some(Event::Lost),
            Phase::Lift => (overdue_s >= 0.0).then_some(Event::Arrived),
            Phase::Hold => None,
        }
    }

    /// The pose to wait in above the needle.
    fn poise_pose(&self, scene: &SceneState) -> Pose {
        let lift = Vector3::z() * self.style.poise_height_m + self.style.poise_offset_m;
        Translation3::from(lift) * self.grasp_pose(scene)
    }

    /// The pose in which closing the jaw grips the wire near the middle of its arc.
    fn grasp_pose(&self, scene: &SceneState) -> Pose {
        let needle_in_scene = self.scene_from_rcm * scene.first.thing_in_rcm;
        let height_m = |x, y| self.organ.height_m(x, y);
        wire_grasp(&self.needle, &needle_in_scene, self.style.along_m, height_m)
    }
}
