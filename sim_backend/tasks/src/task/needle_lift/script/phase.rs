//! The expert's phases and the one function that moves between them.

use crate::script::play::Stage;

/// What the expert is doing.
///
/// | phase    | Arrived | Gripped | Lost    |
/// |----------|---------|---------|---------|
/// | Approach | Poise   |         |         |
/// | Poise    | Descend |         |         |
/// | Descend  | Close   |         |         |
/// | Close    |         | Lift    | Open    |
/// | Lift     | Hold    |         | Open    |
/// | Hold     |         |         | Open    |
/// | Open     | Retreat |         |         |
/// | Retreat  | Approach|         |         |
///
/// An empty cell stays in the phase.
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

/// What happened in a phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// The motion ended and the arm is where it was to be, or will not get closer.
    Arrived,
    /// Both fingers hold the needle.
    Gripped,
    /// The fingers closed on nothing, or the needle slipped out.
    Lost,
}

impl Stage for Phase {
    type Event = Event;

    const FIRST: Self = Self::Approach;

    fn next(self, event: Event) -> Self {
        match (self, event) {
            (Self::Approach, Event::Arrived) => Self::Poise,
            (Self::Poise, Event::Arrived) => Self::Descend,
            (Self::Descend, Event::Arrived) => Self::Close,
            (Self::Close, Event::Gripped) => Self::Lift,
            (Self::Lift, Event::Arrived) => Self::Hold,
            (Self::Close | Self::Lift | Self::Hold, Event::Lost) => Self::Open,
            (Self::Open, Event::Arrived) => Self::Retreat,
            (Self::Retreat, Event::Arrived) => Self::Approach,
            (Self::Close | Self::Hold, Event::Arrived)
            | (
                Self::Approach | Self::Poise | Self::Descend | Self::Open | Self::Retreat,
                Event::Gripped | Event::Lost,
            )
            | (Self::Lift | Self::Hold, Event::Gripped) => self,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::script::play::check_table;

    #[test]
    fn documented_table_is_what_happens() {
        use Phase::{Approach, Close, Descend, Hold, Lift, Open, Poise, Retreat};
        let table = [
            (Approach, [Poise, Approach, Approach]),
            (Poise, [Descend, Poise, Poise]),
            (Descend, [Close, Descend, Descend]),
            (Close, [Close, Lift, Open]),
            (Lift, [Hold, Lift, Open]),
            (Hold, [Hold, Hold, Open]),
            (Open, [Retreat, Open, Open]),
            (Retreat, [Approach, Retreat, Retreat]),
        ];
        check_table([Event::Arrived, Event::Gripped, Event::Lost], &table);
    }
}
