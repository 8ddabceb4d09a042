//! The phases of a tissue retraction and the transitions between them.

use crate::script::play::{Event, Grasp, Stage, Transition};

/// What the script is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// On the way to before the free edge, opening the jaw. Follows the mark, and ends when the
    /// motion is over.
    Approach,
    /// Going in, one finger above the flap and one under it. Ends when the motion is over and the
    /// tip within 0.6 mm of the grasp, or 0.6 s later wherever it is.
    Enter,
    /// Closing the jaw and waiting for a hold at the mark. A hold with the mark more than 3.5 mm
    /// beside the fingers' middle is lost at once; a right one counts `Style::settle_s` after the
    /// motion; without one it is missed 0.3 s after it.
    Close,
    /// Lifting. Up and towards the attached edge. Lost after three steps (120 ms) without a hold.
    Lift,
    /// Holding the flap up. Nothing but a loss ends it.
    Hold,
    /// Opening the jaw after a missed or lost grasp, or one beside the mark. Ends 0.4 s after the
    /// motion: the flap falls back.
    Open,
    /// Going back out before another attempt. Straight back along the instrument.
    Retreat,
}

impl Stage for Phase {
    const FIRST: Self = Self::Approach;

    const GRASP: [Transition<Self>; 5] = Grasp {
        enter: Self::Enter,
        close: Self::Close,
        gripped: Self::Lift,
        open: Self::Open,
        retreat: Self::Retreat,
        again: Self::Approach,
    }
    .transitions();

    const TRANSITIONS: &'static [Transition<Self>] = &[
        (Self::Approach, Event::Arrived, Self::Enter),
        (Self::Lift, Event::Arrived, Self::Hold),
        (Self::Lift, Event::Lost, Self::Open),
        (Self::Hold, Event::Lost, Self::Open),
    ];
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
