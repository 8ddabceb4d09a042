//! Sine position tables: along a sequence for the variational encoder, over the image plane for
//! image tokens.
//!
//! `pe(p, 2i) = sin(p / 10000^(2i / d))` and `pe(p, 2i + 1)` its cosine (Vaswani et al. 2017,
//! section 3.5); in the plane as in DETR (Carion et al. 2020). Computed in double precision, then
//! rounded.

use core::f64::consts::TAU;

/// The base of all frequencies.
const TEMPERATURE: f64 = 10_000.0;

/// Sine and cosine of `angle` at `width` frequencies, interleaved: even places sine, odd places
/// cosine.
fn interleaved(angle: f64, width: i64) -> impl Iterator<Item = f32> {
    (0..width).map(move |index| {
        let frequency = TEMPERATURE.powf(to_f64(2 * (index / 2)) / to_f64(width));
        let phase = angle / frequency;
        to_f32(if index % 2 == 0 {
            phase.sin()
        } else {
            phase.cos()
        })
    })
}

/// Rows of a table for `length` places in a row, row-major `length` x `width`.
#[must_use]
pub(super) fn sequence_table(length: i64, width: i64) -> Vec<f32> {
    (0..length)
        .flat_map(|place| interleaved(to_f64(place), width))
        .collect()
}

/// Rows of a table for an image of `height` x `width` tokens, row-major `(height * width)` x
/// `channels`.
///
/// The first half of the channels tells the row, the second half the column; both run over one
/// turn, counted from 1.
#[must_use]
pub(super) fn plane_table(height: i64, width: i64, channels: i64) -> Vec<f32> {
    let turn = |index: i64, count: i64| to_f64(index + 1) / (to_f64(count) + 1e-6) * TAU;
    let half = channels / 2;
    (0..height)
        .flat_map(|row| (0..width).map(move |column| (row, column)))
        .flat_map(|(row, column)| {
            interleaved(turn(row, height), half).chain(interleaved(turn(column, width), half))
        })
        .collect()
}

#[expect(clippy::cast_precision_loss, reason = "indices of tables are small")]
const fn to_f64(value: i64) -> f64 {
    value as f64
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "the network computes in single precision"
)]
const fn to_f32(value: f64) -> f32 {
    value as f32
}

#[cfg(test)]
mod tests {
    use super::{plane_table, sequence_table};

    #[test]
    fn first_place_of_a_sequence_is_sine_and_cosine_of_zero() {
        let table = sequence_table(2, 4);
        assert_eq!(table[..4], [0.0, 1.0, 0.0, 1.0]);
        assert!(
            (table[4] - 1.0_f32.sin()).abs() < 1e-7 && (table[7] - 0.01_f32.cos()).abs() < 1e-7
        );
    }

    #[test]
    fn neighbours_in_a_row_share_the_row_half() {
        let table = plane_table(2, 3, 8);
        assert_eq!(table[..4], table[8..12]);
        assert_ne!(table[4..8], table[12..16]);
    }
}
