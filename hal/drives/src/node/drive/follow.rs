//! What a drive follows: the mode, the SYNC, and what it does when it is left alone or fails.
//!
//! CiA 402-2, clause 12 (cyclic synchronous position); 6007h and 605Eh.
//!
//! A target of 607Ah plus 60B0h is cut to 607Dh, then to what the greatest speed reaches in an
//! interpolation period (60C2h). The motor goes there in a straight line over that period;
//! acceleration and jerk are the master's to limit.

use super::super::motion::Motion;
use super::{AtRest, Drive, interpolation_ns, speed_max};
use crate::dictionary::Dictionary;
use hal::TimeNs;
use trocar_canopen::cia301::emcy::register;
use trocar_canopen::cia402::{Command, Event, Mode, PowerState};
use trocar_canopen::index;
use trocar_canopen::number::{real, seconds};

impl Drive {
    /// 6060h was written: when the mode changes an enabled drive brakes with 6084h.
    pub(in super::super) fn on_mode(&mut self, now: TimeNs, dictionary: &Dictionary) {
        let raw: i8 = dictionary.get_as(index::MODE);
        if let Ok(mode) = Mode::try_from(raw)
            && mode != self.mode
        {
            self.mode = mode;
            if self.state == PowerState::OperationEnabled {
                let deceleration = dictionary.get(index::DECELERATION);
                self.brake(now, Some(deceleration), self.at_rest);
            }
        }
    }

    /// A SYNC: the newest target becomes the end of a line.
    ///
    /// Does nothing in another mode, halted, or while it brakes.
    pub(in super::super) fn on_sync(&mut self, now: TimeNs, dictionary: &Dictionary) {
        if !self.follows_sync() || self.halted || self.at_rest != AtRest::Stay {
            return;
        }
        let get = |address| real(dictionary.get(address));
        let wanted = get(index::TARGET) + get(index::POSITION_OFFSET);
        let inside = wanted.max(get(index::LIMIT_MIN)).min(get(index::LIMIT_MAX));
        let from = self.motion.at(now).0;
        let period_ns = interpolation_ns(dictionary);
        let reach = speed_max(dictionary) * seconds(period_ns);
        let to = from + (inside - from).clamp(-reach, reach);
        self.limited = (to - wanted).abs() > 0.5;
        self.motion = Motion::Line {
            start: now,
            from,
            to,
            period_ns,
            deceleration: get(index::QUICK_STOP_DECELERATION),
        };
    }

    /// What 6007h says about a lost master.
    ///
    /// 0 nothing, 1 fault, 2 disable voltage, 3 quick stop. Bits 0 to 3 of the stored control word
    /// are cleared in any case, so that the drive does not enable itself when its stop is over.
    pub(in super::super) fn lose_connection(&mut self, now: TimeNs, dictionary: &Dictionary) {
        match dictionary.get(index::ABORT_OPTION) {
            1 => {
                self.fault(now, register::COMMUNICATION, dictionary);
            }
            2 => self.command(now, Command::DisableVoltage, dictionary),
            3 => self.command(now, Command::QuickStop, dictionary),
            _ => {}
        }
        // What was said before the loss does not count after it.
        self.control &= !0x000F;
    }

    /// A fault; tells whether it is a new one.
    ///
    /// `bits` go into 1001h. 605Eh says how it stops: 0 coast, 1 ramp (6084h), 2 quick ramp
    /// (6085h). It loses its torque at the end.
    pub(in super::super) fn fault(
        &mut self,
        now: TimeNs,
        bits: u8,
        dictionary: &Dictionary,
    ) -> bool {
        self.register |= bits;
        if matches!(self.state, PowerState::FaultReaction | PowerState::Fault) {
            return false;
        }
        let moving = self.state.has_torque();
        self.event(Event::FaultDetected);
        let deceleration = match dictionary.get(index::FAULT_OPTION) {
            1 => Some(dictionary.get(index::DECELERATION)),
            2 => Some(dictionary.get(index::QUICK_STOP_DECELERATION)),
            _ => None,
        };
        let done = AtRest::Send(Event::FaultReactionDone);
        self.brake(now, deceleration.filter(|_| moving), done);
        true
    }
}
