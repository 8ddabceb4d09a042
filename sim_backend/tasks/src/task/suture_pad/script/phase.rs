//! The phases of driving a needle through a hole, and the transitions between them.

use crate::script::play::{Event, Grasp, Stage, Transition};

/// What the script is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// On the way to above the needle, opening the jaw. Follows the needle, and ends when the
    /// motion is over.
    Approach,
    /// Going down to the needle, jaw open. Ends when the motion is over and the tip within 0.6 mm
    /// of the grasp, or 0.6 s later wherever it is.
    Descend,
    /// Closing the jaw and waiting for a grip. Gripped once both fingers touch, no sooner than
    /// `Style::settle_s` after the motion; missed 0.5 s after it. With the needle's point in the
    /// hole already, the drive goes on from there.
    Close,
    /// Lifting the needle to the height of the hole. From here on the needle is lost after four
    /// steps (160 ms) without touch by both fingers.
    Lift,
    /// Turning the needle and carrying it along the lip to `Style::aside_m` before where `Near`
    /// brings it. Ends when the motion is over, wherever the needle is.
    Cross,
    /// Bringing its point up to the hole. Ends when the motion is over and the tip within 0.4 mm of
    /// where it lines the needle up, or 0.6 s later.
    Near,
    /// Turning it through the hole, about the centre of its arc. Judged 0.2 s after the motion: the
    /// point is 8.5 mm behind the lip, or the needle is stuck and turned back.
    Drive,
    /// Turning it back. To where it was lined up, for another attempt. Ends 0.2 s after the motion.
    Back,
    /// Holding it there. The last phase: not even a loss ends it.
    Hold,
    /// Opening the jaw after a missed or lost grip. Ends 0.3 s after the motion.
    Open,
    /// Rising from the needle before another attempt. Ends when the motion is over.
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
        (Self::Close, Event::Regripped, Self::Drive),
        (Self::Lift, Event::Arrived, Self::Cross),
        (Self::Lift, Event::Lost, Self::Open),
        (Self::Cross, Event::Arrived, Self::Near),
        (Self::Cross, Event::Lost, Self::Open),
        (Self::Near, Event::Arrived, Self::Drive),
        (Self::Near, Event::Lost, Self::Open),
        (Self::Drive, Event::Arrived, Self::Hold),
        (Self::Drive, Event::Lost, Self::Open),
        (Self::Drive, Event::Stuck, Self::Back),
        (Self::Back, Event::Arrived, Self::Near),
        (Self::Back, Event::Lost, Self::Open),
    ];
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::script::play::check_transitions;

    #[test]
    fn transitions_are_whole() {
        check_transitions(Some(Phase::Hold));
    }
}
