//! Dimensions of tensors, which libtorch counts in `i64`, as lengths and back. Neither is out of the other's range, which is asserted.

/// The length that a tensor's dimension says: none is negative.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "not negative, and a length has 64 bits"
)]
pub(crate) const fn length(dimension: i64) -> usize {
    const { assert!(usize::BITS == 64) };
    assert!(dimension >= 0, "a tensor's dimension is negative");
    dimension as usize
}

/// The dimension of a tensor of so many: nothing in memory is longer than `isize::MAX` bytes.
#[expect(clippy::cast_possible_wrap, reason = "asserted not to wrap")]
pub(crate) const fn dimension(length: usize) -> i64 {
    const { assert!(usize::BITS == 64) };
    assert!(length <= isize::MAX as usize, "longer than memory can be");
    length as i64
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lengths_and_dimensions_are_the_same_numbers() {
        for number in [0, 1, 7, 1 << 40] {
            assert_eq!(dimension(length(number)), number);
        }
        assert_eq!(dimension(usize::MAX / 2), i64::MAX);
    }

    #[test]
    #[should_panic(expected = "negative")]
    fn a_negative_dimension_is_a_defect() {
        length(-1);
    }
}
