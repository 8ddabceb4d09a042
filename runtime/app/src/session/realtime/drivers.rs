//! Whose chunks the controller is given: the policy's or, once they have taken over, the operator's
//! hands'. Hot path: bounded, no allocation, no lock.

use hal::{Chunk, PerArm};
use rtrb::Consumer;
use trocar_control::OperatorEvent;

use crate::session::teleop::{Driver, TeleopCommand};

/// What chunks come from.
pub(super) struct Drivers {
    policy: Consumer<PerArm<Chunk>>,
    /// The hands of an operator beside the policy, if there is one.
    hands: Option<Consumer<TeleopCommand>>,
    driver: Driver,
}

impl Drivers {
    /// The policy drives; `hands` may take over.
    pub(super) const fn new(
        policy: Consumer<PerArm<Chunk>>,
        hands: Option<Consumer<TeleopCommand>>,
    ) -> Self {
        Self {
            policy,
            hands,
            driver: Driver::Policy,
        }
    }

    /// Whether the policy drives.
    pub(super) fn is_policy(&self) -> bool {
        self.driver == Driver::Policy
    }

    /// The chunks of whoever drives, if there are new ones, and what the controller is told if that
    /// is another from now on. What `waits` is for a later period; as long as the controller is
    /// told something else (`free` is false), nobody takes over.
    pub(super) fn next(
        &mut self,
        waits: impl Fn(&PerArm<Chunk>) -> bool,
        free: bool,
    ) -> (Option<PerArm<Chunk>>, Option<OperatorEvent>) {
        let change = self.hands.as_ref().and_then(|hands| hands.peek().ok());
        let change = change.filter(|word| word.driver != self.driver);
        let due = |word: &TeleopCommand| word.driver == Driver::Policy || !waits(&word.chunks);
        if change.is_some_and(due) && free {
            return self.change();
        }
        let by_hand = self.driver == Driver::Operator;
        let waiting = change.is_some();
        let hands = self.hands.as_mut().filter(|_| by_hand && !waiting);
        let of_hands = hands.and_then(|hands| taken(hands, |word| waits(&word.chunks)));
        // What the policy says meanwhile is not kept.
        let of_policy = taken(&mut self.policy, &waits);
        let chunks = if by_hand {
            of_hands.map(|word| word.chunks)
        } else {
            of_policy
        };
        (chunks, None)
    }

    /// Another drives.
    fn change(&mut self) -> (Option<PerArm<Chunk>>, Option<OperatorEvent>) {
        let Some(word) = self.hands.as_mut().and_then(|hands| hands.pop().ok()) else {
            return (None, None);
        };
        self.driver = word.driver;
        match word.driver {
            Driver::Operator => (Some(word.chunks), Some(OperatorEvent::TakeOver)),
            Driver::Policy => (None, Some(OperatorEvent::HandBack)),
        }
    }
}

/// The oldest in `queue`, unless it waits.
fn taken<T>(queue: &mut Consumer<T>, waits: impl Fn(&T) -> bool) -> Option<T> {
    if queue.peek().is_ok_and(waits) {
        return None;
    }
    queue.pop().ok()
}

#[cfg(test)]
mod tests {
    use hal::TimeNs;
    use rtrb::RingBuffer;

    use super::*;

    fn chunks(sequence: u64) -> PerArm<Chunk> {
        PerArm::one(Chunk::new(TimeNs(sequence), sequence, 40, &[]))
    }

    /// The controller is given the chunks of whoever drives alone, and hears of each change once,
    /// when it hears nothing else.
    #[test]
    fn chunks_are_those_of_whoever_drives() {
        let (mut policy_in, policy) = RingBuffer::new(8);
        let (mut hands_in, hands) = RingBuffer::new(8);
        let mut drivers = Drivers::new(policy, Some(hands));
        let mut next = |from_policy: Option<u64>, from_hands: Option<(Driver, u64)>, free: bool| {
            if let Some(sequence) = from_policy {
                policy_in.push(chunks(sequence)).unwrap();
            }
            if let Some((driver, sequence)) = from_hands {
                let chunks = chunks(sequence);
                hands_in.push(TeleopCommand { driver, chunks }).unwrap();
            }
            let (chunks, event) = drivers.next(|_| false, free);
            (chunks.map(|chunks| chunks.first.sequence), event)
        };
        let operator = |sequence| Some((Driver::Operator, sequence));
        assert_eq!(next(Some(1), None, true), (Some(1), None));
        assert_eq!(next(Some(2), operator(100), false), (Some(2), None));
        assert_eq!(
            next(Some(3), None, true),
            (Some(100), Some(OperatorEvent::TakeOver))
        );
        assert_eq!(next(None, operator(101), false), (Some(101), None));
        assert_eq!(next(Some(4), None, true), (None, None));
        let back = Some((Driver::Policy, 102));
        assert_eq!(next(None, back, false), (None, None));
        assert_eq!(
            next(None, None, true),
            (None, Some(OperatorEvent::HandBack))
        );
        assert_eq!(next(Some(5), None, true), (Some(5), None));
    }
}
