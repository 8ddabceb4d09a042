//! Dimensions of tensors, which libtorch counts in `i64`, as lengths and back. Out of range is a
//! programming error, and asserted.

use tch::Tensor;

/// The length that a tensor's dimension says.
///
/// # Panics
/// If it is negative.
#[must_use]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "not negative, and a length has 64 bits"
)]
pub const fn length(dimension: i64) -> usize {
    const { assert!(usize::BITS == 64) };
    assert!(dimension >= 0, "a tensor's dimension is negative");
    dimension as usize
}

/// The dimension of a tensor of so many.
///
/// # Panics
/// If nothing in memory can be that long: more than `isize::MAX`.
#[must_use]
#[expect(clippy::cast_possible_wrap, reason = "asserted not to wrap")]
pub const fn dimension(length: usize) -> i64 {
    const { assert!(usize::BITS == 64) };
    assert!(length <= isize::MAX as usize, "longer than memory can be");
    length as i64
}

/// The last dimension of `tensor`: the features of each element.
pub(crate) fn width(tensor: &Tensor) -> i64 {
    let shape = tensor.size();
    assert!(!shape.is_empty(), "a tensor without dimensions");
    shape[shape.len() - 1]
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
        let _ = length(-1);
    }

    #[test]
    #[should_panic(expected = "longer than memory")]
    fn a_length_beyond_memory_is_a_defect() {
        let _ = dimension(usize::MAX);
    }

    #[test]
    #[should_panic(expected = "without dimensions")]
    fn a_scalar_has_no_width() {
        assert_eq!(
            width(&Tensor::from_slice(&[[1.0_f32; 5]; 2].concat()).view([2, 5])),
            5
        );
        let _ = width(&Tensor::from(1.0_f32));
    }
}
