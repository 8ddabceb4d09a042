//! Tissue retraction: takes the flap by its free edge at the mark, one finger above it and one under it, and lifts it.
//!
//! It follows the mark if that moves, and starts over when the fingers closed on nothing or beside the mark, or when the
//! flap slipped out.

mod phase;
mod style;

use hal::psm::FINGER_M;
use hal::{Pose, TimeNs, TipTarget};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::hand::{ARRIVED_PATIENCE_S, settled};
use super::motion::{Motion, Placement};
use super::{Script, Wish, arrive, carry};
use crate::rng::Rng;
use crate::simulation::SceneState;
use crate::task::TaskConfig;
use crate::task::tissue_retraction::TissueRetraction;
use phase::{Event, Phase};
use style::Style;

/// A step's share of following a moving mark, m and rad.
const FOLLOW_STEP_M: f64 = 0.000_8;
const FOLLOW_STEP_RAD: f64 = 0.04;

/// How far the mark may be from the middle of the fingers along their hinge for the grasp to be right, m.
const BESIDE_M: f64 = 0.003_5;

/// How long to wait for a hold after the jaw's motion has ended, s.
const HOLD_PATIENCE_S: f64 = 0.3;

/// Steps without a hold after which the flap counts as lost.
const LOST_STEPS: u32 = 3;

/// Time to rest with an open jaw after a failed attempt, s: the flap falls back.
const REOPEN_S: f64 = 0.4;

/// How much higher than success asks for to lift at least, m.
const SPARE_LIFT_M: f64 = 0.003;

/// The script of the tissue retraction.
#[derive(Clone, Debug)]
pub(super) struct Retractor {
    thickness_m: f64,
    inset_m: f64,
    /// How far to lift at least, m.
    lift_m_min: f64,
    scene_from_rcm: Pose,
    rng: Rng,
    style: Style,
    phase: Phase,
    motion: Option<Motion>,
    attempts: u32,
    loose_steps: u32,
}

/// What the script sees, in the scene frame.
struct View {
    tip: Pose,
    /// On the flap's upper face, x along the free edge, z out of the tissue.
    mark: Pose,
    held: bool,
}

