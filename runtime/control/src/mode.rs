//! What the arm is allowed to do: the CRTK operating states and the one function that changes them.
//!
//! | state    | enable  | disable  | pause    | resume   | clear    | speed    | take over | hand back | go on    | fail  |
//! |----------|---------|----------|----------|----------|----------|----------|-----------|-----------|----------|-------|
//! | DISABLED | ENABLED | DISABLED | DISABLED | DISABLED | DISABLED | DISABLED | DISABLED  | DISABLED  | DISABLED | FAULT |
//! | ENABLED  | ENABLED | DISABLED | PAUSED   | ENABLED  | ENABLED  | ENABLED  | ENABLED   | ENABLED   | ENABLED  | FAULT |
//! | PAUSED   | PAUSED  | DISABLED | PAUSED   | ENABLED  | PAUSED   | PAUSED   | PAUSED    | PAUSED    | ENABLED  | FAULT |
//! | FAULT    | FAULT   | FAULT    | FAULT    | FAULT    | DISABLED | FAULT    | FAULT     | FAULT     | FAULT    | FAULT |

use core::fmt;

use super::snapshot::{Reader, Snapshot, SnapshotError, Words, layout};

/// The CRTK operating state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OperatingState {
    /// Drives without torque; the command follows the measured arm.
    Disabled,
    /// The arm follows the policy.
    Enabled,
    /// The arm comes to rest and holds; chunks are ignored.
    Paused,
    /// Something failed; the arm comes to rest, and only the operator's clear leads out of this
    /// state.
    Fault,
}

impl OperatingState {
    /// The name that CRTK gives it.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Disabled => "DISABLED",
            Self::Enabled => "ENABLED",
            Self::Paused => "PAUSED",
            Self::Fault => "FAULT",
        }
    }
}

impl fmt::Display for OperatingState {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl Words for OperatingState {
    const LAYOUT: u64 = layout("OperatingState Disabled Enabled Paused Fault", &[]);
    const WORDS_MAX: usize = 1;

    fn put(&self, to: &mut Snapshot) {
        to.push(match self {
            Self::Disabled => 0,
            Self::Enabled => 1,
            Self::Paused => 2,
            Self::Fault => 3,
        });
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
        match from.word()? {
            0 => Ok(Self::Disabled),
            1 => Ok(Self::Enabled),
            2 => Ok(Self::Paused),
            3 => Ok(Self::Fault),
            _ => Err(SnapshotError::Impossible),
        }
    }
}

/// The operating state with CRTK's two flags.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mode {
    /// The operating state.
    pub state: OperatingState,
    /// Whether the joint positions are known: a valid measurement has arrived.
    pub homed: bool,
    /// Whether the commanded arm moves.
    pub busy: bool,
}

/// What the operator asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum OperatorEvent {
    /// Power the drives and follow the policy.
    Enable,
    /// Stop, then release the drives.
    Disable,
    /// Stop and hold.
    Pause,
    /// Follow the policy again.
    Resume,
    /// Acknowledge a fault; the arm stays disabled.
    Clear,
    /// Lower the speed limits to a share of the configured ones, or raise them again; this changes
    /// no state.
    Speed {
        /// The share, percent; more than 100 counts as 100.
        percent: u8,
    },
    /// The operator's hands drive from now on: the policy's chunks count no more. This changes no
    /// state.
    TakeOver,
    /// The policy drives again: the targets of the hands count no more, nor does what answers an
    /// observation from before. This changes no state.
    HandBack,
    /// The run's own hold ends: follow the policy again, from its first chunk that starts where the
    /// arm is.
    GoOn,
}

/// What can change the operating state.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Event {
    /// The operator's wish.
    Operator(OperatorEvent),
    /// The controller found a fault.
    Fail,
}

/// The state after `event`; a request that does not apply leaves the state as it is.
#[must_use]
pub const fn next(state: OperatingState, event: Event) -> OperatingState {
    use Event::{Fail, Operator};
    use OperatingState::{Disabled, Enabled, Fault, Paused};
    use OperatorEvent::{Clear, Disable, Enable, GoOn, HandBack, Pause, Resume, Speed, TakeOver};
    match (state, event) {
        (Disabled | Enabled | Paused | Fault, Fail) => Fault,
        (Disabled | Enabled | Paused | Fault, Operator(Speed { .. } | TakeOver | HandBack)) => {
            state
        }

        (Disabled, Operator(Enable)) => Enabled,
        (Disabled, Operator(Disable | Pause | Resume | GoOn | Clear)) => Disabled,

        (Enabled, Operator(Enable | Resume | GoOn | Clear)) => Enabled,
        (Enabled, Operator(Disable)) => Disabled,
        (Enabled, Operator(Pause)) => Paused,

        (Paused, Operator(Enable | Pause | Clear)) => Paused,
        (Paused, Operator(Disable)) => Disabled,
        (Paused, Operator(Resume | GoOn)) => Enabled,

        (Fault, Operator(Enable | Disable | Pause | Resume | GoOn)) => Fault,
        (Fault, Operator(Clear)) => Disabled,
    }
}

#[cfg(test)]
mod tests {
    use super::{Event, OperatingState, OperatorEvent, next};

    fn state_named(name: &str) -> OperatingState {
        let all = [
            OperatingState::Disabled,
            OperatingState::Enabled,
            OperatingState::Paused,
            OperatingState::Fault,
        ];
        all.into_iter().find(|state| state.name() == name).unwrap()
    }

    #[test]
    fn the_table_in_the_documentation_is_the_function() {
        let events = [
            Event::Operator(OperatorEvent::Enable),
            Event::Operator(OperatorEvent::Disable),
            Event::Operator(OperatorEvent::Pause),
            Event::Operator(OperatorEvent::Resume),
            Event::Operator(OperatorEvent::Clear),
            Event::Operator(OperatorEvent::Speed { percent: 50 }),
            Event::Operator(OperatorEvent::TakeOver),
            Event::Operator(OperatorEvent::HandBack),
            Event::Operator(OperatorEvent::GoOn),
            Event::Fail,
        ];
        let rows: Vec<Vec<&str>> = include_str!("mode.rs")
            .lines()
            .take_while(|line| line.starts_with("//!"))
            .filter_map(|line| line.strip_prefix("//! | "))
            .skip(1)
            .map(|line| {
                line.split('|')
                    .map(str::trim)
                    .filter(|cell| !cell.is_empty())
                    .collect()
            })
            .filter(|cells: &Vec<&str>| !cells[0].starts_with('-'))
            .collect();
        assert_eq!(rows.len(), 4);
        for row in rows {
            assert_eq!(row.len(), 1 + events.len(), "{row:?}");
            for (event, expected) in events.iter().zip(&row[1..]) {
                assert_eq!(
                    next(state_named(row[0]), *event),
                    state_named(expected),
                    "{} on {event:?}",
                    row[0]
                );
            }
        }
    }

    #[test]
    fn a_fault_is_left_only_by_clearing_it() {
        for event in [
            OperatorEvent::Enable,
            OperatorEvent::Disable,
            OperatorEvent::Pause,
            OperatorEvent::Resume,
            OperatorEvent::GoOn,
        ] {
            assert_eq!(
                next(OperatingState::Fault, Event::Operator(event)),
                OperatingState::Fault
            );
        }
        assert_eq!(
            next(OperatingState::Fault, Event::Operator(OperatorEvent::Clear)),
            OperatingState::Disabled
        );
    }
}
