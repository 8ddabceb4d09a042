//! How numbers are compared, and the margins printed.

use tch::{Kind, Tensor};

/// `actual` is within `relative` of `expected`.
pub(crate) fn check_close(what: &str, actual: f64, expected: f64, relative: f64) {
    // Zero is met by zero alone.
    let error = (actual - expected).abs() / expected.abs().max(f64::MIN_POSITIVE);
    println!("{what}: {actual} against {expected}, off by {error:.2e}");
    assert!(
        error <= relative,
        "{what}: {actual} instead of {expected}, off by {error:e}"
    );
}

/// No number of `actual` is off by more than `relative` of the greatest in `expected`.
pub(crate) fn check_all(what: &str, actual: &Tensor, expected: &[f64], relative: f64) {
    let actual = Vec::<f64>::try_from(actual.to_kind(Kind::Double).flatten(0, -1)).unwrap();
    assert_eq!(actual.len(), expected.len(), "{what}: how many numbers");
    let scale = expected.iter().fold(0.0_f64, |scale, x| scale.max(x.abs()));
    let error = expected
        .iter()
        .zip(&actual)
        .fold(0.0_f64, |worst, (a, b)| worst.max((a - b).abs()))
        / scale;
    println!("{what}: off by {error:.2e} of its scale {scale:.2}");
    // A NaN would not be caught by the greatest.
    assert!(actual.iter().all(|x| x.is_finite()), "{what}: not finite");
    assert!(error <= relative, "{what}: off by {error:e} of its scale");
}
