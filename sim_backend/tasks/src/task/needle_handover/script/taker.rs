//! The hand that takes the needle out of the other one.

use hal::{Pose, TimeNs};
use nalgebra::{Translation3, Vector3};
use trocar_world::rng::Rng;

use super::{GRIP_PATIENCE_S, LOST_STEPS, REOPEN_S, Style, View};
use crate::script::hand::{ARRIVED_PATIENCE_S, raised, settled};
use crate::script::motion::{Motion, Placement};
use crate::script::play::{Activity, ArmView, Hand, Part, Stage};
use crate::script::wire::wire_hold;

/// What the taker is doing.
///
/// | phase    | Offered  | Arrived | Gripped | Lost    | Given |
/// |----------|----------|---------|---------|---------|-------|
/// | Wait     | Approach |         |         |         |       |
/// | Approach |          | Descend |         | Retreat |       |
/// | Descend  |          | Close   |         | Retreat |       |
/// | Close    |          |         | Keep    | Open    |       |
/// | Keep     |          |         |         | Open    | Take  |
/// | Take     |          | Hold    |         | Open    |       |
/// | Hold     |          |         |         | Open    |       |
/// | Open     |          | Retreat |         |         |       |
/// | Retreat  |          | Wait    |         |         |       |
///
/// An empty cell stays in the phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// Waiting for the needle to be presented.
    Wait,
    /// On the way to above the needle, opening the jaw.
    Approach,
    /// Going down to the needle, jaw open.
    Descend,
    /// Closing the jaw and waiting for a grip.
    Close,
    /// Holding the needle until the other hand is gone.
    Keep,
    /// Taking the needle away.
    Take,
    /// Holding it there.
    Hold,
    /// Opening the jaw after a missed or lost grip.
    Open,
    /// Rising before another attempt.
    Retreat,
}

/// What happened in a phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// The needle is presented.
    Offered,
    /// The motion ended and the arm is where it was to be, or will not get closer.
    Arrived,
    /// Both fingers hold the needle.
    Gripped,
    /// The needle is not presented any more, not in the jaw, or slipped out of it.
    Lost,
    /// The other hand has let go and is gone.
    Given,
}

impl Stage for Phase {
    type Event = Event;

    const FIRST: Self = Self::Wait;

    fn next(self, event: Event) -> Self {
        match (self, event) {
            (Self::Wait, Event::Offered) => Self::Approach,
            (Self::Approach, Event::Arrived) => Self::Descend,
            (Self::Descend, Event::Arrived) => Self::Close,
            (Self::Close, Event::Gripped) => Self::Keep,
            (Self::Keep, Event::Given) => Self::Take,
            (Self::Take, Event::Arrived) => Self::Hold,
            (Self::Approach | Self::Descend, Event::Lost) | (Self::Open, Event::Arrived) => {
                Self::Retreat
            }
            (Self::Close | Self::Keep | Self::Take | Self::Hold, Event::Lost) => Self::Open,
            (Self::Retreat, Event::Arrived) => Self::Wait,
            (_, Event::Offered | Event::Arrived | Event::Gripped | Event::Lost | Event::Given) => {
                self
            }
        }
    }
}

/// The taker.
#[derive(Clone, Debug)]
pub(super) struct Taker {
    hand: Hand<Style, Phase>,
}

