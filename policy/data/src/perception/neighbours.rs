//! Nearest neighbours of some points among all.

use super::Point;
use super::error::PerceptionError;

/// Indices of the `count` points nearest to each of `centres`, nearest first, the first of equals
/// before the others.
///
/// A centre that is one of the points finds itself. Squared distances are `(dx² + dy²) + dz²` in
/// single precision. The result is row-major `[centres, count]`. Exhaustive, without a tree: at
/// least O(points * centres).
///
/// # Errors
/// [`PerceptionError`] if there are fewer points than that, or one is not finite.
pub fn nearest_points(
    points: &[Point],
    centres: &[Point],
    count: usize,
) -> Result<Vec<usize>, PerceptionError> {
    if points.len() < count {
        return Err(PerceptionError::TooFewNeighbours {
            wanted: count,
            points: points.len(),
        });
    }
    for all in [points, centres] {
        let odd = |point: &Point| !point.iter().all(|x| x.is_finite());
        if let Some(index) = all.iter().position(odd) {
            return Err(PerceptionError::NotFinite { index });
        }
    }
    let mut found = Vec::with_capacity(centres.len() * count);
    let mut distances = vec![0.0; points.len()];
    // Nearest first; as many as were found so far, `count` at most.
    let mut best: Vec<(f32, usize)> = Vec::with_capacity(count + 1);
    for centre in centres {
        for (distance, point) in distances.iter_mut().zip(points) {
            let [x, y, z]: Point = core::array::from_fn(|axis| point[axis] - centre[axis]);
            *distance = (x * x + y * y) + z * z;
        }
        best.clear();
        let mut worst = f32::INFINITY;
        for (index, &distance) in distances.iter().enumerate() {
            // Infinitely far points count too, while places are left.
            if distance < worst || best.len() < count {
                let place = best.partition_point(|(other, _)| *other <= distance);
                best.insert(place, (distance, index));
                best.truncate(count);
                if best.len() == count {
                    worst = best.last().map_or(worst, |(distance, _)| *distance);
                }
            }
        }
        found.extend(best.iter().map(|(_, index)| *index));
    }
    Ok(found)
}