impl Script for Retractor {
    fn step(&mut self, now: TimeNs, scene: &SceneState) -> Wish {
        let view = View {
            tip: self.scene_from_rcm * scene.first.tip_in_rcm,
            mark: self.scene_from_rcm * scene.first.thing_in_rcm,
            held: scene.first.grasp.both_touch,
        };
        let start = Placement {
            tip_in_scene: view.tip,
            jaw: scene.first.jaw,
        };
        let mut motion = self.motion.unwrap_or_else(|| self.begin(now, start, &view));
        if let Some(goal) = self.moving_goal(&view) {
            motion.drift_end(&goal, FOLLOW_STEP_M, FOLLOW_STEP_RAD);
        }
        if let Some(event) = self.event(now, &motion, &view) {
            let next = self.phase.next(event);
            if next != self.phase {
                self.enter(next);
                motion = self.begin(now, motion.at(now), &view);
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

    fn foresee(&self, scene: &mut SceneState, wish: &Wish) {
        let carries = matches!(self.phase, Phase::Lift | Phase::Hold);
        if carries && scene.first.grasp.both_touch {
            carry(&mut scene.first, &wish.first);
        } else {
            arrive(&mut scene.first, &wish.first);
        }
    }
}

impl Retractor {
    pub(super) fn new(task: &TaskConfig, scene: &TissueRetraction, seed: u64) -> Self {
        let mut rng = Rng::stream(seed, "expert");
        let style = Style::draw(&mut rng);
        Self {
            thickness_m: scene.tissue.material.thickness_m,
            inset_m: scene.tissue.mark.inset_m,
            lift_m_min: scene.success.lift_height_m + SPARE_LIFT_M,
            scene_from_rcm: task.arms[0].scene_from_rcm,
            rng,
            style,
            phase: Phase::Approach,
            motion: None,
            attempts: 1,
            loose_steps: 0,
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
        self.loose_steps = 0;
    }

    /// The motion of the present phase.
    fn begin(&self, now: TimeNs, from: Placement, view: &View) -> Motion {
        let style = &self.style;
        let straight = Vector3::zeros();
        let open = |tip_in_scene| Placement {
            tip_in_scene,
            jaw: style.open_rad,
        };
        let jaw = |jaw| Placement { jaw, ..from };
        let (to, bow_m, pace) = match self.phase {
            Phase::Approach => (open(self.poise_pose(view)), style.bow_m, style.approach),
            Phase::Enter => (open(self.grasp_pose(view)), straight, style.enter),
            Phase::Close => (jaw(style.grip_rad), straight, style.close),
            Phase::Lift => {
                let inward = from.tip_in_scene.rotation * Vector3::z();
                let way = Vector3::z() + Vector3::new(inward.x, inward.y, 0.0) * style.lean;
                let lift = Translation3::from(way * style.lift_height_m.max(self.lift_m_min));
                let to = Placement {
                    tip_in_scene: lift * from.tip_in_scene,
                    ..from
                };
                (to, straight, style.lift)
            }
            Phase::Hold => return Motion::rest(from, now, 0.0),
            Phase::Open => (jaw(style.open_rad), straight, style.close),
            Phase::Retreat => {
                let out = from.tip_in_scene * Translation3::new(0.0, 0.0, -style.poise_m);
                (open(out), straight, style.enter)
            }
        };
        Motion::new(from, to, bow_m, now, pace)
    }

    /// The goal of a phase that follows the mark.
    fn moving_goal(&self, view: &View) -> Option<Pose> {
        match self.phase {
            Phase::Approach => Some(self.poise_pose(view)),
            Phase::Enter => Some(self.grasp_pose(view)),
            Phase::Close | Phase::Lift | Phase::Hold | Phase::Open | Phase::Retreat => None,
        }
    }

    /// What has happened at this step, if anything.
    fn event(&mut self, now: TimeNs, motion: &Motion, view: &View) -> Option<Event> {
        let overdue_s = motion.overdue_s(now);
        self.loose_steps = if view.held { 0 } else { self.loose_steps + 1 };
        match self.phase {
            Phase::Approach | Phase::Retreat => (overdue_s >= 0.0).then_some(Event::Arrived),
            Phase::Enter => {
                let settled = settled(motion, &view.tip) || overdue_s > ARRIVED_PATIENCE_S;
                (overdue_s >= 0.0 && settled).then_some(Event::Arrived)
            }
            // Tissue held at the wrong place is let go at once.
            Phase::Close if view.held && !is_at_mark(view) => Some(Event::Lost),
            Phase::Close if overdue_s < self.style.settle_s => None,
            Phase::Close if view.held => Some(Event::Held),
            Phase::Close => (overdue_s > HOLD_PATIENCE_S).then_some(Event::Lost),
            Phase::Lift | Phase::Hold if self.loose_steps >= LOST_STEPS => Some(Event::Lost),
            Phase::Lift => (overdue_s >= 0.0).then_some(Event::Arrived),
            Phase::Hold => None,
            Phase::Open => (overdue_s >= REOPEN_S).then_some(Event::Arrived),
        }
    }

    /// The pose to wait in before the edge.
    fn poise_pose(&self, view: &View) -> Pose {
        Translation3::from(self.style.poise_offset_m)
            * self.grasp_pose(view)
            * Translation3::new(0.0, 0.0, -self.style.poise_m)
    }

    /// The pose in which closing the jaw takes the edge at the mark: it points across the edge from outside, its hinge
    /// along the edge, the flap half way between the fingers.
    fn grasp_pose(&self, view: &View) -> Pose {
        let outward = view.mark.rotation * Vector3::y();
        let level = Vector3::new(-outward.x, -outward.y, 0.0);
        // A flap that hangs straight down has no direction to come from; then from the front.
        let inward = level.try_normalize(0.2).unwrap_or_else(Vector3::y);
        let hinge = inward.cross(&Vector3::z());
        let (sin, cos) = self.style.tilt_rad.sin_cos();
        let pointing = inward * cos - Vector3::z() * sin;
        let axes = Matrix3::from_columns(&[hinge, pointing.cross(&hinge), pointing]);
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let middle = view.mark.translation.vector
            - view.mark.rotation * Vector3::z() * (0.5 * self.thickness_m);
        let past_mark_m = (2.0 * self.style.over - 1.0) * self.inset_m;
        let ends = middle + inward * past_mark_m + hinge * self.style.along_m;
        Pose::from_parts((ends - pointing * FINGER_M).into(), rotation)
    }
}

/// Whether the mark is between the fingers.
fn is_at_mark(view: &View) -> bool {
    let beside_m = view.tip.inv_mul(&view.mark).translation.x;
    beside_m.abs() <= BESIDE_M
}
