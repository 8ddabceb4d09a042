//! Depth as whole numbers of a stated unit: what recordings keep, and what clouds are made from, in
//! training and at run time.

/// Depth of one unit, m. A depth is rounded to the nearest, so by 10 micrometres at most.
pub const DEPTH_UNIT_M: f64 = 2e-5;

/// The greatest depth that can be stored, m; what is farther away has none. About 1.31 m: an
/// endoscope sees a few decimetres.
pub const DEPTH_MAX_M: f64 = DEPTH_UNIT_M * u16::MAX as f64;

/// `depth_m` in units; 0 where there is none, it is not a number, negative, or beyond
/// [`DEPTH_MAX_M`].
#[must_use]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a whole number in range, by the comparison before"
)]
pub fn depth_units(depth_m: f32) -> u16 {
    let units = (f64::from(depth_m) / DEPTH_UNIT_M).round();
    if units >= 1.0 && units <= f64::from(u16::MAX) {
        units as u16
    } else {
        0
    }
}

/// The depth of so many units, m.
#[must_use]
#[expect(
    clippy::cast_possible_truncation,
    reason = "depths are in single precision"
)]
pub fn depth_from_units(units: u16) -> f32 {
    (f64::from(units) * DEPTH_UNIT_M) as f32
}

#[cfg(test)]
mod tests {
    use super::{DEPTH_MAX_M, DEPTH_UNIT_M, depth_from_units, depth_units};

    #[test]
    fn every_unit_survives_the_way_there_and_back() {
        for units in 0..=u16::MAX {
            assert_eq!(depth_units(depth_from_units(units)), units);
        }
    }

    #[test]
    fn rounding_stays_within_half_a_unit() {
        for step in 1_u16..2000 {
            let depth = f32::from(step) * 0.000_633;
            let error = f64::from(depth_from_units(depth_units(depth))) - f64::from(depth);
            assert!(error.abs() <= 0.5 * DEPTH_UNIT_M + 1e-7, "{depth}: {error}");
        }
    }

    #[test]
    #[expect(clippy::cast_possible_truncation, reason = "one unit beyond the end")]
    fn what_is_no_depth_has_none() {
        let beyond = (DEPTH_MAX_M + DEPTH_UNIT_M) as f32;
        for depth in [
            0.0,
            -0.1,
            f32::NAN,
            f32::INFINITY,
            f32::NEG_INFINITY,
            beyond,
        ] {
            assert_eq!(depth_units(depth), 0, "{depth}");
        }
    }
}
