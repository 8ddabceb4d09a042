//! Homing: where the axis stands (methods 35 and 37), or at a limit switch (method 17 the negative
//! one, 18 the positive one).
//!
//! CiA 402-2, clause 10. A limit switch is active where the range of the encoder ends. The drive
//! moves to it at the first homing speed, away from it at the second, and its home point is where
//! the switch is no longer active.

use super::super::motion::Motion;
use super::{AtRest, Drive, speed_max};
use crate::dictionary::Dictionary;
use hal::TimeNs;
use trocar_canopen::cia402::{Mode, PowerState};
use trocar_canopen::index;
use trocar_canopen::number::{real, seconds};

/// How far a velocity reaches ahead of the drive's next look, ns.
const AHEAD_NS: u64 = 1_000_000;

/// A homing sequence under way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Search {
    /// Moves forward only; a rising edge of bit 4 begins anew.
    phase: Phase,
    /// When the velocity was last changed.
    since: TimeNs,
    /// Counts/s.
    velocity: f64,
}

/// Towards the switch, back off it, and to rest.
///
/// The limit switch of the method: the first phase ends when it becomes active, the second when it
/// no longer is, where the home point is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Phase {
    ToSwitch,
    OffSwitch,
    Stopping,
}

impl Drive {
    /// A rising edge of the control word's bit 4 starts, a falling one interrupts.
    pub(super) fn on_homing_bit(
        &mut self,
        now: TimeNs,
        was: bool,
        is: bool,
        dictionary: &Dictionary,
    ) {
        if self.mode != Mode::Homing {
            return;
        }
        if is && !was {
            self.start_homing(now, dictionary);
        } else if was && !is && self.search.take().is_some() {
            self.brake(now, Some(dictionary.get(index::DECELERATION)), AtRest::Stay);
        }
    }

    /// Starts the method of 6098h: at once where it moves nothing.
    fn start_homing(&mut self, now: TimeNs, dictionary: &Dictionary) {
        if direction(dictionary).is_none() {
            self.reference(self.feedback.position_counts, dictionary);
            self.motion = Motion::Rest {
                position: self.actual(),
            };
            self.homed = true;
            return;
        }
        self.homed = false;
        self.search = Some(Search {
            phase: Phase::ToSwitch,
            since: now,
            velocity: 0.0,
        });
    }

    /// Gives the encoder's position `home` the value of the home offset.
    ///
    /// Afterwards 6064h reads 607Ch there.
    fn reference(&mut self, home: f64, dictionary: &Dictionary) {
        self.offset = real(dictionary.get(index::HOME_OFFSET)) - home;
    }

    /// Goes on with a homing sequence.
    ///
    /// Each look changes the velocity by at most 609Ah times the time since the last, and points a
    /// line of 1 ms ahead. Any stop, halt, change of mode or loss of torque ends the sequence, and
    /// the axis is not homed then. Speeds are 6099h:01 and 6099h:02, at most the greatest speed.
    pub(super) fn search(&mut self, now: TimeNs, dictionary: &Dictionary) {
        let (Some(mut search), Some(direction)) = (self.search.take(), direction(dictionary))
        else {
            return;
        };
        let goes_on = self.state == PowerState::OperationEnabled
            && self.mode == Mode::Homing
            && self.at_rest == AtRest::Stay
            && !self.halted;
        if !goes_on {
            return;
        }
        let mut from = self.motion.at(now).0;
        let [negative, positive] = self.limit_switches(dictionary);
        let active = if direction < 0.0 { negative } else { positive };
        match search.phase {
            // It stands against the end of its range.
            Phase::ToSwitch if active => {
                from = self.actual();
                search.velocity = 0.0;
                search.phase = Phase::OffSwitch;
            }
            Phase::OffSwitch if !active => {
                let before = self.offset;
                self.reference(self.feedback.position_counts, dictionary);
                from += self.offset - before;
                search.phase = Phase::Stopping;
            }
            Phase::ToSwitch | Phase::OffSwitch | Phase::Stopping => {}
        }
        let get = |address| real(dictionary.get(address));
        let fastest = speed_max(dictionary);
        let wanted = match search.phase {
            Phase::ToSwitch => direction * get(index::HOMING_SWITCH_SPEED).min(fastest),
            Phase::OffSwitch => -direction * get(index::HOMING_ZERO_SPEED).min(fastest),
            Phase::Stopping => 0.0,
        };
        let change = get(index::HOMING_ACCELERATION) * seconds(now.since(search.since));
        search.velocity += (wanted - search.velocity).clamp(-change, change);
        search.since = now;
        if search.phase == Phase::Stopping && search.velocity.abs() <= 0.0 {
            self.motion = Motion::Rest { position: from };
            self.homed = true;
            return;
        }
        self.motion = Motion::Line {
            start: now,
            from,
            to: from + search.velocity * seconds(AHEAD_NS),
            period_ns: AHEAD_NS,
            deceleration: get(index::HOMING_ACCELERATION),
        };
        self.search = Some(search);
    }

    /// Whether the negative and the positive limit switch are active: at the ends of the encoder's
    /// range, whatever the home offset.
    pub(super) fn limit_switches(&self, dictionary: &Dictionary) -> [bool; 2] {
        let position = self.feedback.position_counts;
        [
            position <= real(dictionary.get(index::RANGE_MIN)),
            position >= real(dictionary.get(index::RANGE_MAX)),
        ]
    }
}

/// Which way the homing method moves first; none if it does not move.
fn direction(dictionary: &Dictionary) -> Option<f64> {
    match dictionary.get(index::HOMING_METHOD) {
        17 => Some(-1.0),
        18 => Some(1.0),
        _ => None,
    }
}
