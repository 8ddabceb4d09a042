//! Points and triangles.
//!
//! All in double precision with plain rounding, not exact predicates: near-degenerate pairs may be
//! judged either way. `tests/scripts/anatomy.py` checks results in exact arithmetic.

use nalgebra::Point3;

/// The point of a triangle nearest to `p` (Ericson, Real-Time Collision Detection, 5.1.5).
///
/// The plane is cut into the Voronoi regions of corners, sides and inside; the first that `p` is in
/// decides. NaN may come of a triangle whose first two corners coincide; comparisons by `<` then
/// pass it over.
pub(crate) fn nearest_on_triangle(p: &Point3<f64>, [a, b, c]: &[Point3<f64>; 3]) -> Point3<f64> {
    let (ab, ac) = (b - a, c - a);
    let ap = p - a;
    let (d1, d2) = (ab.dot(&ap), ac.dot(&ap));
    if d1 <= 0.0 && d2 <= 0.0 {
        return *a;
    }
    let bp = p - b;
    let (d3, d4) = (ab.dot(&bp), ac.dot(&bp));
    if d3 >= 0.0 && d4 <= d3 {
        return *b;
    }
    let vc = d1 * d4 - d3 * d2;
    if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
        return a + ab * (d1 / (d1 - d3));
    }
    let cp = p - c;
    let (d5, d6) = (ab.dot(&cp), ac.dot(&cp));
    if d6 >= 0.0 && d5 <= d6 {
        return *c;
    }
    let vb = d5 * d2 - d1 * d6;
    if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
        return a + ac * (d2 / (d2 - d6));
    }
    let va = d3 * d6 - d5 * d4;
    if va <= 0.0 && d4 >= d3 && d5 >= d6 {
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)));
    }
    let sum = va + vb + vc;
    if sum <= 0.0 {
        // No area.
        return *a;
    }
    a + ab * (vb / sum) + ac * (vc / sum)
}

/// Squared distance of `p` from a triangle.
pub(crate) fn distance_squared(p: &Point3<f64>, triangle: &[Point3<f64>; 3]) -> f64 {
    (p - nearest_on_triangle(p, triangle)).norm_squared()
}

/// Six times the signed volume of the tetrahedron of four points.
///
/// Positive where `d` lies on the side from which a, b, c are seen counter-clockwise.
fn volume(a: &Point3<f64>, b: &Point3<f64>, c: &Point3<f64>, d: &Point3<f64>) -> f64 {
    (b - a).cross(&(c - a)).dot(&(d - a))
}

/// Whether an edge of the triangle `first` runs through the inside of `second`. Edges that end at a
/// vertex of `second`, by their numbers, do not.
///
/// The ends must lie strictly on both sides of the plane and the edge pass all three sides the same
/// way round. So an edge in the plane, or through a side of `second`, pierces nothing.
fn pierces(
    (numbers, first): (&[u32; 3], &[Point3<f64>; 3]),
    (others, second): (&[u32; 3], &[Point3<f64>; 3]),
) -> bool {
    let [a, b, c] = second;
    let heights = first.each_ref().map(|p| volume(a, b, c, p));
    (0..3).map(|k| (k, (k + 1) % 3)).any(|(from, to)| {
        if heights[from] * heights[to] >= 0.0
            || others.contains(&numbers[from])
            || others.contains(&numbers[to])
        {
            return false;
        }
        let (p, q) = (&first[from], &first[to]);
        let turns = [(a, b), (b, c), (c, a)].map(|(x, y)| volume(p, q, x, y));
        turns.iter().all(|turn| *turn > 0.0) || turns.iter().all(|turn| *turn < 0.0)
    })
}

/// Whether two triangles cross; what touches, or has an edge in common, does not.
///
/// Vertices are compared by number, not by place: two at one place with different numbers are not
/// common. Boxes are compared first, which settles most pairs. Two triangles in one plane never
/// cross.
pub(crate) fn cross(
    first: (&[u32; 3], &[Point3<f64>; 3]),
    second: (&[u32; 3], &[Point3<f64>; 3]),
) -> bool {
    let apart = |k: usize| {
        let of = |triangle: &[Point3<f64>; 3]| {
            let [a, b, c] = triangle.each_ref().map(|p| p[k]);
            (a.min(b).min(c), a.max(b).max(c))
        };
        let ((low, high), (least, most)) = (of(first.1), of(second.1));
        high < least || most < low
    };
    !(0..3).any(apart) && (pierces(first, second) || pierces(second, first))
}

#[cfg(test)]
mod tests {
    use hal::random::SplitMix64;
    use nalgebra::Point3;

    use super::{cross, nearest_on_triangle};

    #[test]
    fn triangles_cross_where_an_edge_runs_through_one() {
        let point = |x: f64, y: f64, z: f64| Point3::new(x, y, z);
        let flat = [
            point(0.0, 0.0, 0.0),
            point(4.0, 0.0, 0.0),
            point(0.0, 4.0, 0.0),
        ];
        let upright =
            |x: f64, y: f64| [point(x, y, -1.0), point(x, y, 1.0), point(x + 9.0, y, 1.0)];
        let crosses = |ids: [u32; 3], other: &[Point3<f64>; 3]| {
            let one = cross((&[0, 1, 2], &flat), (&ids, other));
            assert_eq!(one, cross((&ids, other), (&[0, 1, 2], &flat)));
            one
        };
        assert!(crosses([3, 4, 5], &upright(1.0, 1.0)));
        assert!(!crosses([3, 4, 5], &upright(5.0, 1.0)));
        assert!(!crosses([3, 4, 5], &flat.map(|p| point(p.x, p.y, 0.5))));
        // With one vertex in common, beside it and through it.
        let [a, ..] = flat;
        assert!(!crosses(
            [0, 4, 5],
            &[a, point(1.0, 1.0, 1.0), point(1.0, 1.0, 2.0)]
        ));
        assert!(crosses(
            [0, 4, 5],
            &[a, point(1.0, 1.0, 1.0), point(1.0, 1.0, -1.0)]
        ));
    }

    /// Against a dense search over the triangle.
    #[test]
    fn nearest_point_is_no_farther_than_any_other() {
        let mut random = SplitMix64::new(1);
        for _ in 0..200 {
            let mut point = || Point3::from([0; 3].map(|_| random.signed_unit()));
            let (p, triangle) = (point(), [point(), point(), point()]);
            let found = (p - nearest_on_triangle(&p, &triangle)).norm();
            let [a, b, c] = triangle;
            let best = (0..=40)
                .flat_map(|i| (0..=40 - i).map(move |j| (f64::from(i) / 40.0, f64::from(j) / 40.0)))
                .map(|(u, v)| (p - (a + (b - a) * u + (c - a) * v)).norm())
                .fold(f64::INFINITY, f64::min);
            assert!(
                found <= best + 1e-12 && found > best - 0.1,
                "{found} {best}"
            );
        }
    }
}
