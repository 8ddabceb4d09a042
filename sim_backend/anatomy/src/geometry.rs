//! Points and triangles.

use nalgebra::Point3;

/// The point of a triangle nearest to `p` (Ericson, Real-Time Collision Detection, 5.1.5).
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

#[cfg(test)]
mod tests {
    use hal::random::SplitMix64;
    use nalgebra::Point3;

    use super::nearest_on_triangle;

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
