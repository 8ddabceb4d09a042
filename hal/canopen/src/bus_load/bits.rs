//! How many bits a classical frame has on the wire.
//!
//! ISO 11898-1: a data frame with an 11-bit identifier has 34 + 8n bits that are stuffed (start,
//! identifier, control, data, checksum) and 13 that are not (checksum and acknowledge delimiters,
//! acknowledge, end, and the 3 bits between frames).

use crate::Frame;

/// Bits that are never stuffed.
const FIXED: u32 = 13;

/// Bits of a frame with `data_bytes` without any stuffing.
#[must_use]
pub const fn least(data_bytes: u8) -> u32 {
    47 + 8 * data_bytes as u32
}

/// Bits of a frame with `data_bytes` at most: a stuff bit after the first five bits and then after
/// every four.
#[must_use]
pub const fn most(data_bytes: u8) -> u32 {
    least(data_bytes) + (34 + 8 * data_bytes as u32 - 1) / 4
}

/// Bits of this very frame.
#[must_use]
pub fn exact(frame: &Frame) -> u32 {
    let mut counter = Stuffing::default();
    let mut checksum = 0_u16;
    let mut push = |bit: bool| {
        counter.push(bit);
        checksum = crc15(checksum, bit);
    };
    // Start of frame, identifier, no remote request, no extension, reserved, length.
    push(false);
    (0..11)
        .rev()
        .for_each(|n| push(frame.id.raw() >> n & 1 == 1));
    (0..3).for_each(|_| push(false));
    (0..4)
        .rev()
        .for_each(|n| push(frame.payload.length() >> n & 1 == 1));
    for byte in frame.data() {
        (0..8).rev().for_each(|n| push(byte >> n & 1 == 1));
    }
    (0..15)
        .rev()
        .for_each(|n| counter.push(checksum >> n & 1 == 1));
    counter.bits + FIXED
}

/// Counts bits with the stuff bits among them.
#[derive(Default)]
struct Stuffing {
    bits: u32,
    run: u32,
    last: Option<bool>,
}

impl Stuffing {
    fn push(&mut self, bit: bool) {
        self.run = if self.last == Some(bit) {
            self.run + 1
        } else {
            1
        };
        self.last = Some(bit);
        self.bits += 1;
        if self.run == 5 {
            self.bits += 1;
            self.last = Some(!bit);
            self.run = 1;
        }
    }
}

/// The checksum's next state: polynomial 4599h.
const fn crc15(state: u16, bit: bool) -> u16 {
    let feedback = (state >> 14 & 1 == 1) != bit;
    let shifted = state << 1 & 0x7FFF;
    if feedback { shifted ^ 0x4599 } else { shifted }
}

/// How long `bits` take at `bit_rate` bits a second, ns.
#[must_use]
pub fn duration_ns(bits: u32, bit_rate: u32) -> u64 {
    u64::from(bits) * 1_000_000_000 / u64::from(bit_rate.max(1))
}
