//! The phases of driving a needle through a hole, and the transitions between them.

use crate::script::play::{Event, Grasp, Stage, Transition};

/// What the script is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// On the way to above the needle, opening the jaw.
    Approach,
    /// Going down to the needle, jaw open.
    Descend,
    /// Closing the jaw and waiting for a grip.
    Close,
    /// Lifting the needle to the height of the hole.
    Lift,
    /// Turning the needle and carrying it along the lip to before the hole.
    Cross,
    /// Bringing its point up to the hole.
    Near,
    /// Turning it through the hole about the middle of its arc.
    Drive,
    /// Turning it back.
    Back,
    /// Holding it there.
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
