//! The expert's phases and the transitions between them.

use crate::script::play::{Event, Grasp, Stage, Transition};

/// What the expert is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// On the way to above the needle, opening the jaw. Follows the needle, and ends when the
    /// motion is over.
    Approach,
    /// Waiting above the needle. Ends after `Style::poise_s`, which is 0 in half of the
    /// demonstrations.
    Poise,
    /// Going down to the needle, jaw open. Ends when the motion is over and the tip within 0.6 mm
    /// of the grasp, or 0.6 s later wherever it is.
    Descend,
    /// Closing the jaw and waiting for a grip. Gripped once both fingers touch, no sooner than
    /// `Style::settle_s` after the motion; missed 0.5 s after it.
    Close,
    /// Lifting. Ends when the motion is over. Lost after four steps (160 ms) without touch by both
    /// fingers.
    Lift,
    /// Holding the needle up. Nothing but a loss ends it; then the needle is fetched again.
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
