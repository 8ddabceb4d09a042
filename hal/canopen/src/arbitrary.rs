//! Arbitrary frames, from seeded numbers: for tests of this crate and of others.

use hal::random::SplitMix64;

use crate::{CanId, Frame, Payload};

/// A source of arbitrary frames.
#[derive(Clone, Debug)]
pub struct Random(SplitMix64);

impl Random {
    /// One of `seed`.
    #[must_use]
    pub const fn new(seed: u64) -> Self {
        Self(SplitMix64::new(seed))
    }

    /// 64 arbitrary bits.
    pub const fn bits(&mut self) -> u64 {
        self.0.next_u64()
    }

    /// An arbitrary byte.
    pub fn byte(&mut self) -> u8 {
        self.bits().to_le_bytes()[3]
    }

    /// One of `0..count`.
    pub fn below(&mut self, count: u64) -> u64 {
        self.bits() % count.max(1)
    }

    /// Up to eight arbitrary bytes.
    pub fn payload(&mut self) -> Payload {
        let bytes = self.bits().to_le_bytes();
        // Half of them whole, since most services have eight bytes.
        let length = if self.byte() < 128 {
            8
        } else {
            usize::from(self.byte() % 9)
        };
        Payload::truncated(&bytes[..length])
    }

    /// An arbitrary frame with an arbitrary identifier.
    pub fn frame(&mut self) -> Frame {
        let id = u16::from_le_bytes([self.byte(), self.byte()]);
        Frame::new(CanId::truncated(id), self.payload())
    }
}
