//! The data of a transfer: in the initiating frame, or in segments.
//!
//! CiA 301, figures 12 to 15.

use crate::Payload;

/// How an initiating frame carries its data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Content {
    /// In itself.
    Expedited(Expedited),
    /// In segments that follow, this many bytes in all if that is said.
    Segmented(Option<u32>),
}

/// One to four bytes that fit into the initiating frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Expedited {
    pub(super) data: Payload,
    pub(super) sized: bool,
}

impl Expedited {
    /// `data` with its size, none unless it has one to four bytes.
    #[must_use]
    pub fn new(data: &[u8]) -> Option<Self> {
        (1..=4).contains(&data.len()).then(|| Self {
            data: Payload::truncated(data),
            sized: true,
        })
    }

    /// The bytes: all four if the frame does not say how many count.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        self.data.as_slice()
    }

    /// Whether the frame says how many bytes count.
    #[must_use]
    pub const fn is_sized(&self) -> bool {
        self.sized
    }
}

/// Zero to seven bytes of a longer value.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Segment {
    pub(super) toggle: bool,
    pub(super) data: Payload,
    pub(super) last: bool,
}

impl Segment {
    /// The first seven bytes of `rest`, marked as the last ones if there are no more.
    #[must_use]
    pub fn first_of(rest: &[u8], toggle: bool) -> Self {
        let count = rest.len().min(7);
        Self {
            toggle,
            data: Payload::truncated(&rest[..count]),
            last: count == rest.len(),
        }
    }

    /// The toggle bit.
    #[must_use]
    pub const fn toggle(&self) -> bool {
        self.toggle
    }

    /// The bytes.
    #[must_use]
    pub fn data(&self) -> &[u8] {
        self.data.as_slice()
    }

    /// Whether it is the last one.
    #[must_use]
    pub const fn is_last(&self) -> bool {
        self.last
    }

    pub(super) fn emit(self, specifier: u8) -> Payload {
        let unused = 7 - self.data.length();
        let mut bytes = [0; 8];
        bytes[0] = specifier << 5 | u8::from(self.toggle) << 4 | unused << 1 | u8::from(self.last);
        bytes[1..=self.data().len()].copy_from_slice(self.data());
        Payload::full(bytes)
    }
}
