//! What the control word does: power states, stops on the way out of them, halt.
//!
//! CiA 402-2, clause 8, and the option codes 605Ah to 605Dh.
//!
//! Bits 0 to 3 and 7 are the command, bit 4 starts homing in homing mode, bit 8 is halt. A fault is
//! reset on the rising edge of bit 7 alone.
//!
//! Option codes: 605Ah quick stop (0 coast, 1 ramp, 2 quick ramp, 5 and 6 as 1 and 2, but it stays
//! in quick stop active), 605Bh shutdown and 605Ch disable operation (0 coast, 1 ramp), 605Dh halt
//! (1 ramp, 2 quick ramp). The ramp is 6084h, the quick ramp 6085h.

use super::{AtRest, Drive};
use crate::dictionary::Dictionary;
use hal::TimeNs;
use trocar_canopen::cia402::{Command, ControlView, Event, PowerState};
use trocar_canopen::index;

impl Drive {
    /// Takes the control word; tells whether it reset a fault.
    ///
    /// Called on every write of 6040h. Fault reset and homing act on edges, the command on the
    /// level: a transition that was not possible yet is made with a later word of the same value.
    pub(in super::super) fn on_control(&mut self, now: TimeNs, dictionary: &Dictionary) -> bool {
        let raw: u16 = dictionary.get_as(index::CONTROL);
        let before = ControlView(core::mem::replace(&mut self.control, raw));
        let word = ControlView(raw);
        if word.fault_reset() && !before.fault_reset() && self.state == PowerState::Fault {
            self.register = 0;
            self.event(Event::FaultReset);
            return true;
        }
        let command = word.command();
        let enabling = matches!(command, Command::SwitchOn | Command::EnableOperation);
        if !(word.fault_reset() && enabling) {
            self.command(now, command, dictionary);
        }
        if self.state == PowerState::OperationEnabled {
            self.halt(now, word.halt(), dictionary);
            let bit = |word: ControlView| word.mode_bits() & 1 == 1;
            self.on_homing_bit(now, bit(before), bit(word), dictionary);
        }
        false
    }

    /// A command of the control word. Transitions that stop brake first, as 605Ah to 605Eh say.
    pub(super) fn command(&mut self, now: TimeNs, command: Command, dictionary: &Dictionary) {
        let option = |address| dictionary.get(address);
        let ramp = Some(option(index::DECELERATION));
        let quick = Some(option(index::QUICK_STOP_DECELERATION));
        let event = Event::Command(command);
        match (self.state, command) {
            (PowerState::OperationEnabled, Command::QuickStop) => {
                self.event(event);
                self.rearmed = false;
                let done = AtRest::Send(Event::QuickStopDone);
                match option(index::QUICK_STOP_OPTION) {
                    0 => self.brake(now, None, done),
                    1 => self.brake(now, ramp, done),
                    5 => self.brake(now, ramp, AtRest::Stay),
                    6 => self.brake(now, quick, AtRest::Stay),
                    _ => self.brake(now, quick, done),
                }
            }
            (PowerState::OperationEnabled, Command::Shutdown | Command::SwitchOn) => {
                let address = if command == Command::Shutdown {
                    index::SHUTDOWN_OPTION
                } else {
                    index::DISABLE_OPTION
                };
                // A stop that is under way for the same reason goes on.
                if self.at_rest != AtRest::Send(event) {
                    let deceleration = ramp.filter(|_| option(address) == 1);
                    self.brake(now, deceleration, AtRest::Send(event));
                }
            }
            (PowerState::QuickStopActive, Command::EnableOperation) => {
                let stays = matches!(option(index::QUICK_STOP_OPTION), 5 | 6);
                if stays && self.rearmed && self.motion.rests(now) {
                    self.event(event);
                }
            }
            (PowerState::OperationEnabled, Command::EnableOperation) => {
                // Called back from a ramp to switched-on: it stays enabled.
                self.at_rest = AtRest::Stay;
            }
            _ => {
                self.rearmed = true;
                self.event(event);
            }
        }
    }

    /// Bit 8 of the control word: brakes when it is set, as 605Dh says.
    ///
    /// The drive keeps its torque and its state; in cyclic mode the next SYNC after the bit is
    /// cleared moves it again.
    fn halt(&mut self, now: TimeNs, halt: bool, dictionary: &Dictionary) {
        if halt && !self.halted {
            let quick = dictionary.get(index::HALT_OPTION) == 2;
            let address = if quick {
                index::QUICK_STOP_DECELERATION
            } else {
                index::DECELERATION
            };
            self.brake(now, Some(dictionary.get(address)), AtRest::Stay);
        }
        self.halted = halt;
    }
}
