//! Numbers in memory as vector instructions like them.
//!
//! A `Vec` of `f32` is aligned to 4 bytes only; these begin at a multiple of 64 without any unsafe
//! code, by leaving up to 15 numbers in front unused. Where they begin changes no result.

use std::fmt;
use std::ops::{Deref, DerefMut};

/// Bytes that memory is read by; a vector that lies across two such lines takes twice the reading.
const LINE: usize = 64;

/// Numbers that begin with a line of memory.
#[derive(Default)]
pub(crate) struct Aligned {
    /// With some numbers more, since a line need not begin where an allocation does.
    memory: Vec<f32>,
    /// Where the numbers begin in `memory`.
    first: usize,
    /// How many there are.
    length: usize,
}

impl Aligned {
    /// `length` zeros.
    pub(crate) fn zeros(length: usize) -> Self {
        let memory = vec![0.0; length + LINE / size_of::<f32>() - 1];
        // Of a vector as long as this one at most; none where it is unknown.
        let first = memory.as_ptr().align_offset(LINE);
        let most = memory.len() - length;
        Self {
            memory,
            first: first.min(most),
            length,
        }
    }

    /// The same numbers.
    pub(crate) fn of(numbers: &[f32]) -> Self {
        let mut aligned = Self::zeros(numbers.len());
        aligned.copy_from_slice(numbers);
        aligned
    }

    /// At least `length` numbers, whatever they are. Reallocates only if there are fewer; the old
    /// numbers are then lost.
    pub(crate) fn grow(&mut self, length: usize) {
        if self.len() < length {
            *self = Self::zeros(length);
        }
    }
}

/// Without the numbers, of which there may be millions.
impl fmt::Debug for Aligned {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(formatter, "{} numbers", self.length)
    }
}

impl Deref for Aligned {
    type Target = [f32];

    fn deref(&self) -> &[f32] {
        &self.memory[self.first..][..self.length]
    }
}

impl DerefMut for Aligned {
    fn deref_mut(&mut self) -> &mut [f32] {
        &mut self.memory[self.first..][..self.length]
    }
}

#[cfg(test)]
mod tests {
    use super::{Aligned, LINE};

    #[test]
    fn numbers_begin_with_a_line_and_are_as_many_as_asked_for() {
        for length in [0, 1, 15, 16, 17, 1000] {
            let mut numbers = Aligned::zeros(length);
            assert_eq!(&*numbers, vec![0.0; length]);
            assert!(length == 0 || numbers.as_ptr().addr().is_multiple_of(LINE));
            numbers.fill(3.0);
            assert_eq!(&*Aligned::of(&numbers), vec![3.0; length]);
        }
    }

    #[test]
    fn growing_never_takes_numbers_away() {
        let mut numbers = Aligned::default();
        for (asked, expected) in [(0, 0), (5, 5), (3, 5), (40, 40), (40, 40)] {
            numbers.grow(asked);
            assert_eq!(numbers.len(), expected);
        }
    }
}
