//! Farthest-point sampling: each next point is the one farthest from all that were taken.
//!
//! Exact: the result is that of the plain algorithm, which updates every point's distance in every
//! round, to the bit. Points lie in buckets, and a bucket none of whose points can come nearer to
//! the new sample than they are to an old one is left alone. See [`Buckets`] for why no rounding
//! can upset that.

use super::Point;
use super::buckets::Buckets;
use super::error::PerceptionError;

/// Indices of `count` of `points`: index 0, then always the point whose squared distance to the
/// taken ones is greatest, the first of equals.
///
/// When every point is taken that differs from the others, the rest is index 0 again, the first of
/// all that are at distance zero. Squared distances are `(dx² + dy²) + dz²` in single precision.
/// The plain algorithm is O(points * count); here a round costs the buckets and the points of those
/// near the new sample. Any prefix of the result is the result for a smaller `count`.
///
/// # Errors
/// [`PerceptionError`] if there is no point, one is not finite, or `count` is 0.
pub fn farthest_points(points: &[Point], count: usize) -> Result<Vec<usize>, PerceptionError> {
    if count == 0 {
        return Err(PerceptionError::NoPoints);
    }
    let mut buckets = Buckets::new(points)?;
    let mut taken = Vec::with_capacity(count);
    taken.push(0);
    let mut newest = 0;
    while taken.len() < count {
        buckets.take(&points[newest]);
        newest = buckets.farthest();
        taken.push(newest);
        if newest == 0 {
            break;
        }
    }
    taken.resize(count, 0);
    Ok(taken)
}
