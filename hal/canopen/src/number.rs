//! Numbers as the bus has them: counts are whole, motion is not.

/// The whole number nearest to `value`; the ends of the range for what is beyond, 0 for NaN.
#[must_use]
#[expect(
    clippy::cast_possible_truncation,
    reason = "the cast saturates, which is what is wanted"
)]
pub fn whole(value: f64) -> i64 {
    value.round() as i64
}

/// `value` as a real number.
#[must_use]
#[expect(
    clippy::cast_precision_loss,
    reason = "values on the bus have 32 bits, which are exact; nanoseconds are below 2^53 for 104 days"
)]
pub fn real(value: i64) -> f64 {
    value as f64
}

/// Nanoseconds as seconds.
#[must_use]
pub fn seconds(ns: u64) -> f64 {
    real(i64::try_from(ns).unwrap_or(i64::MAX)) * 1e-9
}

/// `seconds` as nanoseconds; 0 for what is negative.
#[must_use]
pub fn nanoseconds(seconds: f64) -> u64 {
    u64::try_from(whole(seconds * 1e9)).unwrap_or(0)
}

/// The whole turns a minute of a motor with `counts_per_turn` that are no slower than `counts_s`
/// and at least one.
#[must_use]
pub fn turns_a_minute(counts_s: u32, counts_per_turn: u32) -> i64 {
    let (counts_min, turn) = (u64::from(counts_s) * 60, u64::from(counts_per_turn).max(1));
    i64::try_from(counts_min.div_ceil(turn).max(1)).unwrap_or(i64::MAX)
}
