//! The feedback that a drive reports, and its supervision of the motor.
//!
//! CiA 402-2: table 31 (status word), 6065h and 6066h (following error).

use super::{AtRest, Drive};
use crate::dictionary::Dictionary;
use hal::TimeNs;
use trocar_canopen::cia402::{Mode, Status};
use trocar_canopen::index;
use trocar_canopen::number::{real, whole};

impl Drive {
    /// How far the motor is from its demand: 6062h less 6064h.
    ///
    /// Counts, signed.
    fn deviation(&self, now: TimeNs) -> f64 {
        self.motion.at(now).0 - self.actual()
    }

    /// Whether the following error is beyond its window (6065h) now: bit 13 of the status word. The
    /// time 6066h is [`Self::leaves_its_window`]'s.
    ///
    /// A window of FFFF FFFFh switches the supervision off (CiA 402-2, 6065h).
    fn deviates(&self, now: TimeNs, dictionary: &Dictionary) -> bool {
        let window = dictionary.get(index::FOLLOWING_WINDOW);
        self.state.has_torque()
            && window < i64::from(u32::MAX)
            && self.deviation(now).abs() > real(window)
    }

    /// Whether the motor has been too far from its demand for too long.
    pub(in super::super) fn leaves_its_window(
        &mut self,
        now: TimeNs,
        dictionary: &Dictionary,
    ) -> bool {
        if !self.deviates(now, dictionary) {
            self.deviates_since = None;
            return false;
        }
        let since = *self.deviates_since.get_or_insert(now);
        let limit_ms: u64 = dictionary.get_as(index::FOLLOWING_TIME);
        now.since(since) >= limit_ms * 1_000_000
    }

    /// Writes the actual values and the status word into the dictionary.
    ///
    /// Called after everything that changes the drive, so that an SDO or a TPDO never reads a state
    /// from before that change. `remote` and `warning` are bits of the status word that the node
    /// knows. Bit 12 says in cyclic mode that the drive follows the command, in homing that the
    /// axis is homed; the limit switches are bits 0 and 1 of 60FDh.
    pub(in super::super) fn report(
        &mut self,
        now: TimeNs,
        remote: bool,
        warning: bool,
        dictionary: &mut Dictionary,
    ) {
        let (demand, _) = self.motion.at(now);
        let homing = self.mode == Mode::Homing;
        let rests = self.motion.rests(now);
        let status = Status {
            state: self.state,
            voltage: true,
            warning,
            remote,
            target_reached: rests && (homing || self.halted),
            internal_limit: self.limited && self.follows_sync(),
            follows: if homing {
                self.homed
            } else {
                self.follows_sync() && !self.halted && self.at_rest == AtRest::Stay
            },
            deviation: !homing && self.deviates(now, dictionary),
        };
        let actual = self.actual();
        let (demand, position) = (whole(demand), whole(actual));
        let [negative, positive] = self.limit_switches(dictionary);
        let inputs = i64::from(negative) | i64::from(positive) << 1;
        for (address, value) in [
            (index::STATUS, i64::from(status.emit())),
            (index::MODE_DISPLAY, i64::from(self.mode.raw())),
            (index::POSITION_DEMAND, demand),
            (index::POSITION, position),
            (index::VELOCITY, whole(self.feedback.velocity_counts_s)),
            (index::TORQUE, whole(self.feedback.torque_per_mille)),
            (index::FOLLOWING_ERROR, demand - position),
            (index::INPUTS, inputs),
        ] {
            dictionary.set(address, value);
        }
    }
}
