//! Seeded numbers for tests that throw arbitrary frames (splitmix64).

use super::{CanId, Frame, Payload};

pub(crate) struct Random(u64);

impl Random {
    pub(crate) fn new(seed: u64) -> Self {
        Self(seed)
    }

    pub(crate) fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9E37_79B9_7F4A_7C15);
        let mut z = self.0;
        z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
        z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
        z ^ (z >> 31)
    }

    pub(crate) fn byte(&mut self) -> u8 {
        self.next().to_le_bytes()[3]
    }

    pub(crate) fn below(&mut self, count: u64) -> u64 {
        self.next() % count
    }

    /// Up to eight arbitrary bytes.
    pub(crate) fn payload(&mut self) -> Payload {
        let bytes = self.next().to_le_bytes();
        // Half of them whole, since most services have eight bytes.
        let length = if self.byte() < 128 {
            8
        } else {
            usize::from(self.byte() % 9)
        };
        Payload::truncated(&bytes[..length])
    }

    /// An arbitrary frame with an arbitrary identifier.
    pub(crate) fn frame(&mut self) -> Frame {
        let id = u16::from_le_bytes([self.byte(), self.byte()]);
        Frame::new(CanId::truncated(id), self.payload())
    }
}
