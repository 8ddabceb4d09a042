//! Tissue retraction: takes the flap by its free edge at the mark, one finger above it and one
//! under it, and lifts it.
//!
//! It follows the mark if that moves, and starts over when the fingers closed on nothing or beside
//! the mark, or when the flap slipped out.

mod phase;
mod style;

use hal::psm::FINGER_M;
use hal::{Pose, TimeNs};
use nalgebra::{Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

use super::TissueRetraction;
use crate::script::alone::View;
use crate::script::hand::{ARRIVED_PATIENCE_S, settled};
use crate::script::motion::{Motion, Placement};
use crate::script::play::{Activity, Event, Hand, Part};
use phase::Phase;
use style::Style;

/// How far the mark may be from the middle of the fingers along their hinge for the grasp to be
/// right, m.
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
}

impl Part for Retractor {
    type Habits = Style;
    type Stage = Phase;
    type View = View;

    fn carries(hand: &Hand<Self>) -> bool {
        matches!(hand.phase, Phase::Lift | Phase::Hold)
    }

    fn activity(hand: &Hand<Self>) -> Activity {
        match hand.phase {
            Phase::Approach => Activity::Reach,
            Phase::Enter | Phase::Close => Activity::Grasp,
            Phase::Lift => Activity::Lift,
            Phase::Hold | Phase::Open | Phase::Retreat => Activity::Other,
        }
    }

    fn tries_again(_hand: &Hand<Self>, next: Phase) -> bool {
        next == Phase::Open
    }

    fn begin(hand: &mut Hand<Self>, now: TimeNs, from: Placement, view: &View) -> Motion {
        let style = &hand.style;
        let straight = Vector3::zeros();
        let open = |tip| from.with_tip(tip).with_jaw(style.open_rad);
        let jaw = |jaw| from.with_jaw(jaw);
        let (to, bow_m, pace) = match hand.phase {
            Phase::Approach => (open(hand.poise_pose(view)), style.bow_m, style.approach),
            Phase::Enter => (open(hand.grasp_pose(view)), straight, style.enter),
            Phase::Close => (jaw(style.grip_rad), straight, style.close),
            Phase::Lift => {
                let inward = from.tip_in_scene.rotation * Vector3::z();
                let way = Vector3::z() + Vector3::new(inward.x, inward.y, 0.0) * style.lean;
                let lift = Translation3::from(way * style.lift_height_m.max(hand.part.lift_m_min));
                let lifted = from.with_tip(lift * from.tip_in_scene);
                (lifted, straight, style.lift)
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

    fn moving_goal(hand: &Hand<Self>, view: &View) -> Option<Pose> {
        match hand.phase {
            Phase::Approach => Some(hand.poise_pose(view)),
            Phase::Enter => Some(hand.grasp_pose(view)),
            Phase::Close | Phase::Lift | Phase::Hold | Phase::Open | Phase::Retreat => None,
        }
    }

    fn event(hand: &Hand<Self>, now: TimeNs, motion: &Motion, view: &View) -> Option<Event> {
        let overdue_s = motion.overdue_s(now);
        match hand.phase {
            Phase::Approach | Phase::Retreat => (overdue_s >= 0.0).then_some(Event::Arrived),
            Phase::Enter => {
                let settled = settled(motion, &view.arm.tip) || overdue_s > ARRIVED_PATIENCE_S;
                (overdue_s >= 0.0 && settled).then_some(Event::Arrived)
            }
            // Tissue held at the wrong place is let go at once.
            Phase::Close if view.arm.both_touch && !is_at_mark(view) => Some(Event::Lost),
            Phase::Close if overdue_s < hand.style.settle_s => None,
            Phase::Close if view.arm.both_touch => Some(Event::Gripped),
            Phase::Close => (overdue_s > HOLD_PATIENCE_S).then_some(Event::Lost),
            Phase::Lift | Phase::Hold if hand.has_lost(LOST_STEPS) => Some(Event::Lost),
            Phase::Lift => (overdue_s >= 0.0).then_some(Event::Arrived),
            Phase::Hold => None,
            Phase::Open => (overdue_s >= REOPEN_S).then_some(Event::Arrived),
        }
    }
}

impl Retractor {
    /// The part in the script of a scene.
    pub(super) fn new(scene: &TissueRetraction) -> Self {
        Self {
            thickness_m: scene.tissue.material.thickness_m,
            inset_m: scene.tissue.mark.inset_m,
            lift_m_min: scene.success.lift_height_m + SPARE_LIFT_M,
        }
    }
}

impl Hand<Retractor> {
    /// The pose to wait in before the edge.
    fn poise_pose(&self, view: &View) -> Pose {
        Translation3::from(self.style.poise_offset_m)
            * self.grasp_pose(view)
            * Translation3::new(0.0, 0.0, -self.style.poise_m)
    }

    /// The pose in which closing the jaw takes the edge at the mark: it points across the edge from
    /// outside, its hinge along the edge, the flap half way between the fingers.
    fn grasp_pose(&self, view: &View) -> Pose {
        let outward = view.thing.rotation * Vector3::y();
        let level = Vector3::new(-outward.x, -outward.y, 0.0);
        // A flap that hangs straight down has no direction to come from; then from the front.
        let inward = level.try_normalize(0.2).unwrap_or_else(Vector3::y);
        let hinge = inward.cross(&Vector3::z());
        let (sin, cos) = self.style.tilt_rad.sin_cos();
        let pointing = inward * cos - Vector3::z() * sin;
        let axes = Matrix3::from_columns(&[hinge, pointing.cross(&hinge), pointing]);
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
        let middle = view.thing.translation.vector
            - view.thing.rotation * Vector3::z() * (0.5 * self.part.thickness_m);
        let past_mark_m = (2.0 * self.style.over - 1.0) * self.part.inset_m;
        let ends = middle + inward * past_mark_m + hinge * self.style.along_m;
        Pose::from_parts((ends - pointing * FINGER_M).into(), rotation)
    }
}

/// Whether the mark is between the fingers.
fn is_at_mark(view: &View) -> bool {
    let beside_m = view.arm.tip.inv_mul(&view.thing).translation.x;
    beside_m.abs() <= BESIDE_M
}

#[cfg(test)]
mod tests;
