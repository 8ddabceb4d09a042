//! Sums of squared distances from planes.
//!
//! Garland and Heckbert's error quadric: the squared distance of `p` from the plane `n . p + d = 0`
//! is `p . (n n^T) p + 2 d n . p + d^2`, and sums of such are again of the form. Planes are
//! weighted by twice the area of their triangle, so values are in mm^4. The quadric only orders
//! collapses and places vertices; what is allowed is decided by samples.

use nalgebra::{Matrix3, Point3, Vector3};

/// A weighted sum of squared distances from planes: p·A p + 2 b·p + c.
#[derive(Clone, Copy, Debug)]
pub(super) struct Quadric {
    /// The upper triangle of A: xx, xy, xz, yy, yz, zz.
    a: [f64; 6],
    /// `d n`, weighted and summed.
    b: Vector3<f64>,
    /// `d^2`, weighted and summed.
    c: f64,
    /// Sum of the planes' weights, mm^2.
    weight: f64,
}

impl Quadric {
    pub(super) fn zero() -> Self {
        Self {
            a: [0.0; 6],
            b: Vector3::zeros(),
            c: 0.0,
            weight: 0.0,
        }
    }

    /// The plane through `p` with the unit normal `n`.
    pub(super) fn plane(p: &Point3<f64>, n: &Vector3<f64>, weight: f64) -> Self {
        let d = -n.dot(&p.coords);
        let a = [
            n.x * n.x,
            n.x * n.y,
            n.x * n.z,
            n.y * n.y,
            n.y * n.z,
            n.z * n.z,
        ];
        Self {
            a: a.map(|x| x * weight),
            b: n * (d * weight),
            c: d * d * weight,
            weight,
        }
    }

    pub(super) fn add(&mut self, other: &Self) {
        for (a, b) in self.a.iter_mut().zip(other.a) {
            *a += b;
        }
        self.b += other.b;
        self.c += other.c;
        self.weight += other.weight;
    }

    fn matrix(&self) -> Matrix3<f64> {
        let [xx, xy, xz, yy, yz, zz] = self.a;
        Matrix3::new(xx, xy, xz, xy, yy, yz, xz, yz, zz)
    }

    /// The sum at `p`.
    ///
    /// Cut off at 0: rounding makes it slightly negative near planes, and its bits are to order
    /// like the number.
    pub(super) fn at(&self, p: &Point3<f64>) -> f64 {
        let p = &p.coords;
        (p.dot(&(self.matrix() * p)) + 2.0 * self.b.dot(p) + self.c).max(0.0)
    }

    /// Sum of the planes' weights.
    pub(super) const fn weight(&self) -> f64 {
        self.weight
    }

    /// Where the sum is least, or near `about` where that leaves it undetermined.
    ///
    /// Solves `(A + w) p = w about - b` with `w` a thousandth of the weight. On a flat sheet A has
    /// rank 1, and on a straight edge 2; the pull makes the system definite. None of a quadric
    /// without weight.
    pub(super) fn least(&self, about: &Point3<f64>) -> Option<Point3<f64>> {
        // A weak pull towards `about` decides along flat directions.
        let pull = 1e-3 * self.weight;
        let matrix = self.matrix() + Matrix3::identity() * pull;
        let right = about.coords * pull - self.b;
        matrix
            .cholesky()
            .map(|cholesky| Point3::from(cholesky.solve(&right)))
    }
}
