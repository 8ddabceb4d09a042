//! The hand that takes the needle from the organ and presents it.

use hal::{Pose, TimeNs};
use nalgebra::{Translation3, Vector3};

use super::{GRIP_PATIENCE_S, LOST_STEPS, REOPEN_S, Style, View};
use crate::script::hand::{ARRIVED_PATIENCE_S, raised, settled};
use crate::script::motion::{Motion, Placement};
use crate::script::play::{Activity, Event, Grasp, Hand, Part, Stage, Transition};
use crate::script::wire::wire_hold;

/// What the giver is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// On the way to above the needle, opening the jaw. Follows the needle, and ends when the
    /// motion is over.
    Approach,
    /// Going down to the needle, jaw open. Ends when the motion is over and the tip within 0.6 mm
    /// of the grasp, or 0.6 s later wherever it is.
    Descend,
    /// Closing the jaw and waiting for a grip. Gripped once both fingers touch, no sooner than
    /// `Style::settle_s` after the motion; missed 0.5 s after it.
    Close,
    /// Lifting the needle off the organ. By 12 mm. From here to the release the needle is lost
    /// after four steps (160 ms) without touch by both fingers.
    Lift,
    /// Carrying it to where it is presented. Ends when the motion is over and the tip within 0.6 mm
    /// of its end, or 0.6 s later.
    Carry,
    /// Holding it there. Ends once the taker has gripped it.
    Present,
    /// Opening the jaw: the other hand has it. Ends 0.3 s after the motion.
    Release,
    /// Going up and outwards. Outwards is +x of the scene; `Style::away_m` says how far.
    Withdraw,
    /// Staying there. Ends if the taker waits and holds nothing: the needle has fallen, and is
    /// fetched again.
    Rest,
    /// Opening the jaw after a missed or lost grip. Ends 0.3 s after the motion.
    Open,
    /// Rising before another attempt. Ends when the motion is over.
    Retreat,
}

impl Stage for Phase {
    const FIRST: Self = Self::Approach;

    const GRASP: [Transition<Self>; 5] = Grasp {
        enter: Self::Descend,
        close: Self::Close,
        gripped: Self::Lift,
        open: Self::Open,
        retreat: Self::Retreat,
        again: Self::Approach,
    }
    .transitions();

    const TRANSITIONS: &'static [Transition<Self>] = &[
        (Self::Approach, Event::Arrived, Self::Descend),
        (Self::Lift, Event::Arrived, Self::Carry),
        (Self::Lift, Event::Lost, Self::Open),
        (Self::Carry, Event::Arrived, Self::Present),
        (Self::Carry, Event::Lost, Self::Open),
        (Self::Present, Event::Lost, Self::Open),
        (Self::Present, Event::Taken, Self::Release),
        (Self::Release, Event::Arrived, Self::Withdraw),
        (Self::Withdraw, Event::Arrived, Self::Rest),
        (Self::Rest, Event::Free, Self::Approach),
    ];
}

/// The giver.
#[derive(Clone, Debug)]
pub(super) struct Giver;

impl Part for Giver {
    type Habits = Style;
    type Stage = Phase;
    type View = View;

    fn carries(hand: &Hand<Self>) -> bool {
        matches!(hand.phase, Phase::Lift | Phase::Carry | Phase::Present)
    }

    fn activity(hand: &Hand<Self>) -> Activity {
        match hand.phase {
            Phase::Approach => Activity::Reach,
            Phase::Descend | Phase::Close => Activity::Grasp,
            Phase::Lift => Activity::Lift,
            Phase::Carry => Activity::Carry,
            Phase::Present
            | Phase::Release
            | Phase::Withdraw
            | Phase::Rest
            | Phase::Open
            | Phase::Retreat => Activity::Other,
        }
    }

    fn tries_again(hand: &Hand<Self>, next: Phase) -> bool {
        next == Phase::Open || hand.phase == Phase::Rest
    }

