//! Network management: the master's commands, and the state that every node's heartbeat carries.
//!
//! CiA 301, section 7.2.8.2: table 31 ff. (node control), figure 39 (boot-up), figure 40
//! (heartbeat).

use super::Cob;
use crate::frame::exactly;
use crate::{Frame, NodeId, Payload, WireError};

/// Bytes of a node control frame, whatever they hold.
#[derive(Clone, Copy, Debug)]
pub struct NmtView<'a>(pub &'a [u8]);

impl NmtView<'_> {
    /// The command.
    ///
    /// # Errors
    /// [`WireError`] for a frame of another length or a command that the standard reserves.
    pub fn command(&self) -> Result<NmtCommand, WireError> {
        let [command, _] = exactly(self.0)?;
        NmtCommand::try_from(command)
    }

    /// Whom it is for.
    ///
    /// # Errors
    /// [`WireError`] for a frame of another length or a node above 127.
    pub fn target(&self) -> Result<NmtTarget, WireError> {
        let [_, node] = exactly(self.0)?;
        if node == 0 {
            return Ok(NmtTarget::All);
        }
        NodeId::new(node)
            .map(NmtTarget::Node)
            .ok_or(WireError::Value {
                field: "node-ID",
                value: node.into(),
            })
    }
}

/// A node control command.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NmtCommand {
    /// To operational: process data flow.
    Start,
    /// To stopped: nothing but network management and heartbeats.
    Stop,
    /// To pre-operational: no process data.
    EnterPreOperational,
    /// Everything back to its values at power-on, then boot-up.
    ResetNode,
    /// The communication profile's area back to its values at power-on, then boot-up.
    ResetCommunication,
}

impl NmtCommand {
    /// Its byte.
    #[must_use]
    pub const fn raw(self) -> u8 {
        match self {
            Self::Start => 0x01,
            Self::Stop => 0x02,
            Self::EnterPreOperational => 0x80,
            Self::ResetNode => 0x81,
            Self::ResetCommunication => 0x82,
        }
    }

    /// The frame that gives this command to `target`.
    #[must_use]
    pub fn emit(self, target: NmtTarget) -> Frame {
        let node = match target {
            NmtTarget::All => 0,
            NmtTarget::Node(node) => node.raw(),
        };
        Frame::new(Cob::Nmt.id(), Payload::truncated(&[self.raw(), node]))
    }
}

impl TryFrom<u8> for NmtCommand {
    type Error = WireError;

    fn try_from(raw: u8) -> Result<Self, WireError> {
        match raw {
            0x01 => Ok(Self::Start),
            0x02 => Ok(Self::Stop),
            0x80 => Ok(Self::EnterPreOperational),
            0x81 => Ok(Self::ResetNode),
            0x82 => Ok(Self::ResetCommunication),
            _ => Err(WireError::Value {
                field: "command specifier",
                value: raw.into(),
            }),
        }
    }
}

/// Whom a command is for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NmtTarget {
    /// Every node on the bus.
    All,
    /// One.
    Node(NodeId),
}

impl NmtTarget {
    /// Whether `node` has to obey.
    #[must_use]
    pub fn includes(self, node: NodeId) -> bool {
        match self {
            Self::All => true,
            Self::Node(target) => target == node,
        }
    }
}

/// The state that a node's heartbeat tells.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NmtState {
    /// Said once, on the way to pre-operational. From a node that was operational it means that the
    /// node was reset.
    BootUp,
    /// Nothing but network management.
    Stopped,
    /// Everything.
    Operational,
    /// Everything but process data.
    PreOperational,
}

impl NmtState {
    /// Its byte.
    #[must_use]
    pub const fn raw(self) -> u8 {
        match self {
            Self::BootUp => 0x00,
            Self::Stopped => 0x04,
            Self::Operational => 0x05,
            Self::PreOperational => 0x7F,
        }
    }

    /// The state that a heartbeat's data bytes tell.
    ///
    /// # Errors
    /// [`WireError`] for another length or a reserved state. The toggle bit of node guarding, an
    /// older service, counts as reserved.
    pub fn parse(data: &[u8]) -> Result<Self, WireError> {
        let [state] = exactly(data)?;
        match state {
            0x00 => Ok(Self::BootUp),
            0x04 => Ok(Self::Stopped),
            0x05 => Ok(Self::Operational),
            0x7F => Ok(Self::PreOperational),
            _ => Err(WireError::Value {
                field: "NMT state",
                value: state.into(),
            }),
        }
    }

    /// The heartbeat of `node`.
    #[must_use]
    pub fn emit(self, node: NodeId) -> Frame {
        Frame::new(Cob::Heartbeat(node).id(), Payload::truncated(&[self.raw()]))
    }
}
