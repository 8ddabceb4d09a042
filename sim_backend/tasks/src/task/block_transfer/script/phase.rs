//! The phases of a block transfer and the one function that moves between them.

use crate::script::play::Stage;

/// What the script is doing.
///
/// | phase    | Arrived  | Gripped | Lost     | Stuck |
/// |----------|----------|---------|----------|-------|
/// | Approach | Descend  |         |          |       |
/// | Descend  | Close    |         |          |       |
/// | Close    |          | Lift    | Open     |       |
/// | Lift     | Carry    |         | Open     |       |
/// | Carry    | Lower    |         | Open     |       |
/// | Lower    | Release  |         | Open     | Lift  |
/// | Release  | Rise     |         |          |       |
/// | Rise     | Rest     |         |          |       |
/// | Rest     |          |         | Approach |       |
/// | Open     | Retreat  |         |          |       |
/// | Retreat  | Approach |         |          |       |
///
/// An empty cell stays in the phase.
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

/// What happened in a phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// The motion ended and the arm is where it was to be, or will not get closer.
    Arrived,
    /// Both fingers hold the block.
    Gripped,
    /// The block is not where it should be: in the jaw, or on the goal peg.
    Lost,
    /// The block does not go down.
    Stuck,
}

impl Stage for Phase {
    type Event = Event;

    const FIRST: Self = Self::Approach;

    fn next(self, event: Event) -> Self {
        match (self, event) {
            (Self::Approach, Event::Arrived) => Self::Descend,
            (Self::Descend, Event::Arrived) => Self::Close,
            (Self::Close, Event::Gripped) | (Self::Lower, Event::Stuck) => Self::Lift,
            (Self::Lift, Event::Arrived) => Self::Carry,
            (Self::Carry, Event::Arrived) => Self::Lower,
            (Self::Lower, Event::Arrived) => Self::Release,
            (Self::Release, Event::Arrived) => Self::Rise,
            (Self::Rise, Event::Arrived) => Self::Rest,
            (Self::Close | Self::Lift | Self::Carry | Self::Lower, Event::Lost) => Self::Open,
            (Self::Open, Event::Arrived) => Self::Retreat,
            (Self::Retreat, Event::Arrived) | (Self::Rest, Event::Lost) => Self::Approach,
            (
                Self::Approach
                | Self::Descend
                | Self::Release
                | Self::Rise
                | Self::Open
                | Self::Retreat,
                Event::Gripped | Event::Lost | Event::Stuck,
            )
            | (Self::Close, Event::Arrived | Event::Stuck)
            | (Self::Lift | Self::Carry, Event::Gripped | Event::Stuck)
            | (Self::Lower, Event::Gripped)
            | (Self::Rest, Event::Arrived | Event::Gripped | Event::Stuck) => self,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::script::play::check_table;

    #[test]
    fn documented_table_is_what_happens() {
        use Phase::{
            Approach, Carry, Close, Descend, Lift, Lower, Open, Release, Rest, Retreat, Rise,
        };
        let table = [
            (Approach, [Descend, Approach, Approach, Approach]),
            (Descend, [Close, Descend, Descend, Descend]),
            (Close, [Close, Lift, Open, Close]),
            (Lift, [Carry, Lift, Open, Lift]),
            (Carry, [Lower, Carry, Open, Carry]),
            (Lower, [Release, Lower, Open, Lift]),
            (Release, [Rise, Release, Release, Release]),
            (Rise, [Rest, Rise, Rise, Rise]),
            (Rest, [Rest, Rest, Approach, Rest]),
            (Open, [Retreat, Open, Open, Open]),
            (Retreat, [Approach, Retreat, Retreat, Retreat]),
        ];
        check_table(
            [Event::Arrived, Event::Gripped, Event::Lost, Event::Stuck],
            &table,
        );
    }
}
