//! Counts on the bus are whole, motion is not.

/// The whole number nearest to `value`; the ends of the range for what is beyond, 0 for NaN.
#[must_use]
#[expect(
    clippy::cast_possible_truncation,
    reason = "the cast saturates, which is what is wanted"
)]
pub(crate) fn whole(value: f64) -> i64 {
    value.round() as i64
}

/// `value` as a real number.
#[must_use]
#[expect(
    clippy::cast_precision_loss,
    reason = "values on the bus have 32 bits, which are exact; nanoseconds are below 2^53 for 104 days"
)]
pub(crate) fn real(value: i64) -> f64 {
    value as f64
}

/// Nanoseconds as seconds.
#[must_use]
pub(crate) fn seconds(ns: u64) -> f64 {
    real(i64::try_from(ns).unwrap_or(i64::MAX)) * 1e-9
}

/// `seconds` as nanoseconds; 0 for what is negative.
#[must_use]
pub(crate) fn nanoseconds(seconds: f64) -> u64 {
    u64::try_from(whole(seconds * 1e9)).unwrap_or(0)
}
