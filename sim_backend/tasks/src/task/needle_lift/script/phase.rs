//! The expert's phases and the transitions between them.

use crate::script::play::{Event, Stage};

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

    const TRANSITIONS: &'static [(Self, Event, Self)] = &[
        (Self::Approach, Event::Arrived, Self::Poise),
        (Self::Poise, Event::Arrived, Self::Descend),
        (Self::Descend, Event::Arrived, Self::Close),
        (Self::Close, Event::Gripped, Self::Lift),
        (Self::Close, Event::Lost, Self::Open),
        (Self::Lift, Event::Arrived, Self::Hold),
        (Self::Lift, Event::Lost, Self::Open),
        (Self::Hold, Event::Lost, Self::Open),
        (Self::Open, Event::Arrived, Self::Retreat),
        (Self::Retreat, Event::Arrived, Self::Approach),
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
