//! Solids by their distance function.
//!
//! Signed distances in the manner of I. Quilez: negative inside. The proof that parts are apart
//! rests on distances that change no faster than the place does; an ellipsoid's is like that only
//! near its surface. Blends and cuts change no faster than the solids they are made of.

use nalgebra::{Matrix3, Point3, UnitVector3, Vector3};

use crate::number::real;

/// A solid in the nominal anatomy, mm.
#[derive(Clone, Debug)]
pub(super) enum Shape {
    /// An ellipsoid.
    Ellipsoid {
        centre: Point3<f64>,
        radii: Vector3<f64>,
        /// Columns are its axes.
        axes: Matrix3<f64>,
    },
    /// Round all along a line of points, each with its radius.
    Tube(Vec<(Point3<f64>, f64)>),
    /// Solids that flow into each other over about `over` mm.
    Blend { of: Vec<Shape>, over: f64 },
    /// What of a solid lies behind a plane, its rim rounded over about `over` mm.
    Cut {
        of: Box<Shape>,
        /// A point of the plane.
        at: Point3<f64>,
        /// The plane's unit normal, towards what is cut away.
        outward: UnitVector3<f64>,
        over: f64,
    },
}

/// An upright ellipsoid.
pub(super) fn ellipsoid(centre: [f64; 3], radii: [f64; 3]) -> Shape {
    Shape::Ellipsoid {
        centre: Point3::from(centre),
        radii: Vector3::from(radii),
        axes: Matrix3::identity(),
    }
}

/// A tube through points given as x, y, z and radius.
pub(super) fn tube(points: &[[f64; 4]]) -> Shape {
    let point = |p: &[f64; 4]| (Point3::new(p[0], p[1], p[2]), p[3]);
    Shape::Tube(points.iter().map(point).collect())
}

/// Distance from a tube's segment; negative inside.
///
/// A cone with round ends; the radius runs evenly along it.
fn segment(p: &Point3<f64>, a: &(Point3<f64>, f64), b: &(Point3<f64>, f64)) -> f64 {
    let along = b.0 - a.0;
    let t = ((p - a.0).dot(&along) / along.norm_squared()).clamp(0.0, 1.0);
    (p - (a.0 + along * t)).norm() - (a.1 + (b.1 - a.1) * t)
}

/// The lesser of two distances, rounded where they are alike.
///
/// The polynomial smooth minimum: quadratic where the two differ by less than `over`, the lesser
/// one elsewhere.
fn smooth_min(a: f64, b: f64, over: f64) -> f64 {
    let mix = (0.5 + 0.5 * (b - a) / over).clamp(0.0, 1.0);
    b + (a - b) * mix - over * mix * (1.0 - mix)
}

impl Shape {
    /// Distance of `p` from the surface, negative inside; exact for tubes, of first order near the
    /// surface for the others.
    ///
    /// An ellipsoid's is `(k - 1) / |grad k|`, where `k` is the length of the point in units of the
    /// radii. O(segments) of a tube.
    pub(super) fn distance(&self, p: &Point3<f64>) -> f64 {
        match self {
            Self::Ellipsoid {
                centre,
                radii,
                axes,
            } => {
                let local = axes.tr_mul(&(p - centre));
                let unit = local.component_div(radii).norm();
                let slope = local.component_div(radii).component_div(radii).norm();
                if slope < 1e-9 {
                    -radii.min()
                } else {
                    unit * (unit - 1.0) / slope
                }
            }
            Self::Tube(points) => points
                .windows(2)
                .map(|pair| segment(p, &pair[0], &pair[1]))
                .fold(f64::INFINITY, f64::min),
            Self::Blend { of, over } => of
                .iter()
                .map(|shape| shape.distance(p))
                .reduce(|a, b| smooth_min(a, b, *over))
                .unwrap_or(f64::INFINITY),
            Self::Cut {
                of,
                at,
                outward,
                over,
            } => -smooth_min(-of.distance(p), -(p - at).dot(outward), *over),
        }
    }

    /// The same, moved by `by` and with its radii times `factor`.
    pub(super) fn varied(&self, by: &Vector3<f64>, factor: f64) -> Self {
        match self {
            Self::Ellipsoid {
                centre,
                radii,
                axes,
            } => Self::Ellipsoid {
                centre: centre + by,
                radii: radii * factor,
                axes: *axes,
            },
            Self::Tube(points) => {
                let point = |(p, radius): &(Point3<f64>, f64)| (p + by, radius * factor);
                Self::Tube(points.iter().map(point).collect())
            }
            Self::Blend { of, over } => Self::Blend {
                of: of.iter().map(|shape| shape.varied(by, factor)).collect(),
                over: *over,
            },
            Self::Cut {
                of,
                at,
                outward,
                over,
            } => Self::Cut {
                of: Box::new(of.varied(by, factor)),
                at: at + by,
                outward: *outward,
                over: *over,
            },
        }
    }

