//! What an object is: type, access, range and preset of each of its values.
//!
//! CiA 301: table 44 (data types), table 42 (object codes), table 43 (access); CiA 306 for their
//! spelling in a data sheet.

use trocar_canopen::bytes::Bytes;
use trocar_canopen::cia301::{AbortCode, Address};

/// A type of value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DataType {
    /// Signed, 8 bits.
    I8,
    /// Signed, 16 bits.
    I16,
    /// Signed, 32 bits.
    I32,
    /// Unsigned, 8 bits.
    U8,
    /// Unsigned, 16 bits.
    U16,
    /// Unsigned, 32 bits.
    U32,
    /// Visible string.
    Text,
}

impl DataType {
    /// The type's index, which is also the index of the dummy object that fills a gap in an RPDO.
    #[must_use]
    pub const fn code(self) -> u16 {
        match self {
            Self::I8 => 0x0002,
            Self::I16 => 0x0003,
            Self::I32 => 0x0004,
            Self::U8 => 0x0005,
            Self::U16 => 0x0006,
            Self::U32 => 0x0007,
            Self::Text => 0x0009,
        }
    }

    /// The type that fills a gap under `address`, none if it is no dummy.
    #[must_use]
    pub fn dummy(address: Address) -> Option<Self> {
        let all = [
            Self::I8,
            Self::I16,
            Self::I32,
            Self::U8,
            Self::U16,
            Self::U32,
        ];
        let found = all.into_iter().find(|kind| kind.code() == address.index);
        found.filter(|_| address.sub == 0)
    }

    /// Length, bits; 0 for a text, which has none of its own.
    #[must_use]
    pub const fn bits(self) -> u8 {
        match self {
            Self::I8 | Self::U8 => 8,
            Self::I16 | Self::U16 => 16,
            Self::I32 | Self::U32 => 32,
            Self::Text => 0,
        }
    }

    /// Least and greatest number.
    #[must_use]
    pub const fn range(self) -> (i64, i64) {
        match self {
            Self::I8 => (-0x80, 0x7F),
            Self::I16 => (-0x8000, 0x7FFF),
            Self::I32 => (-0x8000_0000, 0x7FFF_FFFF),
            Self::U8 => (0, 0xFF),
            Self::U16 => (0, 0xFFFF),
            Self::U32 => (0, 0xFFFF_FFFF),
            Self::Text => (0, 0),
        }
    }

    /// The bytes of `number`, lowest first.
    #[must_use]
    pub fn encode(self, number: i64) -> Bytes {
        let bytes = number.to_le_bytes();
        Bytes::truncated(&bytes[..usize::from(self.bits() / 8)])
    }

    /// The number in `data`.
    ///
    /// # Errors
    /// The code to abort with if the length is not the type's.
    pub fn decode(self, data: &[u8]) -> Result<i64, AbortCode> {
        let length = usize::from(self.bits() / 8);
        if data.len() > length {
            return Err(AbortCode::TOO_LONG);
        }
        if data.len() < length {
            return Err(AbortCode::TOO_SHORT);
        }
        let negative = self.range().0 < 0 && data.last().is_some_and(|byte| byte & 0x80 != 0);
        let mut bytes = [if negative { 0xFF } else { 0 }; 8];
        bytes[..length].copy_from_slice(data);
        Ok(i64::from_le_bytes(bytes))
    }
}

/// Who may do what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Access {
    /// Clients read; the node changes it.
    ReadOnly,
    /// Clients write.
    WriteOnly,
    /// Clients read and write.
    ReadWrite,
    /// Never changes.
    Constant,
}

/// Which process data may hold an object.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mapping {
    /// None.
    No,
    /// What the drive sends.
    Transmit,
    /// What the drive receives.
    Receive,
}

/// A value after power-on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Preset {
    /// This number.
    Number(i64),
    /// This number plus the node's own.
    PerNode(i64),
    /// This text.
    Text(&'static str),
}

/// One value of an object.
#[derive(Clone, Debug)]
pub struct Entry {
    /// Where.
    pub address: Address,
    /// Its name in the data sheet.
    pub name: String,
    /// Its type.
    pub kind: DataType,
    /// Who may do what.
    pub access: Access,
    /// Which process data may hold it.
    pub mapping: Mapping,
    /// Value after power-on.
    pub preset: Preset,
    /// Least number that a client may write.
    pub low: i64,
    /// Greatest number that a client may write.
    pub high: i64,
}

impl Entry {
    /// A value of which process data hold nothing and of which all numbers may be written.
    #[must_use]
    pub fn new(address: Address, name: &str, kind: DataType, access: Access, preset: i64) -> Self {
        let (low, high) = kind.range();
        Self {
            address,
            name: name.to_owned(),
            kind,
            access,
            mapping: Mapping::No,
            preset: Preset::Number(preset),
            low,
            high,
        }
    }

    /// With a preset that counts from the node's own number, or that is a text.
    #[must_use]
    pub fn preset(mut self, preset: Preset) -> Self {
        self.preset = preset;
        self
    }

    /// Allowed in process data.
    #[must_use]
    pub fn mapped(mut self, mapping: Mapping) -> Self {
        self.mapping = mapping;
        self
    }

    /// Of which only `low` to `high` may be written.
    #[must_use]
    pub fn range(mut self, low: i64, high: i64) -> Self {
        (self.low, self.high) = (low, high);
        self
    }
}

/// What an object is made of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// One value.
    Variable,
    /// Values of one kind.
    Array,
    /// Values of several kinds.
    Record,
}

impl Shape {
    /// The standard's object code.
    #[must_use]
    pub const fn code(self) -> u8 {
        match self {
            Self::Variable => 7,
            Self::Array => 8,
            Self::Record => 9,
        }
    }
}

/// An object.
#[derive(Clone, Debug)]
pub struct Object {
    /// Index.
    pub index: u16,
    /// Name in the data sheet.
    pub name: String,
    /// What it is made of.
    pub shape: Shape,
    /// Its values by sub-index.
    pub entries: Vec<Entry>,
}
