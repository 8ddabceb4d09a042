//! The control word and the status word.
//!
//! CiA 402-2: tables 27 and 28 (control word, command coding), tables 31 and 32 (status word, state
//! coding).

use super::{Command, PowerState};
use crate::WireError;

/// A control word, whatever it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub struct ControlView(pub u16);

impl ControlView {
    const fn bit(self, bit: u8) -> bool {
        self.0 >> bit & 1 == 1
    }

    /// The command in bits 0 to 3. Bits that a command leaves open are not looked at, so each
    /// pattern is one of the five.
    #[must_use]
    pub const fn command(self) -> Command {
        let (on, voltage, quick_stop_off, enable) =
            (self.bit(0), self.bit(1), self.bit(2), self.bit(3));
        match (voltage, quick_stop_off, on, enable) {
            (false, _, _, _) => Command::DisableVoltage,
            (true, false, _, _) => Command::QuickStop,
            (true, true, false, _) => Command::Shutdown,
            (true, true, true, false) => Command::SwitchOn,
            (true, true, true, true) => Command::EnableOperation,
        }
    }

    /// Bit 7, whose rising edge resets a fault.
    #[must_use]
    pub const fn fault_reset(self) -> bool {
        self.bit(7)
    }

    /// Bits 4 to 6, whose meaning the mode decides; bit 4 starts homing.
    #[must_use]
    pub const fn mode_bits(self) -> u8 {
        let [low, _] = self.0.to_le_bytes();
        low >> 4 & 7
    }

    /// Bit 8: stop, and stay enabled.
    #[must_use]
    pub const fn halt(self) -> bool {
        self.bit(8)
    }
}

/// What a control word asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Control {
    /// State machine.
    pub command: Command,
    /// The fault-reset bit.
    pub fault_reset: bool,
    /// Stop, and stay enabled.
    pub halt: bool,
    /// Start of homing: bit 4.
    pub start: bool,
}

impl Control {
    /// `command` alone.
    #[must_use]
    pub const fn new(command: Command) -> Self {
        Self {
            command,
            fault_reset: false,
            halt: false,
            start: false,
        }
    }

    /// What `raw` asks for.
    ///
    /// # Errors
    /// [`WireError::Value`] for bits that no mode spoken here uses.
    pub const fn parse(raw: u16) -> Result<Self, WireError> {
        let view = ControlView(raw);
        if raw & 0xFE60 != 0 {
            return Err(WireError::Value {
                field: "control word",
                value: raw as u32,
            });
        }
        Ok(Self {
            command: view.command(),
            fault_reset: view.fault_reset(),
            halt: view.halt(),
            start: view.mode_bits() & 1 == 1,
        })
    }

    /// The control word.
    #[must_use]
    pub fn emit(self) -> u16 {
        let command = match self.command {
            Command::Shutdown => 0x06,
            Command::SwitchOn => 0x07,
            Command::EnableOperation => 0x0F,
            Command::DisableVoltage => 0x00,
            Command::QuickStop => 0x02,
        };
        command
            | u16::from(self.start) << 4
            | u16::from(self.fault_reset) << 7
            | u16::from(self.halt) << 8
    }
}

/// A status word, whatever it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub struct StatusView(pub u16);

impl StatusView {
    const fn bit(self, bit: u8) -> bool {
        self.0 >> bit & 1 == 1
    }

    /// The power state that bits 0 to 3, 5 and 6 code.
    ///
    /// # Errors
    /// [`WireError::Value`] for a pattern that codes none.
    pub const fn state(self) -> Result<PowerState, WireError> {
        Ok(match (self.0 & 0x4F, self.0 & 0x6F) {
            (0x00, _) => PowerState::NotReady,
            (0x40, _) => PowerState::SwitchOnDisabled,
            (0x0F, _) => PowerState::FaultReaction,
            (0x08, _) => PowerState::Fault,
            (_, 0x21) => PowerState::ReadyToSwitchOn,
            (_, 0x23) => PowerState::SwitchedOn,
            (_, 0x27) => PowerState::OperationEnabled,
            (_, 0x07) => PowerState::QuickStopActive,
            _ => {
                return Err(WireError::Value {
                    field: "status word",
                    value: self.0 as u32,
                });
            }
        })
    }
}

/// The status word (6041h).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Status {
    /// Power state.
    pub state: PowerState,
    /// Bit 4: the power stage has voltage.
    pub voltage: bool,
    /// Bit 7: something is not right, but the drive goes on.
    pub warning: bool,
    /// Bit 9: the control word counts.
    pub remote: bool,
    /// Bit 10: target reached; at rest in homing.
    pub target_reached: bool,
    /// Bit 11: a limit holds the drive back.
    pub internal_limit: bool,
    /// Bit 12: the drive follows its set-points; homed in homing.
    pub follows: bool,
    /// Bit 13: following error; homing error in homing.
    pub deviation: bool,
}

impl Status {
    /// What `raw` says; the vendor's bits 8, 14 and 15 are not looked at.
    ///
    /// # Errors
    /// [`WireError::Value`] for a pattern that codes no power state.
    pub fn parse(raw: u16) -> Result<Self, WireError> {
        let view = StatusView(raw);
        Ok(Self {
            state: view.state()?,
            voltage: view.bit(4),
            warning: view.bit(7),
            remote: view.bit(9),
            target_reached: view.bit(10),
            internal_limit: view.bit(11),
            follows: view.bit(12),
            deviation: view.bit(13),
        })
    }

    /// The status word. Bit 5 is set unless a quick stop is active.
    #[must_use]
    pub fn emit(self) -> u16 {
        let state = match self.state {
            PowerState::NotReady => 0x00,
            PowerState::SwitchOnDisabled => 0x60,
            PowerState::ReadyToSwitchOn => 0x21,
            PowerState::SwitchedOn => 0x23,
            PowerState::OperationEnabled => 0x27,
            PowerState::QuickStopActive => 0x07,
            PowerState::FaultReaction => 0x2F,
            PowerState::Fault => 0x28,
        };
        state
            | u16::from(self.voltage) << 4
            | u16::from(self.warning) << 7
            | u16::from(self.remote) << 9
            | u16::from(self.target_reached) << 10
            | u16::from(self.internal_limit) << 11
            | u16::from(self.follows) << 12
            | u16::from(self.deviation) << 13
    }
}
