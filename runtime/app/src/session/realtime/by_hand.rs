//! An operator's hands on arms outside of this process: as their policy, or beside one. They are
//! looked at with what the arms measured last, whenever the thread that observes these has time for
//! it.

use hal::{ArmState, Chunk, PerArm, TICK_NS, TimeNs};
use rtrb::{Consumer, Producer, RingBuffer};
use trocar_log::Level;

use super::CHUNK_QUEUE;
use super::channels::Local;
use super::signals::Signals;
use crate::session::plan::Arms;
use crate::session::source::{ChunkSource, seen_arm};
use crate::session::teleop::{CHUNK_TICKS, Intervention, Teleop, TeleopCommand};
use crate::session::{Plan, PolicyChoice, SessionError};

/// Time from one look at the hands to the next, ns.
const LOOK_NS: u64 = CHUNK_TICKS * TICK_NS;

/// The hands, and what they are to the arms.
pub(super) struct ByHand {
    role: Role,
    /// When the arms were measured with which the hands were last looked at.
    last: Option<TimeNs>,
}

enum Role {
    /// They are the policy.
    Policy(Box<Teleop>, Producer<PerArm<Chunk>>),
    /// They may take over from the policy.
    Beside(Box<Intervention>),
}

impl Role {
    /// Releases every clutch.
    fn release(&self) {
        match self {
            Self::Policy(teleop, _) => teleop.release(),
            Self::Beside(intervention) => intervention.release(),
        }
    }
}

/// Hands of a run, what else answers in this process, and the control thread's end of hands that
/// are beside a policy.
pub(super) type Answering = (Option<ByHand>, Local, Option<Consumer<TeleopCommand>>);

impl ByHand {
    /// The hands that move the arms of `plan`, if any may, apart from what else is `local`.
    pub(super) fn of<S: Arms>(plan: &Plan<S>, local: Local) -> Answering {
        let new = |role| Self { role, last: None };
        match local {
            Some((ChunkSource::Teleop(teleop), chunks)) => {
                (Some(new(Role::Policy(teleop, chunks))), None, None)
            }
            local => match intervention(plan) {
                Some((beside, from)) => (Some(new(Role::Beside(beside))), local, Some(from)),
                None => (None, local, None),
            },
        }
    }

    /// Looks at the hands, if it is time, of arms that were measured as `states` last; it is `now`.
    /// A clutch that was taken before the first look has to be taken anew: the arms were not
    /// enabled then.
    pub(super) fn look(
        &mut self,
        states: &PerArm<ArmState>,
        now: TimeNs,
        signals: &Signals,
    ) -> Result<(), SessionError> {
        if self.last.is_some_and(|last| now.since(last) < LOOK_NS) {
            return Ok(());
        }
        if self.last.replace(now).is_none() {
            self.role.release();
        }
        // Arms elsewhere may have a clock that is ahead; a chunk of the future is refused.
        let seen_at = |state: ArmState| ArmState {
            stamp: TimeNs(state.stamp.0.min(now.0)),
            ..state
        };
        let arms = states.map(|state| seen_arm(&seen_at(state)));
        let notices = match &mut self.role {
            Role::Policy(teleop, chunks) => {
                // The control thread takes one a tick; a full queue means that it is gone.
                let _gone = chunks.push(teleop.answer(&arms)?);
                teleop.take_notices()
            }
            Role::Beside(intervention) => {
                // A world elsewhere has a time limit of its own.
                let _more_s = intervention.answer(&arms)?;
                intervention.take_notices()
            }
        };
        for text in notices {
            signals.tell(now, Level::Info, &text);
        }
        Ok(())
    }
}

/// An operator who may take over from the policy of `plan`, on a page of its console or by devices
/// here, if it is known in which axes; and the control thread's end.
pub(super) fn intervention<S: Arms>(
    plan: &Plan<S>,
) -> Option<(Box<Intervention>, Consumer<TeleopCommand>)> {
    let by_hand = plan.policy == PolicyChoice::Teleop;
    let console = plan.console.as_ref();
    let console = console.filter(|console| console.has_operator() && !by_hand)?;
    let views = plan.setup.rcms_from_view();
    if views.is_empty() {
        return None;
    }
    let limit_s = plan.setup.task().map_or(0.0, |it| it.task.time_limit_s);
    let (to, from) = RingBuffer::new(CHUNK_QUEUE);
    let episode = (plan.demonstrates, limit_s);
    let intervention = Intervention::new(&views, &console.hands(), episode, to);
    Some((Box::new(intervention), from))
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use hal::{JointVector, Pose};
    use serde_json::{Value, json};

    use super::*;
    use crate::session::teleop::Hands;

    fn engaged(hands: &Hands) -> bool {
        let status: Value = serde_json::to_value(hands.status()).unwrap();
        status["arms"][0]["engaged"] == true
    }

    fn say(hands: &Hands, t_ms: u64, clutch: bool) {
        let hand = json!({ "clutch": clutch, "at": [0, 0, 0], "turn": [0, 0, 0, 1], "jaw": 0.5 });
        let message = json!({ "t": t_ms, "arms": [hand] });
        let message = serde_json::from_value(message).unwrap();
        hands.hear(1, &message).unwrap();
    }

    /// Whoever holds a clutch while arms come up moves none of them before it is taken anew; chunks
    /// are of no later time than the look.
    #[test]
    fn a_clutch_is_taken_after_the_first_look() {
        let hands = Arc::new(Hands::new());
        let teleop = Teleop::new(&[Pose::identity()], Arc::clone(&hands), false);
        let (to, mut chunks) = RingBuffer::new(CHUNK_QUEUE);
        let role = Role::Policy(Box::new(teleop), to);
        let mut by_hand = ByHand { role, last: None };
        let signals = Signals::of(None);
        // Measured by a clock that is 3 ms ahead.
        let mut look = |now: TimeNs| {
            let state = ArmState::at_rest(now.plus_ns(3_000_000), JointVector::zeros(), 0.4);
            by_hand.look(&PerArm::one(state), now, &signals).unwrap();
            chunks.pop().map(|chunks| chunks.first.observed_at)
        };
        say(&hands, 1, false);
        say(&hands, 2, true);
        assert!(engaged(&hands));
        assert_eq!(look(TimeNs(LOOK_NS)), Ok(TimeNs(LOOK_NS)));
        assert!(!engaged(&hands));
        say(&hands, 3, true);
        assert!(!engaged(&hands), "it is held as before");
        say(&hands, 4, false);
        say(&hands, 5, true);
        assert!(engaged(&hands));
        assert!(look(TimeNs(2 * LOOK_NS - 1)).is_err(), "too soon");
        assert_eq!(look(TimeNs(2 * LOOK_NS)), Ok(TimeNs(2 * LOOK_NS)));
    }
}
