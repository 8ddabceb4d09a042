//! Emergencies: what a node says when something went wrong, and when it is over.
//!
//! CiA 301, section 7.2.7: figure 31 (frame), table 26 (codes); 1001h in table 48 (error register).
//! Codes from CiA 402-2, table 7, where they concern a drive.

use core::fmt;

use super::Cob;
use super::codes::codes;
use crate::frame::exactly;
use crate::{Frame, NodeId, Payload, WireError};

/// Bytes of an emergency, whatever they hold.
#[derive(Clone, Copy, Debug)]
pub struct EmergencyView<'a>(pub &'a [u8]);

impl EmergencyView<'_> {
    /// The error code; 0000h says that the error is gone.
    ///
    /// # Errors
    /// [`WireError::Length`].
    pub fn code(&self) -> Result<ErrorCode, WireError> {
        let [low, high, ..] = exactly::<8>(self.0)?;
        Ok(ErrorCode(u16::from_le_bytes([low, high])))
    }

    /// The error register, 1001h.
    ///
    /// # Errors
    /// [`WireError::Length`].
    pub fn register(&self) -> Result<u8, WireError> {
        let [_, _, register, ..] = exactly::<8>(self.0)?;
        Ok(register)
    }

    /// What the vendor adds.
    ///
    /// # Errors
    /// [`WireError::Length`].
    pub fn vendor(&self) -> Result<[u8; 5], WireError> {
        let [_, _, _, vendor @ ..] = exactly::<8>(self.0)?;
        Ok(vendor)
    }
}

/// An emergency. Every combination of codes is allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Emergency {
    /// What happened.
    pub code: ErrorCode,
    /// The error register, 1001h, as [`register`] has its bits.
    pub register: u8,
    /// Vendor's own.
    pub vendor: [u8; 5],
}

impl Emergency {
    /// What the data bytes of an emergency mean.
    ///
    /// # Errors
    /// [`WireError::Length`].
    pub fn parse(data: &[u8]) -> Result<Self, WireError> {
        let view = EmergencyView(data);
        Ok(Self {
            code: view.code()?,
            register: view.register()?,
            vendor: view.vendor()?,
        })
    }

    /// The frame that `node` sends.
    #[must_use]
    pub fn emit(self, node: NodeId) -> Frame {
        let [low, high] = self.code.0.to_le_bytes();
        let [a, b, c, d, e] = self.vendor;
        Frame::new(
            Cob::Emergency(node).id(),
            Payload::full([low, high, self.register, a, b, c, d, e]),
        )
    }
}

/// Bits of the error register, 1001h.
pub mod register {
    /// Any error at all.
    pub const GENERIC: u8 = 1 << 0;
    /// Current.
    pub const CURRENT: u8 = 1 << 1;
    /// Voltage.
    pub const VOLTAGE: u8 = 1 << 2;
    /// Temperature.
    pub const TEMPERATURE: u8 = 1 << 3;
    /// Communication.
    pub const COMMUNICATION: u8 = 1 << 4;
    /// What the device profile defines.
    pub const PROFILE: u8 = 1 << 5;
    /// Vendor's own.
    pub const VENDOR: u8 = 1 << 7;
}

/// The error register, 1001h, as [`register`] has its bits.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorRegister(pub u8);

/// Bits of the error register with their names.
const BITS: [(u8, &str); 8] = [
    (register::GENERIC, "generic"),
    (register::CURRENT, "current"),
    (register::VOLTAGE, "voltage"),
    (register::TEMPERATURE, "temperature"),
    (register::COMMUNICATION, "communication"),
    (register::PROFILE, "device profile"),
    (1 << 6, "reserved"),
    (register::VENDOR, "manufacturer"),
];

impl fmt::Display for ErrorRegister {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:02X}h", self.0)?;
        let set = BITS.iter().filter(|(bit, _)| self.0 & bit != 0);
        for ((_, name), before) in set.zip([": "].into_iter().chain(core::iter::repeat(", "))) {
            write!(f, "{before}{name}")?;
        }
        Ok(())
    }
}

/// An error code of an emergency, which 603Fh repeats.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ErrorCode(pub u16);

impl fmt::Display for ErrorCode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let text = self.text().unwrap_or("a code of the drive's own");
        write!(f, "{:04X}h, {text}", self.0)
    }
}

codes! {
    ErrorCode;
    /// The error is gone.
    RESET = 0x0000, "no error";
    /// Something.
    GENERIC = 0x1000, "generic error";
    /// Continuous over-current at the motor.
    OVER_CURRENT = 0x2310, "continuous over-current";
    /// Short circuit.
    SHORT_CIRCUIT = 0x2320, "short circuit";
    /// DC link above its limit.
    OVER_VOLTAGE = 0x3210, "DC link over-voltage";
    /// DC link below its limit.
    UNDER_VOLTAGE = 0x3220, "DC link under-voltage";
    /// The drive is too hot.
    DRIVE_TEMPERATURE = 0x4310, "drive over-temperature";
    /// A parameter does not fit.
    PARAMETER = 0x6320, "parameter error";
    /// The motor does not turn.
    MOTOR_BLOCKED = 0x7121, "motor blocked";
    /// The encoder's signal is wrong.
    ENCODER = 0x7305, "incremental encoder";
    /// Frames were lost in the controller.
    CAN_OVERRUN = 0x8110, "CAN overrun";
    /// The controller counts many errors.
    CAN_PASSIVE = 0x8120, "CAN in error passive mode";
    /// Heartbeat consumer time-out.
    HEARTBEAT = 0x8130, "heartbeat lost";
    /// The controller was bus-off and is back.
    BUS_OFF_RECOVERED = 0x8140, "recovered from bus-off";
    /// Another node has this node's identifier.
    ID_COLLISION = 0x8150, "identifier collision";
    /// An RPDO is shorter than its mapping.
    PDO_LENGTH = 0x8210, "PDO too short for its mapping";
    /// An RPDO is longer than its mapping.
    PDO_EXCESS = 0x8220, "PDO longer than its mapping";
    /// A SYNC of the wrong length.
    SYNC_LENGTH = 0x8240, "unexpected SYNC length";
    /// An RPDO is overdue.
    RPDO_TIMEOUT = 0x8250, "RPDO overdue";
    /// The motor is too far from where it should be.
    FOLLOWING_ERROR = 0x8611, "following error";
    /// The homing procedure failed.
    HOMING = 0x8613, "homing error";
    /// The drive misses its SYNC.
    SYNC_CONTROLLER = 0x8700, "SYNC lost";
}
