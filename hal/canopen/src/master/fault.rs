//! Why an arm on a bus stopped. Each of these is latched: only a new bring-up leads out of it.

use core::fmt;

use super::axis::Rejected;
use super::plan::AxisNode;
use crate::CanId;
use crate::cia301::NmtState;
use crate::cia301::emcy::ErrorCode;
use crate::cia402::PowerState;
use hal::ArmError;

/// What happened.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Fault {
    /// Our controller left the bus.
    BusOff {
        /// Which bus.
        line: u8,
    },
    /// The interface is gone or down.
    Down {
        /// Which bus.
        line: u8,
    },
    /// Set-points could not be handed to the controller for too long.
    CannotSend {
        /// Which bus.
        line: u8,
        /// Cycles in a row.
        cycles: u32,
    },
    /// Another node sends what only this arm's master may send.
    ForeignMaster {
        /// Which bus.
        line: u8,
        /// What was said.
        id: CanId,
    },
    /// No heartbeat.
    NodeLost(AxisNode),
    /// The node was reset: it booted up while it was in use.
    Rebooted(AxisNode),
    /// The node left operational.
    LeftOperational(AxisNode, NmtState),
    /// The node sent an emergency.
    Emergency(AxisNode, ErrorCode),
    /// No process data for so many cycles.
    Silent(AxisNode, u32),
    /// Process data that can't be used for so many cycles, and what is wrong with it.
    Unusable(AxisNode, Rejected, u32),
    /// Less than three in four of its process data come in time.
    Unsteady(AxisNode),
    /// The drive is not enabled any more, or did not become so in time.
    NotEnabled(AxisNode, PowerState),
    /// The motor is too far from its set-point, by this many counts.
    FollowingError(AxisNode, u32),
    /// The drive's power stage has no voltage.
    PowerLost(AxisNode),
}

impl Fault {
    /// The axis that it concerns, none if it is the bus.
    #[must_use]
    pub const fn who(&self) -> Option<AxisNode> {
        match self {
            Self::BusOff { .. }
            | Self::Down { .. }
            | Self::CannotSend { .. }
            | Self::ForeignMaster { .. } => None,
            Self::NodeLost(who)
            | Self::Rebooted(who)
            | Self::LeftOperational(who, _)
            | Self::Emergency(who, _)
            | Self::Silent(who, _)
            | Self::Unusable(who, ..)
            | Self::Unsteady(who)
            | Self::NotEnabled(who, _)
            | Self::FollowingError(who, _)
            | Self::PowerLost(who) => Some(*who),
        }
    }

    /// An error code of CiA 301 that says the same, or the drive's own.
    #[must_use]
    pub const fn code(&self) -> ErrorCode {
        match self {
            Self::BusOff { .. } | Self::Down { .. } => ErrorCode::BUS_OFF_RECOVERED,
            Self::CannotSend { .. } => ErrorCode::CAN_OVERRUN,
            Self::ForeignMaster { .. } => ErrorCode::ID_COLLISION,
            Self::NodeLost(_) | Self::Rebooted(_) | Self::LeftOperational(..) => {
                ErrorCode::HEARTBEAT
            }
            Self::Emergency(_, code) => *code,
            Self::Silent(..) | Self::Unusable(..) | Self::Unsteady(_) => ErrorCode::RPDO_TIMEOUT,
            Self::NotEnabled(..) => ErrorCode::GENERIC,
            Self::FollowingError(..) => ErrorCode::FOLLOWING_ERROR,
            Self::PowerLost(_) => ErrorCode::UNDER_VOLTAGE,
        }
    }

    /// As the controller gets it. A fault of a bus is reported of the first axis.
    #[must_use]
    pub fn arm_error(&self) -> ArmError {
        ArmError::DriveFault {
            axis: self.who().map_or(0, |who| who.axis),
            code: self.code().0,
        }
    }
}

/// Whether a drive may say `code` before there is a SYNC: that it is well, or that it misses what
/// only the SYNC brings. Homing gives it SYNCs and set-points as fast as it answers, and no
/// heartbeat.
pub(super) const fn is_harmless(code: ErrorCode) -> bool {
    matches!(
        code,
        ErrorCode::RESET
            | ErrorCode::HEARTBEAT
            | ErrorCode::RPDO_TIMEOUT
            | ErrorCode::SYNC_CONTROLLER
    )
}

impl fmt::Display for AxisNode {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "node {} (axis {}, bus {})",
            self.node, self.axis, self.line
        )
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::BusOff { line } => write!(f, "bus {line}: our controller is bus-off"),
            Self::Down { line } => write!(f, "bus {line}: the interface is down"),
            Self::CannotSend { line, cycles } => write!(
                f,
                "bus {line}: no room for set-points in the send queue for {cycles} cycles"
            ),
            Self::ForeignMaster { line, id } => write!(
                f,
                "bus {line}: another node sends {:03X}h, which only this master may",
                id.raw()
            ),
            Self::NodeLost(who) => write!(f, "{who}: no heartbeat"),
            Self::Rebooted(who) => write!(f, "{who}: was reset while in use"),
            Self::LeftOperational(who, state) => write!(f, "{who}: went to {state:?}"),
            Self::Emergency(who, code) => write!(f, "{who}: emergency {code}"),
            Self::Silent(who, cycles) => {
                write!(f, "{who}: no process data for {cycles} cycles")
            }
            Self::Unusable(who, rejected, cycles) => {
                write!(f, "{who}: {rejected}, for {cycles} cycles")
            }
            Self::Unsteady(who) => write!(
                f,
                "{who}: more than a quarter of its process data is missing or late"
            ),
            Self::NotEnabled(who, state) => write!(f, "{who}: is not enabled but {state:?}"),
            Self::FollowingError(who, counts) => {
                write!(f, "{who}: following error of {counts} counts")
            }
            Self::PowerLost(who) => write!(f, "{who}: the power stage has no voltage"),
        }
    }
}
