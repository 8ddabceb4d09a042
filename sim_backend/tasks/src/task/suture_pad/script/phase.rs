//! The phases of driving a needle through a hole, and the one function that moves between them.

use crate::script::play::Stage;

/// What the script is doing.
///
/// | phase    | Arrived  | Gripped | Regripped | Lost | Stuck |
/// |----------|----------|---------|-----------|------|-------|
/// | Approach | Descend  |         |           |      |       |
/// | Descend  | Close    |         |           |      |       |
/// | Close    |          | Lift    | Drive     | Open |       |
/// | Lift     | Cross    |         |           | Open |       |
/// | Cross    | Near     |         |           | Open |       |
/// | Near     | Drive    |         |           | Open |       |
/// | Drive    | Hold     |         |           | Open | Back  |
/// | Back     | Near     |         |           | Open |       |
/// | Hold     |          |         |           |      |       |
/// | Open     | Retreat  |         |           |      |       |
/// | Retreat  | Approach |         |           |      |       |
///
/// An empty cell stays in the phase.
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

/// What happened in a phase.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Event {
    /// The motion ended and the arm is where it was to be, or will not get closer.
    Arrived,
    /// Both fingers hold the needle, which is free.
    Gripped,
    /// Both fingers hold the needle, whose point is in the hole.
    Regripped,
    /// The fingers closed on nothing, or the needle slipped out.
    Lost,
    /// The point did not get through.
    Stuck,
}

impl Stage for Phase {
    type Event = Event;

    const FIRST: Self = Self::Approach;

    fn next(self, event: Event) -> Self {
        match (self, event) {
            (Self::Approach, Event::Arrived) => Self::Descend,
            (Self::Descend, Event::Arrived) => Self::Close,
            (Self::Close, Event::Gripped) => Self::Lift,
            (Self::Lift, Event::Arrived) => Self::Cross,
            (Self::Cross | Self::Back, Event::Arrived) => Self::Near,
            (Self::Near, Event::Arrived) | (Self::Close, Event::Regripped) => Self::Drive,
            (Self::Drive, Event::Arrived) => Self::Hold,
            (Self::Drive, Event::Stuck) => Self::Back,
            (
                Self::Close | Self::Lift | Self::Cross | Self::Near | Self::Drive | Self::Back,
                Event::Lost,
            ) => Self::Open,
            (Self::Open, Event::Arrived) => Self::Retreat,
            (Self::Retreat, Event::Arrived) => Self::Approach,
            (Self::Close, Event::Arrived | Event::Stuck)
            | (Self::Hold, _)
            | (
                Self::Approach | Self::Descend | Self::Open | Self::Retreat,
                Event::Gripped | Event::Regripped | Event::Lost | Event::Stuck,
            )
            | (
                Self::Lift | Self::Cross | Self::Near | Self::Back,
                Event::Gripped | Event::Regripped | Event::Stuck,
            )
            | (Self::Drive, Event::Gripped | Event::Regripped) => self,
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
            Approach, Back, Close, Cross, Descend, Drive, Hold, Lift, Near, Open, Retreat,
        };
        let table = [
            (Approach, [Descend, Approach, Approach, Approach, Approach]),
            (Descend, [Close, Descend, Descend, Descend, Descend]),
            (Close, [Close, Lift, Drive, Open, Close]),
            (Lift, [Cross, Lift, Lift, Open, Lift]),
            (Cross, [Near, Cross, Cross, Open, Cross]),
            (Near, [Drive, Near, Near, Open, Near]),
            (Drive, [Hold, Drive, Drive, Open, Back]),
            (Back, [Near, Back, Back, Open, Back]),
            (Hold, [Hold, Hold, Hold, Hold, Hold]),
            (Open, [Retreat, Open, Open, Open, Open]),
            (Retreat, [Approach, Retreat, Retreat, Retreat, Retreat]),
        ];
        check_table(
            [
                Event::Arrived,
                Event::Gripped,
                Event::Regripped,
                Event::Lost,
                Event::Stuck,
            ],
            &table,
        );
    }
}
