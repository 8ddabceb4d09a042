//! Numbers between the widths that voxels, triangles and files have. What does not fit is a
//! programming error, and asserted.
//!
//! Conversions live here so that each cast, and the reason why it is safe, stands in one place.

/// A count as a real number; exact below 2^53.
#[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
pub(crate) const fn real(count: usize) -> f64 {
    count as f64
}

/// An index in 32 bits, as meshes keep them.
///
/// Panics at `u32::MAX` and above. `u32::MAX` itself is kept free: vertices, samples and parts use
/// it for "none".
#[expect(clippy::cast_possible_truncation, reason = "asserted to fit")]
pub(crate) const fn index(count: usize) -> u32 {
    assert!(count < u32::MAX as usize, "more indices than 32 bits have");
    count as u32
}

/// A count in 16 bits with a sign, as headers of volumes keep it.
///
/// Panics beyond `i16::MAX`.
#[expect(clippy::cast_possible_truncation, reason = "asserted to fit")]
pub(crate) const fn count_i16(count: usize) -> i16 {
    assert!(count < 1 << 15, "a count beyond 15 bits");
    count as i16
}

/// The whole number at or below `value`, cut to `0..=most`.
///
/// NaN gives 0, which is what keeps lattice look-ups of hostile meshes within their lists.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "cut to a range that fits; NaN gives 0"
)]
pub(crate) fn floor_to(value: f64, most: usize) -> usize {
    value.clamp(0.0, real(most)) as usize
}

/// `value` in single precision, as assets keep coordinates.
#[expect(
    clippy::cast_possible_truncation,
    reason = "rounding is what is asked for"
)]
pub(crate) const fn single(value: f64) -> f32 {
    value as f32
}

/// `value` rounded to the nearest number of 16 bits.
///
/// Halves go away from 0, NaN gives 0.
#[expect(clippy::cast_possible_truncation, reason = "cut to the range")]
pub(crate) fn rounded_i16(value: f64) -> i16 {
    value.round().clamp(-32768.0, 32767.0) as i16
}

/// `value` as a label if it is a whole number of 16 bits.
///
/// None for fractions, NaN, infinities and what is outside of `[0, 65535]`; -0.0 is 0.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "checked to be whole and in range"
)]
pub(crate) fn label(value: f64) -> Option<u16> {
    let whole = (0.0..=65535.0).contains(&value) && value.fract().abs() <= 0.0;
    whole.then_some(value as u16)
}

#[cfg(test)]
mod tests {
    use super::{count_i16, floor_to, label};

    #[test]
    #[should_panic(expected = "beyond 15 bits")]
    fn a_count_beyond_15_bits_is_a_defect() {
        let _ = count_i16(1 << 15);
    }

    #[test]
    fn only_whole_numbers_of_16_bits_are_labels() {
        assert_eq!(label(117.0), Some(117));
        assert_eq!(label(-0.0), Some(0));
        for value in [-1.0, 0.5, 65536.0, f64::NAN, f64::INFINITY] {
            assert_eq!(label(value), None, "{value}");
        }
    }

    #[test]
    fn floors_stay_in_their_range() {
        assert_eq!(floor_to(-3.0, 5), 0);
        assert_eq!(floor_to(2.9, 5), 2);
        assert_eq!(floor_to(9.0, 5), 5);
        assert_eq!(floor_to(f64::NAN, 5), 0);
    }
}
