//! The phases of a tissue retraction and the one function that moves between them.

use crate::script::play::Stage;

/// What the script is doing.
///
/// | phase    | Arrived  | Held | Lost |
/// |----------|----------|------|------|
/// | Approach | Enter    |      |      |
/// | Enter    | Close    |      |      |
/// | Close    |          | Lift | Open |
/// | Lift     | Hold     |      | Open |
/// | Hold     |          |      | Open |
/// | Open     | Retreat  |      |      |
/// | Retreat  | Approach |      |      |
///
/// An empty cell stays in the phase.
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

/// What happened in a phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// The motion ended and the arm is where it was to be, or will not get closer.
    Arrived,
    /// The jaw holds the flap at the mark.
    Held,
    /// The jaw closed on nothing or beside the mark, or the flap slipped out.
    Lost,
}

impl Stage for Phase {
    type Event = Event;

    const FIRST: Self = Self::Approach;

    fn next(self, event: Event) -> Self {
        match (self, event) {
            (Self::Approach, Event::Arrived) => Self::Enter,
            (Self::Enter, Event::Arrived) => Self::Close,
            (Self::Close, Event::Held) => Self::Lift,
            (Self::Lift, Event::Arrived) => Self::Hold,
            (Self::Close | Self::Lift | Self::Hold, Event::Lost) => Self::Open,
            (Self::Open, Event::Arrived) => Self::Retreat,
            (Self::Retreat, Event::Arrived) => Self::Approach,
            (Self::Close | Self::Hold, Event::Arrived)
            | (
                Self::Approach | Self::Enter | Self::Open | Self::Retreat,
                Event::Held | Event::Lost,
            )
            | (Self::Lift | Self::Hold, Event::Held) => self,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::script::play::check_table;

    #[test]
    fn documented_table_is_what_happens() {
        use Phase::{Approach, Close, Enter, Hold, Lift, Open, Retreat};
        let table = [
            (Approach, [Enter, Approach, Approach]),
            (Enter, [Close, Enter, Enter]),
            (Close, [Close, Lift, Open]),
            (Lift, [Hold, Lift, Open]),
            (Hold, [Hold, Hold, Open]),
            (Open, [Retreat, Open, Open]),
            (Retreat, [Approach, Retreat, Retreat]),
        ];
        check_table([Event::Arrived, Event::Held, Event::Lost], &table);
    }
}
