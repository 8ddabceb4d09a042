//! Counts and indices between the widths of integers. What does not fit is a programming error, and
//! asserted.

/// `count` in 32 bits: vertices of a mesh, layers of a texture, pixels of a side.
///
/// # Panics
/// If it takes more.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "asserted to fit")]
pub const fn count_u32(count: usize) -> u32 {
    assert!(count <= u32::MAX as usize, "a count beyond 32 bits");
    count as u32
}

/// `count` in 8 bits: axes of an arm, entries of a mapping, lines of a bus.
///
/// # Panics
/// If it takes more.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "asserted to fit")]
pub const fn count_u8(count: usize) -> u8 {
    assert!(count <= u8::MAX as usize, "a count beyond 8 bits");
    count as u8
}

/// `number` as an index or a length in memory, which has 64 bits.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "both have 64 bits")]
pub const fn index(number: u64) -> usize {
    const { assert!(usize::BITS == 64) };
    number as usize
}

#[cfg(test)]
mod tests {
    use super::{count_u8, count_u32, index};

    #[test]
    fn numbers_that_fit_stay_the_same() {
        assert_eq!(count_u32(index(0xffff_ffff)), u32::MAX);
        assert_eq!(count_u8(255), u8::MAX);
        assert_eq!(index(u64::MAX), usize::MAX);
    }

    #[test]
    #[should_panic(expected = "beyond 8 bits")]
    fn a_count_beyond_8_bits_is_a_defect() {
        let _ = count_u8(256);
    }

    #[test]
    #[should_panic(expected = "beyond 32 bits")]
    fn a_count_beyond_32_bits_is_a_defect() {
        let _ = count_u32(1 << 32);
    }
}