    fn begin(hand: &mut Hand<Self>, now: TimeNs, from: Placement, view: &View) -> Motion {
        let style = &hand.style;
        let straight = Vector3::zeros();
        let open = |tip| from.with_tip(tip).with_jaw(style.open_rad);
        let held = |tip_in_scene| from.with_tip(tip_in_scene);
        let jaw = |jaw| from.with_jaw(jaw);
        let [outwards_m, up_m] = style.away_m;
        let away = Translation3::new(outwards_m, 0.0, up_m);
        let (to, bow_m, pace) = match hand.phase {
            Phase::Approach => (open(hand.poise_pose(view)), style.bow_m, style.approach),
            Phase::Descend => (open(hand.grasp_pose(view)), straight, style.descend),
            Phase::Close => (jaw(style.grip_rad), straight, style.close),
            Phase::Lift => (raised(from, 0.012), straight, style.carry),
            Phase::Carry => (held(hand.presenting(view)), straight, style.carry),
            Phase::Present | Phase::Rest => return Motion::rest(from, now, 0.0),
            Phase::Release | Phase::Open => (jaw(style.open_rad), straight, style.close),
            Phase::Withdraw => (held(away * from.tip_in_scene), straight, style.descend),
            Phase::Retreat => (raised(from, style.poise_height_m), straight, style.descend),
        };
        Motion::new(from, to, bow_m, now, pace)
    }

    fn moving_goal(hand: &Hand<Self>, view: &View) -> Option<Pose> {
        match hand.phase {
            Phase::Approach => Some(hand.poise_pose(view)),
            Phase::Descend => Some(hand.grasp_pose(view)),
            Phase::Carry if view.arm.both_touch => Some(hand.presenting(view)),
            Phase::Close
            | Phase::Lift
            | Phase::Carry
            | Phase::Present
            | Phase::Release
            | Phase::Withdraw
            | Phase::Rest
            | Phase::Open
            | Phase::Retreat => None,
        }
    }

    fn event(hand: &Hand<Self>, now: TimeNs, motion: &Motion, view: &View) -> Option<Event> {
        let overdue_s = motion.overdue_s(now);
        let lost = hand.has_lost(LOST_STEPS);
        let patient = overdue_s > ARRIVED_PATIENCE_S;
        match hand.phase {
            Phase::Lift | Phase::Carry | Phase::Present if lost => Some(Event::Lost),
            Phase::Approach | Phase::Lift | Phase::Withdraw | Phase::Retreat => {
                (overdue_s >= 0.0).then_some(Event::Arrived)
            }
            Phase::Descend | Phase::Carry => {
                let there = overdue_s >= 0.0 && settled(motion, &view.arm.tip);
                (there || patient).then_some(Event::Arrived)
            }
            Phase::Close if overdue_s < hand.style.settle_s => None,
            Phase::Close if view.arm.both_touch => Some(Event::Gripped),
            Phase::Close => (overdue_s > GRIP_PATIENCE_S).then_some(Event::Lost),
            Phase::Present => view.taken.then_some(Event::Taken),
            Phase::Rest => (view.idle && !view.taken).then_some(Event::Free),
            Phase::Release | Phase::Open => (overdue_s >= REOPEN_S).then_some(Event::Arrived),
        }
    }
}

impl Hand<Giver> {
    /// Whether the needle is held out for the other hand.
    pub(super) fn presents(&self) -> bool {
        self.phase == Phase::Present
    }

    /// Whether this hand has let go and is out of the way.
    pub(super) fn is_away(&self) -> bool {
        self.phase == Phase::Rest
    }

    /// The pose in which closing the jaw grips the wire on the side of the needle's point.
    fn grasp_pose(&self, view: &View) -> Pose {
        let style = &self.style;
        let hold = wire_hold(&view.shape, &view.needle, style.angle_rad, 0.0);
        view.above_organ(&hold)
    }

    /// The pose to wait in above the needle.
    fn poise_pose(&self, view: &View) -> Pose {
        Translation3::new(0.0, 0.0, self.style.poise_height_m) * self.grasp_pose(view)
    }

    /// The pose of the tip that brings the needle to where it is presented.
    fn presenting(&self, view: &View) -> Pose {
        let wanted = Translation3::from(self.style.presented_m) * view.presented;
        wanted * view.needle.inv_mul(&view.arm.tip)
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
