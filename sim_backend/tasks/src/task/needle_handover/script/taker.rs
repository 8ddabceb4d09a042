//! The hand that takes the needle out of the other one.

use hal::{Pose, TimeNs};
use nalgebra::{Translation3, Vector3};

use super::{GRIP_PATIENCE_S, LOST_STEPS, REOPEN_S, Style, View};
use crate::script::hand::{ARRIVED_PATIENCE_S, raised, settled};
use crate::script::motion::{Motion, Placement};
use crate::script::play::{Activity, Event, Grasp, Hand, Part, Stage, Transition};
use crate::script::wire::wire_hold;

/// What the taker is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// Waiting for the needle to be presented. Ends when the giver holds it out.
    Wait,
    /// On the way to above the needle, opening the jaw. Given up, as is the way down, when the
    /// giver does not present the needle any more.
    Approach,
    /// Going down to the needle, jaw open. Ends when the motion is over and the tip within 0.6 mm
    /// of the grasp, or 0.6 s later wherever it is.
    Descend,
    /// Closing the jaw and waiting for a grip. Gripped once both fingers touch, no sooner than
    /// `Style::settle_s` after the motion; missed 0.5 s after it. Goes on even if the giver loses
    /// the needle meanwhile.
    Close,
    /// Holding the needle until the other hand is gone. Ends when the giver rests, away from the
    /// needle. Lost after four steps (160 ms) without touch by both fingers.
    Keep,
    /// Taking the needle away. Outwards, -x of the scene, and up by `Style::away_m`. Ends when the
    /// motion is over.
    Take,
    /// Holding it there. Nothing but a loss ends it.
    Hold,
    /// Opening the jaw after a missed or lost grip. Ends 0.3 s after the motion.
    Open,
    /// Rising before another attempt. Then it waits for another offer.
    Retreat,
}

impl Stage for Phase {
    const FIRST: Self = Self::Wait;

    const GRASP: [Transition<Self>; 5] = Grasp {
        enter: Self::Descend,
        close: Self::Close,
        gripped: Self::Keep,
        open: Self::Open,
        retreat: Self::Retreat,
        again: Self::Wait,
    }
    .transitions();

    const TRANSITIONS: &'static [Transition<Self>] = &[
        (Self::Wait, Event::Offered, Self::Approach),
        (Self::Approach, Event::Arrived, Self::Descend),
        (Self::Approach, Event::Lost, Self::Retreat),
        (Self::Descend, Event::Lost, Self::Retreat),
        (Self::Keep, Event::Lost, Self::Open),
        (Self::Keep, Event::Given, Self::Take),
        (Self::Take, Event::Arrived, Self::Hold),
        (Self::Take, Event::Lost, Self::Open),
        (Self::Hold, Event::Lost, Self::Open),
    ];
}

/// The taker.
#[derive(Clone, Debug)]
pub(super) struct Taker;

impl Part for Taker {
    type Habits = Style;
    type Stage = Phase;
    type View = View;

    fn carries(hand: &Hand<Self>) -> bool {
        hand.holds()
    }

    fn activity(hand: &Hand<Self>) -> Activity {
        match hand.phase {
            Phase::Approach => Activity::Reach,
            Phase::Descend | Phase::Close => Activity::Grasp,
            Phase::Take => Activity::Carry,
            Phase::Wait | Phase::Keep | Phase::Hold | Phase::Open | Phase::Retreat => {
                Activity::Other
            }
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
        let [outwards_m, up_m] = style.away_m;
        let away = Translation3::new(-outwards_m, 0.0, up_m);
        let taken = from.with_tip(away * from.tip_in_scene);
        let (to, bow_m, pace) = match hand.phase {
            Phase::Wait | Phase::Keep | Phase::Hold => return Motion::rest(from, now, 0.0),
            Phase::Approach => (open(hand.poise_pose(view)), style.bow_m, style.approach),
            Phase::Descend => (open(hand.grasp_pose(view)), straight, style.descend),
            Phase::Close => (jaw(style.grip_rad), straight, style.close),
            Phase::Take => (taken, straight, style.carry),
            Phase::Open => (jaw(style.open_rad), straight, style.close),
            Phase::Retreat => (raised(from, style.poise_height_m), straight, style.descend),
        };
        Motion::new(from, to, bow_m, now, pace)
    }

    fn moving_goal(hand: &Hand<Self>, view: &View) -> Option<Pose> {
        match hand.phase {
            Phase::Approach => Some(hand.poise_pose(view)),
            Phase::Descend => Some(hand.grasp_pose(view)),
            Phase::Wait
            | Phase::Close
            | Phase::Keep
            | Phase::Take
            | Phase::Hold
            | Phase::Open
            | Phase::Retreat => None,
        }
    }

    fn event(hand: &Hand<Self>, now: TimeNs, motion: &Motion, view: &View) -> Option<Event> {
        let overdue_s = motion.overdue_s(now);
        let lost = hand.has_lost(LOST_STEPS);
        match hand.phase {
            Phase::Wait => view.offered.then_some(Event::Offered),
            Phase::Approach | Phase::Descend if !view.offered => Some(Event::Lost),
            Phase::Keep | Phase::Take | Phase::Hold if lost => Some(Event::Lost),
            Phase::Approach | Phase::Take | Phase::Retreat => {
                (overdue_s >= 0.0).then_some(Event::Arrived)
            }
            Phase::Descend => {
                let there = overdue_s >= 0.0 && settled(motion, &view.arm.tip);
                (there || overdue_s > ARRIVED_PATIENCE_S).then_some(Event::Arrived)
            }
            Phase::Close if overdue_s < hand.style.settle_s => None,
            Phase::Close if view.arm.both_touch => Some(Event::Gripped),
            Phase::Close => (overdue_s > GRIP_PATIENCE_S).then_some(Event::Lost),
            Phase::Keep => view.given.then_some(Event::Given),
            Phase::Hold => None,
            Phase::Open => (overdue_s >= REOPEN_S).then_some(Event::Arrived),
        }
    }
}

impl Hand<Taker> {
    /// Whether the needle is in this hand.
    pub(super) fn holds(&self) -> bool {
        matches!(self.phase, Phase::Keep | Phase::Take | Phase::Hold)
    }

    /// Whether this hand waits for the needle.
    pub(super) fn is_idle(&self) -> bool {
        self.phase == Phase::Wait
    }

    /// The pose in which closing the jaw grips the wire on the side of the needle's blunt end.
    fn grasp_pose(&self, view: &View) -> Pose {
        let style = &self.style;
        wire_hold(&view.shape, &view.needle, -style.angle_rad, style.beyond_m)
    }

    /// The pose to wait in above the needle.
    fn poise_pose(&self, view: &View) -> Pose {
        Translation3::new(0.0, 0.0, self.style.poise_height_m) * self.grasp_pose(view)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::script::play::check_transitions;

    #[test]
    fn transitions_are_whole() {
        check_transitions(None::<Phase>);
    }
}
