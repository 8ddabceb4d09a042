//! The phases of a block transfer and the transitions between them.

use crate::script::play::{Event, Grasp, Stage, Transition};

/// What the script is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// On the way to above the block, opening the jaw.
    Approach,
    /// Going down, one finger into the hole, the other one outside.
    Descend,
    /// Closing the jaw and waiting for a grip.
    Close,
    /// Lifting the block above the pegs.
    Lift,
    /// Carrying it to above the goal peg.
    Carry,
    /// Lowering it over the goal peg.
    Lower,
    /// Opening the jaw.
    Release,
    /// Rising from the block.
    Rise,
    /// Looking at the block.
    Rest,
    /// Opening the jaw after a missed or lost grip.
    Open,
    /// Rising before another attempt.
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
        (Self::Carry, Event::Arrived, Self::Lower),
        (Self::Carry, Event::Lost, Self::Open),
        (Self::Lower, Event::Arrived, Self::Release),
        (Self::Lower, Event::Lost, Self::Open),
        (Self::Lower, Event::Stuck, Self::Lift),
        (Self::Release, Event::Arrived, Self::Rise),
        (Self::Rise, Event::Arrived, Self::Rest),
        (Self::Rest, Event::Lost, Self::Approach),
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
