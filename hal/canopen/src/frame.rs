//! A classical CAN data frame with an 11-bit identifier, the only kind that CANopen's default set
//! uses.

use core::fmt;

use hal::count::count_u8;

/// Most data bytes in a classical frame.
pub const PAYLOAD_MAX: usize = 8;

/// An 11-bit identifier; the lower one wins the bus.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct CanId(u16);

impl CanId {
    /// The identifier `raw`, none above 7FFh.
    #[must_use]
    pub const fn new(raw: u16) -> Option<Self> {
        if raw <= 0x7FF { Some(Self(raw)) } else { None }
    }

    /// The identifier whose lower eleven bits are those of `raw`.
    #[must_use]
    pub const fn truncated(raw: u16) -> Self {
        Self(raw & 0x7FF)
    }

    /// Its number.
    #[must_use]
    pub const fn raw(self) -> u16 {
        self.0
    }
}

/// A CANopen node, 1 to 127.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct NodeId(u8);

impl NodeId {
    /// The node `raw`, none for 0 and above 127.
    #[must_use]
    pub const fn new(raw: u8) -> Option<Self> {
        if raw >= 1 && raw <= 127 {
            Some(Self(raw))
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

impl fmt::Display for NodeId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        self.0.fmt(f)
    }
}

/// Zero to eight bytes; those past the length are zero.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Payload {
    bytes: [u8; PAYLOAD_MAX],
    length: u8,
}

impl Payload {
    /// No byte at all.
    pub const EMPTY: Self = Self {
        bytes: [0; PAYLOAD_MAX],
        length: 0,
    };

    /// A copy of `bytes`, none if there are more than eight.
    #[must_use]
    pub fn new(bytes: &[u8]) -> Option<Self> {
        (bytes.len() <= PAYLOAD_MAX).then(|| Self::truncated(bytes))
    }

    /// The first eight of `bytes`, or all of them.
    #[must_use]
    pub fn truncated(bytes: &[u8]) -> Self {
        let mut payload = Self::EMPTY;
        for byte in bytes.iter().take(PAYLOAD_MAX) {
            payload.bytes[usize::from(payload.length)] = *byte;
            payload.length += 1;
        }
        payload
    }

    /// All eight bytes.
    #[must_use]
    pub const fn full(bytes: [u8; PAYLOAD_MAX]) -> Self {
        Self { bytes, length: 8 }
    }

    /// The bytes.
    #[must_use]
    pub fn as_slice(&self) -> &[u8] {
        &self.bytes[..usize::from(self.length)]
    }

    /// How many there are.
    #[must_use]
    pub const fn length(&self) -> u8 {
        self.length
    }
}

/// A data frame: who says it, and what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Frame {
    /// Identifier, which is also the priority.
    pub id: CanId,
    /// Data.
    pub payload: Payload,
}

impl Frame {
    /// A frame.
    #[must_use]
    pub const fn new(id: CanId, payload: Payload) -> Self {
        Self { id, payload }
    }

    /// Its data bytes.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        self.payload.as_slice()
    }
}

impl fmt::Display for Frame {
    /// As candump writes it: `185#27060000`.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:03X}#", self.id.raw())?;
        self.data()
            .iter()
            .try_for_each(|byte| write!(f, "{byte:02X}"))
    }
}

/// Why bytes do not mean what they should.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum WireError {
    /// The frame has the wrong number of data bytes.
    Length {
        /// Bytes that the service has.
        expected: u8,
        /// Bytes that came.
        found: u8,
    },
    /// A field holds a value that the standard reserves.
    Value {
        /// The field, as the standard names it.
        field: &'static str,
        /// What it holds.
        value: u32,
    },
}

impl fmt::Display for WireError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Length { expected, found } => {
                write!(f, "{found} data bytes instead of {expected}")
            }
            Self::Value { field, value } => write!(f, "{field} holds the reserved {value:#x}"),
        }
    }
}

impl std::error::Error for WireError {}

/// `bytes` as an array of the length that a service has.
pub(crate) fn exactly<const N: usize>(bytes: &[u8]) -> Result<[u8; N], WireError> {
    bytes.try_into().map_err(|_| WireError::Length {
        expected: const { count_u8(N) },
        found: u8::try_from(bytes.len()).unwrap_or(u8::MAX),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_frame_prints_as_candump_does() {
        let frame = Frame::new(CanId::truncated(0x185), Payload::truncated(&[0x27, 6]));
        assert_eq!(frame.to_string(), "185#2706");
        let sync = Frame::new(CanId::truncated(0x80), Payload::EMPTY);
        assert_eq!(sync.to_string(), "080#");
    }

    #[test]
    fn nine_bytes_are_no_payload() {
        assert!(Payload::new(&[0; 9]).is_none());
        assert_eq!(Payload::new(&[1; 8]), Some(Payload::full([1; 8])));
    }
}
