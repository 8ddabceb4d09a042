//! The phases of a tissue retraction and the transitions between them.

use crate::script::play::{Event, Grasp, Stage, Transition};

/// What the script is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// On the way to before the free edge, opening the jaw.
    Approach,
    /// Going in, one finger above the flap and one under it.
    Enter,
    /// Closing the jaw and waiting for a hold at the mark.
    Close,
    /// Lifting.
    Lift,
    /// Holding the flap up.
    Hold,
    /// Opening the jaw after a missed or lost grasp, or one beside the mark.
    Open,
    /// Going back out before another attempt.
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
