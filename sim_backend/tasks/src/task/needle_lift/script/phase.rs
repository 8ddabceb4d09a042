//! The expert's phases and the transitions between them.

use crate::script::play::{Event, Grasp, Stage, Transition};

/// What the expert is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// On the way to above the needle, opening the jaw.
    Approach,
    /// Waiting above the needle.
    Poise,
    /// Going down to the needle, jaw open.
    Descend,
    /// Closing the jaw and waiting for a grip.
    Close,
    /// Lifting.
    Lift,
    /// Holding the needle up.
    Hold,
    /// Opening the jaw after a missed or lost grip.
    Open,
    /// Rising from the needle before another attempt.
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
        (Self::Approach, Event::Arrived, Self::Poise),
        (Self::Poise, Event::Arrived, Self::Descend),
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