impl Part for Taker {
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
        &view.taker
    }

    fn carries(&self) -> bool {
        self.holds()
    }

    fn activity(&self) -> Activity {
        match self.hand.phase {
            Phase::Approach => Activity::Reach,
            Phase::Descend | Phase::Close => Activity::Grasp,
            Phase::Take => Activity::Carry,
            Phase::Wait | Phase::Keep | Phase::Hold | Phase::Open | Phase::Retreat => {
                Activity::Other
            }
        }
    }

    fn tries_again(&self, next: Phase) -> bool {
        next == Phase::Open
    }

    fn begin(&mut self, now: TimeNs, from: Placement, view: &View) -> Motion {
        let style = &self.hand.style;
        let straight = Vector3::zeros();
        let open = |tip_in_scene| Placement {
            tip_in_scene,
            jaw: style.open_rad,
        };
        let jaw = |jaw| Placement { jaw, ..from };
        let [outwards_m, up_m] = style.away_m;
        let taken = Placement {
            tip_in_scene: Translation3::new(-outwards_m, 0.0, up_m) * from.tip_in_scene,
            ..from
        };
        let (to, bow_m, pace) = match self.hand.phase {
            Phase::Wait | Phase::Keep | Phase::Hold => return Motion::rest(from, now, 0.0),
            Phase::Approach => (open(self.poise_pose(view)), style.bow_m, style.approach),
            Phase::Descend => (open(self.grasp_pose(view)), straight, style.descend),
            Phase::Close => (jaw(style.grip_rad), straight, style.close),
            Phase::Take => (taken, straight, style.carry),
            Phase::Open => (jaw(style.open_rad), straight, style.close),
            Phase::Retreat => (raised(from, style.poise_height_m), straight, style.descend),
        };
        Motion::new(from, to, bow_m, now, pace)
    }

    fn moving_goal(&self, view: &View) -> Option<Pose> {
        match self.hand.phase {
            Phase::Approach => Some(self.poise_pose(view)),
            Phase::Descend => Some(self.grasp_pose(view)),
            Phase::Wait
            | Phase::Close
            | Phase::Keep
            | Phase::Take
            | Phase::Hold
            | Phase::Open
            | Phase::Retreat => None,
        }
    }

    fn event(&self, now: TimeNs, motion: &Motion, view: &View) -> Option<Event> {
        let overdue_s = motion.overdue_s(now);
        let hand = &self.hand;
        let lost = hand.has_lost(LOST_STEPS);
        match self.hand.phase {
            Phase::Wait => view.offered.then_some(Event::Offered),
            Phase::Approach | Phase::Descend if !view.offered => Some(Event::Lost),
            Phase::Keep | Phase::Take | Phase::Hold if lost => Some(Event::Lost),
            Phase::Approach | Phase::Take | Phase::Retreat => {
                (overdue_s >= 0.0).then_some(Event::Arrived)
            }
            Phase::Descend => {
                let there = overdue_s >= 0.0 && settled(motion, &view.taker.tip);
                (there || overdue_s > ARRIVED_PATIENCE_S).then_some(Event::Arrived)
            }
            Phase::Close if overdue_s < hand.style.settle_s => None,
            Phase::Close if view.taker.both_touch => Some(Event::Gripped),
            Phase::Close => (overdue_s > GRIP_PATIENCE_S).then_some(Event::Lost),
            Phase::Keep => view.given.then_some(Event::Given),
            Phase::Hold => None,
            Phase::Open => (overdue_s >= REOPEN_S).then_some(Event::Arrived),
        }
    }
}

impl Taker {
    /// A hand whose habits come from `rng`.
    pub(super) fn new(rng: Rng) -> Self {
        Self {
            hand: Hand::new(rng),
        }
    }

    /// Whether the needle is in this hand.
    pub(super) fn holds(&self) -> bool {
        matches!(self.hand.phase, Phase::Keep | Phase::Take | Phase::Hold)
    }

    /// Whether this hand waits for the needle.
    pub(super) fn is_idle(&self) -> bool {
        self.hand.phase == Phase::Wait
    }

    /// The pose in which closing the jaw grips the wire on the side of the needle's blunt end.
    fn grasp_pose(&self, view: &View) -> Pose {
        let style = &self.hand.style;
        wire_hold(&view.shape, &view.needle, -style.angle_rad, style.beyond_m)
    }

    /// The pose to wait in above the needle.
    fn poise_pose(&self, view: &View) -> Pose {
        Translation3::new(0.0, 0.0, self.hand.style.poise_height_m) * self.grasp_pose(view)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::script::play::check_table;

    #[test]
    fn documented_table_is_what_happens() {
        use Phase::{Approach, Close, Descend, Hold, Keep, Open, Retreat, Take, Wait};
        let table = [
            (Wait, [Approach, Wait, Wait, Wait, Wait]),
            (Approach, [Approach, Descend, Approach, Retreat, Approach]),
            (Descend, [Descend, Close, Descend, Retreat, Descend]),
            (Close, [Close, Close, Keep, Open, Close]),
            (Keep, [Keep, Keep, Keep, Open, Take]),
            (Take, [Take, Hold, Take, Open, Take]),
            (Hold, [Hold, Hold, Hold, Open, Hold]),
            (Open, [Open, Retreat, Open, Open, Open]),
            (Retreat, [Retreat, Wait, Retreat, Retreat, Retreat]),
        ];
        check_table(
            [
                Event::Offered,
                Event::Arrived,
                Event::Gripped,
                Event::Lost,
                Event::Given,
            ],
            &table,
        );
    }
}