    /// Corners of a box along the axes around it.
    pub(super) fn bounds(&self) -> [Vector3<f64>; 2] {
        let around = |centre: Vector3<f64>, half: Vector3<f64>| [centre - half, centre + half];
        let merge = |a: [Vector3<f64>; 2], b: [Vector3<f64>; 2]| [a[0].inf(&b[0]), a[1].sup(&b[1])];
        let none = [
            Vector3::repeat(f64::INFINITY),
            Vector3::repeat(f64::NEG_INFINITY),
        ];
        match self {
            Self::Ellipsoid {
                centre,
                radii,
                axes,
            } => {
                let reach = (axes * Matrix3::from_diagonal(radii))
                    .row_iter()
                    .map(|row| row.norm())
                    .collect::<Vec<_>>();
                around(centre.coords, Vector3::from_column_slice(&reach))
            }
            Self::Tube(points) => points
                .iter()
                .map(|(p, radius)| around(p.coords, Vector3::repeat(*radius)))
                .fold(none, merge),
            Self::Blend { of, over } => {
                let [low, high] = of.iter().map(Self::bounds).fold(none, merge);
                // Each further solid bulges by a quarter of the width at most.
                let bulge = 0.25 * over * real(of.len().saturating_sub(1));
                [low.add_scalar(-bulge), high.add_scalar(bulge)]
            }
            Self::Cut { of, .. } => of.bounds(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A ball of 20 mm of which a plane through its middle leaves the lower half.
    fn half_ball() -> Shape {
        Shape::Cut {
            of: Box::new(ellipsoid([5.0, 0.0, 0.0], [20.0; 3])),
            at: Point3::new(5.0, 0.0, 0.0),
            outward: UnitVector3::new_normalize(Vector3::z()),
            over: 4.0,
        }
    }

    #[test]
    fn a_cut_solid_ends_at_its_plane_and_is_the_solid_below() {
        let cut = half_ball();
        let distance = |z: f64| cut.distance(&Point3::new(5.0, 0.0, z));
        assert!(distance(1.0) > 0.9 && distance(-1.0) < -0.9 && distance(-1.0) > -1.1);
        assert!(
            (distance(-25.0) - 5.0).abs() < 1e-9,
            "below it is the ball's"
        );
        // The rim is rounded by a quarter of `over`, inwards.
        let rim = cut.distance(&Point3::new(25.0, 0.0, 0.0));
        assert!((rim - 1.0).abs() < 1e-9, "{rim}");
    }

    /// On this rests the proof that parts are apart.
    #[test]
    fn a_cut_changes_no_faster_than_the_place_does() {
        let cut = half_ball();
        for i in 0..20 {
            let turn = f64::from(i) * 0.7;
            let p = Point3::new(
                5.0 + 22.0 * turn.cos(),
                3.0 * turn.sin(),
                0.4 * f64::from(i) - 5.0,
            );
            let step = Vector3::new(turn.sin(), turn.cos(), 0.5).normalize() * 0.5;
            let change = cut.distance(&(p + step)) - cut.distance(&p);
            assert!(change.abs() <= step.norm() + 1e-9, "{change} at {p}");
        }
    }

    #[test]
    fn a_varied_cut_moves_with_its_solid() {
        let by = Vector3::new(3.0, -2.0, 7.0);
        let moved = half_ball().varied(&by, 1.0);
        for z in [-12.0, -0.3, 0.4, 9.0] {
            let p = Point3::new(9.0, 4.0, z);
            let difference = moved.distance(&(p + by)) - half_ball().distance(&p);
            assert!(difference.abs() < 1e-9, "{difference}");
        }
        // A greater one is cut by the same plane.
        let greater = half_ball().varied(&Vector3::zeros(), 1.2);
        let distance = |z: f64| greater.distance(&Point3::new(5.0, 0.0, z));
        assert!(
            (distance(-25.0) - 1.0).abs() < 1e-9 && distance(-1.0) < 0.0 && distance(1.0) > 0.9
        );
    }

    /// The lobes of a liver are no balls, whose distance is exact.
    #[test]
    fn a_cut_lobe_changes_hardly_faster_near_its_surface() {
        let cut = Shape::Cut {
            of: Box::new(ellipsoid([0.0; 3], [60.0, 45.0, 32.0])),
            at: Point3::new(0.0, 0.0, 8.0),
            outward: UnitVector3::new_normalize(Vector3::new(0.2, -0.1, 1.0)),
            over: 6.0,
        };
        let mut near = 0;
        let mut greatest = 0.0_f64;
        for i in 0..12_000 {
            let [x, y, z] = [i / 600, i / 20 % 30, i % 20].map(f64::from);
            let p = Point3::new(7.0 * x - 66.0, 3.5 * y - 52.0, 4.0 * z - 40.0);
            let here = cut.distance(&p);
            if here.abs() > 3.0 {
                continue;
            }
            near += 1;
            let steps = [0, 1, 2].map(|axis| Vector3::ith(axis, 0.01));
            let slope = steps.map(|step| (cut.distance(&(p + step)) - here) / 0.01);
            greatest = greatest.max(Vector3::from(slope).norm());
        }
        assert!(
            near > 500 && greatest > 0.9 && greatest < 1.1,
            "{near} {greatest}"
        );
    }
}
