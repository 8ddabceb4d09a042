//! The phases of a block transfer and the transitions between them.

use crate::script::play::{Event, Grasp, Stage, Transition};

/// What the script is doing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Phase {
    /// On the way to above the block, opening the jaw. Follows the block, and ends `Style::aim_s`
    /// after the motion.
    Approach,
    /// Going down, one finger into the hole, the other one outside. Ends when the motion is over
    /// and the tip within 0.6 mm of the grasp, or 0.6 s later wherever it is.
    Descend,
    /// Closing the jaw and waiting for a grip. Gripped once both fingers touch, no sooner than
    /// `Style::settle_s` after the motion; missed 0.5 s after it.
    Close,
    /// Lifting the block above the pegs. By as much as brings its lower end `Style::clear_m` above
    /// the pegs. From here to the release the block is lost after four steps (160 ms) without touch
    /// by both fingers.
    Lift,
    /// Carrying it to above the goal peg. Ends when the motion is over and the tip within 0.6 mm of
    /// where it brings the block, or 0.6 s later.
    Carry,
    /// Lowering it over the goal peg. Judged 0.1 s after the motion: a block that is more than 2 mm
    /// too high is stuck on the peg, and lifted again.
    Lower,
    /// Opening the jaw. Ends 0.25 s after the motion.
    Release,
    /// Rising from the block. Ends when the motion is over.
    Rise,
    /// Looking at the block. After 1 s in an episode that still runs, another attempt begins.
    Rest,
    /// Opening the jaw after a missed or lost grip. Ends 0.25 s after the motion.
    Open,
    /// Rising before another attempt. High enough for the open fingers to pass over the pegs.
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
