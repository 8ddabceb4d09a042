//! Process data: how the communication and mapping parameters of 1400h to 1BFFh are packed.
//!
//! CiA 301: tables 65 and 69 (COB-ID), 66 and 70 (transmission type), figures 77 and 79 (mapping
//! entry).

use super::Address;
use crate::{CanId, WireError};

const INVALID: u32 = 1 << 31;
const NO_RTR: u32 = 1 << 30;
const EXTENDED: u32 = 1 << 29;

/// Sub-index 01h of a communication record, whatever it holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(transparent)]
pub struct CobView(pub u32);

impl CobView {
    /// Whether the PDO exists.
    #[must_use]
    pub const fn is_valid(self) -> bool {
        self.0 & INVALID == 0
    }

    /// Whether a remote frame (RTR) may request it.
    #[must_use]
    pub const fn allows_rtr(self) -> bool {
        self.0 & NO_RTR == 0
    }

    /// The identifier.
    ///
    /// # Errors
    /// [`WireError::Value`] for a 29-bit identifier.
    pub fn id(self) -> Result<CanId, WireError> {
        let bits = self.0 & 0x1FFF_FFFF;
        u16::try_from(bits)
            .ok()
            .filter(|_| self.0 & EXTENDED == 0)
            .and_then(CanId::new)
            .ok_or(WireError::Value {
                field: "COB-ID",
                value: self.0,
            })
    }
}

/// The identifier of a PDO and whether the PDO is in use.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct PdoCob {
    /// The identifier.
    pub id: CanId,
    /// Whether the PDO exists.
    pub valid: bool,
    /// Whether a remote frame (RTR) may request it.
    pub rtr: bool,
}

impl PdoCob {
    /// What sub-index 01h says.
    ///
    /// # Errors
    /// [`WireError::Value`] for a 29-bit identifier.
    pub fn parse(raw: u32) -> Result<Self, WireError> {
        let view = CobView(raw);
        Ok(Self {
            id: view.id()?,
            valid: view.is_valid(),
            rtr: view.allows_rtr(),
        })
    }

    /// What to write to sub-index 01h.
    #[must_use]
    pub fn emit(self) -> u32 {
        let valid = if self.valid { 0 } else { INVALID };
        let rtr = if self.rtr { 0 } else { NO_RTR };
        u32::from(self.id.raw()) | valid | rtr
    }
}

/// When a PDO is sent or takes effect: sub-index 02h.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Transmission {
    /// At the next SYNC after a change.
    SyncAcyclic,
    /// At every n-th SYNC, 1 to 240. A received PDO takes effect at the next SYNC, whatever n is.
    SyncCyclic(SyncCount),
    /// Sampled at SYNC, sent on RTR.
    RtrSync,
    /// Sent on RTR.
    RtrEvent,
    /// At once, as the vendor likes.
    EventVendor,
    /// At once, as the device profile says.
    EventProfile,
}

/// A number of SYNCs, 1 to 240.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SyncCount(u8);

impl SyncCount {
    /// Each SYNC.
    pub const EVERY: Self = Self(1);

    /// `count` SYNCs, none outside 1 to 240.
    #[must_use]
    pub const fn new(count: u8) -> Option<Self> {
        if count >= 1 && count <= 240 {
            Some(Self(count))
        } else {
            None
        }
    }

    /// Its number.
    #[must_use]
    pub const fn raw(self) -> u8 {
        self.0
    }
}

impl Transmission {
    /// Its byte.
    #[must_use]
    pub const fn raw(self) -> u8 {
        match self {
            Self::SyncAcyclic => 0,
            Self::SyncCyclic(count) => count.0,
            Self::RtrSync => 252,
            Self::RtrEvent => 253,
            Self::EventVendor => 254,
            Self::EventProfile => 255,
        }
    }

    /// Whether a SYNC decides when.
    #[must_use]
    pub const fn is_synchronous(self) -> bool {
        matches!(self, Self::SyncAcyclic | Self::SyncCyclic(_))
    }
}

impl TryFrom<u8> for Transmission {
    type Error = WireError;

    fn try_from(raw: u8) -> Result<Self, WireError> {
        match raw {
            0 => Ok(Self::SyncAcyclic),
            1..=240 => Ok(Self::SyncCyclic(SyncCount(raw))),
            241..=251 => Err(WireError::Value {
                field: "transmission type",
                value: raw.into(),
            }),
            252 => Ok(Self::RtrSync),
            253 => Ok(Self::RtrEvent),
            254 => Ok(Self::EventVendor),
            255 => Ok(Self::EventProfile),
        }
    }
}

/// One entry of a mapping record: which object, and how many of its bits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct MappingEntry {
    /// The object.
    pub address: Address,
    /// Its length, bits.
    pub bits: u8,
}

impl MappingEntry {
    /// What a mapping entry says. Every value says something; whether there is such an object is
    /// the dictionary's.
    #[must_use]
    pub fn parse(raw: u32) -> Self {
        let [bits, sub, low, high] = raw.to_le_bytes();
        Self {
            address: Address {
                index: u16::from_le_bytes([low, high]),
                sub,
            },
            bits,
        }
    }

    /// What to write to the mapping record.
    #[must_use]
    pub fn emit(self) -> u32 {
        let [low, high] = self.address.index.to_le_bytes();
        u32::from_le_bytes([self.bits, self.address.sub, low, high])
    }
}
