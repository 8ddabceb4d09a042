//! Needle lift: grips the needle at the middle of its arc, wherever it lies, and lifts it.
//!
//! It follows the needle if that moves, and starts over when the fingers closed on nothing or the
//! needle slipped out.

mod phase;
mod style;

use hal::{Pose, TimeNs};
use nalgebra::{Translation3, Vector3};
use trocar_world::needle::NeedleShape;
use trocar_world::organ::Organ;

use super::NeedleLift;
use crate::script::alone::View;
use crate::script::hand::{ARRIVED_PATIENCE_S, raised, settled};
use crate::script::motion::{Motion, Placement};
use crate::script::play::{Activity, Event, Hand, Part};
use crate::script::wire::wire_grasp;
use phase::Phase;
use style::Style;

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
    organ: Organ,
    /// How far to lift at least, m.
    lift_m_min: f64,
}

impl Part for Lifter {
    type Habits = Style;
    type Stage = Phase;
    type View = View;

    fn carries(_hand: &Hand<Self>) -> bool {
        false
    }

    fn activity(hand: &Hand<Self>) -> Activity {
        match hand.phase {
            Phase::Approach | Phase::Poise => Activity::Reach,
            Phase::Descend | Phase::Close => Activity::Grasp,
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
        let lift_m = style.lift_height_m.max(hand.part.lift_m_min);
        let (to, bow_m, pace) = match hand.phase {
            Phase::Approach => (open(hand.poise_pose(view)), style.bow_m, style.approach),
            Phase::Poise => return Motion::rest(from, now, style.poise_s),
            Phase::Descend => (open(hand.grasp_pose(view)), straight, style.descend),
            Phase::Close => (jaw(style.grip_rad), straight, style.close),
            Phase::Lift => (raised(from, lift_m), straight, style.lift),
            Phase::Hold => return Motion::rest(from, now, 0.0),
            Phase::Open => (jaw(style.open_rad), straight, style.close),
            Phase::Retreat => (raised(from, style.poise_height_m), straight, style.descend),
        };
        Motion::new(from, to, bow_m, now, pace)
    }

    fn moving_goal(hand: &Hand<Self>, view: &View) -> Option<Pose> {
        match hand.phase {
            Phase::Approach | Phase::Poise => Some(hand.poise_pose(view)),
            Phase::Descend => Some(hand.grasp_pose(view)),
            Phase::Close | Phase::Lift | Phase::Hold | Phase::Open | Phase::Retreat => None,
        }
    }

    fn event(hand: &Hand<Self>, now: TimeNs, motion: &Motion, view: &View) -> Option<Event> {
        let overdue_s = motion.overdue_s(now);
        let settled = settled(motion, &view.arm.tip) || overdue_s > ARRIVED_PATIENCE_S;
        match hand.phase {
            Phase::Approach | Phase::Poise | Phase::Retreat => {
                (overdue_s >= 0.0).then_some(Event::Arrived)
            }
            Phase::Descend => (overdue_s >= 0.0 && settled).then_some(Event::Arrived),
            Phase::Open => (overdue_s >= REOPEN_S).then_some(Event::Arrived),
            Phase::Close if overdue_s < hand.style.settle_s => None,
            Phase::Close if view.arm.both_touch => Some(Event::Gripped),
            Phase::Close => (overdue_s > GRIP_PATIENCE_S).then_some(Event::Lost),
            Phase::Lift | Phase::Hold if hand.has_lost(LOST_STEPS) => Some(Event::Lost),
            Phase::Lift => (overdue_s >= 0.0).then_some(Event::Arrived),
            Phase::Hold => None,
        }
    }
}

impl Lifter {
    /// The part in the script of a scene.
    pub(super) fn new(lift: &NeedleLift) -> Self {
        Self {
            needle: lift.needle,
            organ: lift.organ.clone(),
            lift_m_min: lift.success.lift_height_m + SPARE_LIFT_M,
        }
    }
}

impl Hand<Lifter> {
    /// The pose to wait in above the needle.
    fn poise_pose(&self, view: &View) -> Pose {
        let lift = Vector3::z() * self.style.poise_height_m + self.style.poise_offset_m;
        Translation3::from(lift) * self.grasp_pose(view)
    }

    /// The pose in which closing the jaw grips the wire near the middle of its arc.
    fn grasp_pose(&self, view: &View) -> Pose {
        let height_m = |x, y| self.part.organ.height_m(x, y);
        wire_grasp(&self.part.needle, &view.thing, self.style.along_m, height_m)
    }
}

#[cfg(test)]
mod tests;
