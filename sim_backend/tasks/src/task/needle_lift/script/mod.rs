//! Needle lift: grips the needle at the middle of its arc, wherever it lies, and lifts it.
//!
//! It follows the needle if that moves, and starts over when the fingers closed on nothing or the needle slipped out.

mod phase;
mod style;

use hal::{Pose, TimeNs};
use nalgebra::{Translation3, Vector3};
use trocar_world::needle::NeedleShape;
use trocar_world::organ::OrganShape;
use trocar_world::rng::Rng;

use super::NeedleLift;
use crate::script::alone::View;
use crate::script::hand::{ARRIVED_PATIENCE_S, raised, settled};
use crate::script::motion::{Motion, Placement};
use crate::script::play::{Activity, ArmView, Event, Hand, Part};
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
    organ: OrganShape,
    /// How far to lift at least, m.
    lift_m_min: f64,
    hand: Hand<Style, Phase>,
}

impl Part for Lifter {
    type Habits = Style;
    type Stage = Phase;
    type View = View;

    fn hand(&self) -> &Hand<Style, Phase> {
        &self.hand
    }

    fn hand_mut(&mut self) -> &mut Hand<Style, Phase> {
        &mut self.hand
    }

    fn own(view: &View) -> &ArmView {
        &view.arm
    }

    fn carries(&self) -> bool {
        false
    }

    fn activity(&self) -> Activity {
        match self.hand.phase {
            Phase::Approach | Phase::Poise => Activity::Reach,
            Phase::Descend | Phase::Close => Activity::Grasp,
            Phase::Lift => Activity::Lift,
            Phase::Hold | Phase::Open | Phase::Retreat => Activity::Other,
        }
    }

    fn tries_again(&self, next: Phase) -> bool {
        next == Phase::Open
    }

    fn begin(&mut self, now: TimeNs, from: Placement, view: &View) -> Motion {
        let style = &self.hand.style;
        let straight = Vector3::zeros();
        match self.hand.phase {
            Phase::Approach => {
                let to = Placement {
                    tip_in_scene: self.poise_pose(view),
                    jaw: style.open_rad,
                };
                Motion::new(from, to, style.bow_m, now, style.approach)
            }
            Phase::Poise => Motion::rest(from, now, style.poise_s),
            Phase::Descend => {
                let to = Placement {
                    tip_in_scene: self.grasp_pose(view),
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

    fn moving_goal(&self, view: &View) -> Option<Pose> {
        match self.hand.phase {
            Phase::Approach | Phase::Poise => Some(self.poise_pose(view)),
            Phase::Descend => Some(self.grasp_pose(view)),
            Phase::Close | Phase::Lift | Phase::Hold | Phase::Open | Phase::Retreat => None,
        }
    }

    fn event(&self, now: TimeNs, motion: &Motion, view: &View) -> Option<Event> {
        let overdue_s = motion.overdue_s(now);
        let settled = settled(motion, &view.arm.tip) || overdue_s > ARRIVED_PATIENCE_S;
        match self.hand.phase {
            Phase::Approach | Phase::Poise | Phase::Retreat => {
                (overdue_s >= 0.0).then_some(Event::Arrived)
            }
            Phase::Descend => (overdue_s >= 0.0 && settled).then_some(Event::Arrived),
            Phase::Open => (overdue_s >= REOPEN_S).then_some(Event::Arrived),
            Phase::Close if overdue_s < self.hand.style.settle_s => None,
            Phase::Close if view.arm.both_touch => Some(Event::Gripped),
            Phase::Close => (overdue_s > GRIP_PATIENCE_S).then_some(Event::Lost),
            Phase::Lift | Phase::Hold if self.hand.has_lost(LOST_STEPS) => Some(Event::Lost),
            Phase::Lift => (overdue_s >= 0.0).then_some(Event::Arrived),
            Phase::Hold => None,
        }
    }
}

impl Lifter {
    /// The script at the start of the episode `seed`.
    pub(super) fn new(lift: &NeedleLift, seed: u64) -> Self {
        Self {
            needle: lift.needle,
            organ: lift.organ,
            lift_m_min: lift.success.lift_height_m + SPARE_LIFT_M,
            hand: Hand::new(Rng::stream(seed, "expert")),
        }
    }

    /// The pose to wait in above the needle.
    fn poise_pose(&self, view: &View) -> Pose {
        let lift = Vector3::z() * self.hand.style.poise_height_m + self.hand.style.poise_offset_m;
        Translation3::from(lift) * self.grasp_pose(view)
    }

    /// The pose in which closing the jaw grips the wire near the middle of its arc.
    fn grasp_pose(&self, view: &View) -> Pose {
        let height_m = |x, y| self.organ.height_m(x, y);
        wire_grasp(&self.needle, &view.thing, self.hand.style.along_m, height_m)
    }
}

#[cfg(test)]
mod tests;
