//! The predefined connection set: which identifier belongs to which service of which node.
//!
//! CiA 301, tables 67 and 68 (section 7.3.5).

use crate::{CanId, NodeId};

/// Broadcast: network management.
pub const NMT_ID: CanId = CanId::truncated(0x000);
/// Broadcast: synchronisation, as 1005h has it by default.
pub const SYNC_ID: CanId = CanId::truncated(0x080);
/// Broadcast: time stamp.
pub const TIME_ID: CanId = CanId::truncated(0x100);

/// PDOs that a node has identifiers for.
pub const PDO_COUNT: u8 = 4;

/// One of a node's four PDOs in a direction, numbered from 0.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct PdoNumber(u8);

impl PdoNumber {
    /// PDO 1 of a device.
    pub const FIRST: Self = Self(0);

    /// The PDO `number` from 0, none from 4 on.
    #[must_use]
    pub const fn new(number: u8) -> Option<Self> {
        if number < PDO_COUNT {
            Some(Self(number))
        } else {
            None
        }
    }

    /// Its number, from 0.
    #[must_use]
    pub const fn raw(self) -> u8 {
        self.0
    }
}

/// What an identifier stands for by default.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cob {
    /// Network management command, 000h.
    Nmt,
    /// Synchronisation, 080h.
    Sync,
    /// Time stamp, 100h.
    Time,
    /// Emergency of a node, 080h + node.
    Emergency(NodeId),
    /// What a node says of its process data, 180h, 280h, 380h, 480h + node.
    TransmitPdo(PdoNumber, NodeId),
    /// Process data to a node, 200h, 300h, 400h, 500h + node.
    ReceivePdo(PdoNumber, NodeId),
    /// Answer of a node's dictionary, 580h + node.
    SdoResponse(NodeId),
    /// Question to a node's dictionary, 600h + node.
    SdoRequest(NodeId),
    /// Boot-up, heartbeat and guarding of a node, 700h + node.
    Heartbeat(NodeId),
    /// No default meaning.
    Other(CanId),
}

impl Cob {
    /// The meaning of `id`.
    #[must_use]
    pub fn of(id: CanId) -> Self {
        let [low, _] = (id.raw() & 0x7F).to_le_bytes();
        let function = id.raw() & 0x780;
        let Some(node) = NodeId::new(low) else {
            return match function {
                0x000 => Self::Nmt,
                0x080 => Self::Sync,
                0x100 => Self::Time,
                _ => Self::Other(id),
            };
        };
        let [above, _] = (function >> 7).to_le_bytes();
        match above {
            1 => Self::Emergency(node),
            3 | 5 | 7 | 9 => Self::TransmitPdo(PdoNumber((above - 3) / 2), node),
            4 | 6 | 8 | 10 => Self::ReceivePdo(PdoNumber((above - 4) / 2), node),
            11 => Self::SdoResponse(node),
            12 => Self::SdoRequest(node),
            14 => Self::Heartbeat(node),
            _ => Self::Other(id),
        }
    }

    /// The identifier.
    #[must_use]
    pub fn id(self) -> CanId {
        let at = |function: u16, node: NodeId| CanId::truncated(function + u16::from(node.raw()));
        match self {
            Self::Nmt => NMT_ID,
            Self::Sync => SYNC_ID,
            Self::Time => TIME_ID,
            Self::Emergency(node) => at(0x080, node),
            Self::TransmitPdo(number, node) => at(0x180 + 0x100 * u16::from(number.0), node),
            Self::ReceivePdo(number, node) => at(0x200 + 0x100 * u16::from(number.0), node),
            Self::SdoResponse(node) => at(0x580, node),
            Self::SdoRequest(node) => at(0x600, node),
            Self::Heartbeat(node) => at(0x700, node),
            Self::Other(id) => id,
        }
    }
}
