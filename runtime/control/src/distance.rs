//! How near a segment is to a shape or to another segment, exactly. Hot path: bounded, no
//! allocation, no I/O, no lock.
//!
//! All shapes are convex, so each distance along a segment is a convex function whose least value
//! follows from a bounded number of places: nothing here iterates.

mod block;

use nalgebra::Vector3;

use super::region::{Block, Shape};

/// Below this a direction between two points is rounding, m.
const TOUCHING_M: f64 = 1e-12;

/// Squared sine of the angle below which two segments count as parallel.
const PARALLEL: f64 = 1e-24;

/// Where a segment is nearest to a shape.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// How far along the segment, 0 at its start and 1 at its end.
    pub fraction: f64,
    /// How far that point is from the shape's surface, m; negative inside.
    pub distance_m: f64,
    /// The way out of the shape there, unit: the distance's gradient in the point.
    pub normal: Vector3<f64>,
}

/// Where two segments are nearest to one another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Between {
    /// How far along the first segment, 0 to 1.
    pub fraction_a: f64,
    /// How far along the second one, 0 to 1.
    pub fraction_b: f64,
    /// From one to the other, m; 0 where they cross.
    pub distance_m: f64,
    /// From the second to the first, unit; where they cross, at right angles to both.
    pub normal: Vector3<f64>,
}

impl Shape {
    /// Where the segment is nearest to the shape or, if they meet, deepest in it.
    #[must_use]
    pub fn nearest(&self, from_m: &Vector3<f64>, to_m: &Vector3<f64>) -> Nearest {
        match self {
            Self::Sphere { center_m, radius_m } => {
                let fraction = fraction_nearest(center_m, from_m, to_m);
                let along = to_m - from_m;
                let away = from_m + along * fraction - center_m;
                let distance_m = away.norm();
                Nearest {
                    fraction,
                    distance_m: distance_m - radius_m,
                    normal: direction(&away, distance_m, || perpendicular(&along)),
                }
            }
            Self::Capsule {
                from_m: axis_from_m,
                to_m: axis_to_m,
                radius_m,
            } => {
                let between = between_segments(from_m, to_m, axis_from_m, axis_to_m);
                Nearest {
                    fraction: between.fraction_a,
                    distance_m: between.distance_m - radius_m,
                    normal: between.normal,
                }
            }
            Self::HalfSpace { point_m, normal } => {
                let start_m = normal.dot(&(from_m - point_m));
                let end_m = normal.dot(&(to_m - point_m));
                let (fraction, distance_m) = if end_m < start_m {
                    (1.0, end_m)
                } else {
                    (0.0, start_m)
                };
                Nearest {
                    fraction,
                    distance_m,
                    normal: *normal,
                }
            }
            Self::Box(block) => {
                let inside = block.axes.inverse();
                let start_m = inside * (from_m - block.center_m);
                let along = inside * (to_m - from_m);
                let nearest = block::nearest(&start_m, &along, &block.half_m);
                Nearest {
                    normal: block.axes * nearest.normal,
                    ..nearest
                }
            }
        }
    }

    /// How far the segment is from the shape, m; negative as deep as it reaches into it.
    #[must_use]
    pub fn distance_m(&self, from_m: &Vector3<f64>, to_m: &Vector3<f64>) -> f64 {
        self.nearest(from_m, to_m).distance_m
    }
}

impl Block {
    /// How far `point_m` is inside each face, m, negative beyond it: the three low faces along the
    /// block's own axes, then the three high ones.
    #[must_use]
    pub fn clearances_m(&self, point_m: &Vector3<f64>) -> [f64; 6] {
        let place_m = self.axes.inverse() * (point_m - self.center_m);
        let (above, below) = (self.half_m + place_m, self.half_m - place_m);
        [above.x, above.y, above.z, below.x, below.y, below.z]
    }

    /// The gradients of [`Self::clearances_m`]: unit, into the block.
    #[must_use]
    pub fn inward(&self) -> [Vector3<f64>; 6] {
        let [x, y, z] = [0, 1, 2].map(|axis| self.axes.matrix().column(axis).into_owned());
        [x, y, z, -x, -y, -z]
    }
}

/// A unit vector across both `a` and `b`; of parallel ones across the longer.
fn perpendicular_to_both(a: &Vector3<f64>, b: &Vector3<f64>) -> Vector3<f64> {
    let across = a.cross(b);
    let sine = across.norm();
    if sine > TOUCHING_M * a.norm() * b.norm() {
        across / sine
    } else if a.norm_squared() > b.norm_squared() {
        perpendicular(a)
    } else {
        perpendicular(b)
    }
}

/// Where two segments are nearest to one another.
#[must_use]
pub fn between_segments(
    a_from_m: &Vector3<f64>,
    a_to_m: &Vector3<f64>,
    b_from_m: &Vector3<f64>,
    b_to_m: &Vector3<f64>,
) -> Between {
    let (fraction_a, fraction_b) = fractions_nearest([a_from_m, a_to_m], [b_from_m, b_to_m]);
    let (a, b) = (a_to_m - a_from_m, b_to_m - b_from_m);
    let away = a_from_m - b_from_m + a * fraction_a - b * fraction_b;
    let distance_m = away.norm();
    let normal = direction(&away, distance_m, || perpendicular_to_both(&a, &b));
    Between {
        fraction_a,
        fraction_b,
        distance_m,
        normal,
    }
}

/// How far one segment is from the other, m.
#[must_use]
pub fn distance_between_m(
    a_from_m: &Vector3<f64>,
    a_to_m: &Vector3<f64>,
    b_from_m: &Vector3<f64>,
    b_to_m: &Vector3<f64>,
) -> f64 {
    let (fraction_a, fraction_b) = fractions_nearest([a_from_m, a_to_m], [b_from_m, b_to_m]);
    let (a, b) = (a_to_m - a_from_m, b_to_m - b_from_m);
    (a_from_m - b_from_m + a * fraction_a - b * fraction_b).norm()
}

/// How far along each of two segments they are nearest to one another.
///
/// The squared distance is a convex quadratic of the two fractions. It is least where both
/// derivatives vanish or, if that is off the segments or they are parallel, where one of the four
/// ends is nearest to the other segment.
fn fractions_nearest(
    [a_from_m, a_to_m]: [&Vector3<f64>; 2],
    [b_from_m, b_to_m]: [&Vector3<f64>; 2],
) -> (f64, f64) {
    let (a, b) = (a_to_m - a_from_m, b_to_m - b_from_m);
    let offset = b_from_m - a_from_m;
    lines_nearest(&offset, &a, &b).unwrap_or_else(|| {
        let ends = [
            (0.0, fraction_nearest(a_from_m, b_from_m, b_to_m)),
            (1.0, fraction_nearest(a_to_m, b_from_m, b_to_m)),
            (fraction_nearest(b_from_m, a_from_m, a_to_m), 0.0),
            (fraction_nearest(b_to_m, a_from_m, a_to_m), 1.0),
        ];
        let squared =
            |&(along_a, along_b): &(f64, f64)| (a * along_a - b * along_b - offset).norm_squared();
        let mut best = ends[0];
        let mut least = squared(&best);
        for end in &ends[1..] {
            let here = squared(end);
            if here < least {
                (best, least) = (*end, here);
            }
        }
        best
    })
}

/// The fractions at which the lines through two segments are nearest, if they are not parallel and
/// that lies on both segments.
fn lines_nearest(offset: &Vector3<f64>, a: &Vector3<f64>, b: &Vector3<f64>) -> Option<(f64, f64)> {
    let across = a.cross(b);
    let squared = across.norm_squared();
    if squared <= PARALLEL * a.norm_squared() * b.norm_squared() {
        return None;
    }
    let fraction_a = offset.cross(b).dot(&across) / squared;
    let fraction_b = offset.cross(a).dot(&across) / squared;
    let on_both = (0.0..=1.0).contains(&fraction_a) && (0.0..=1.0).contains(&fraction_b);
    on_both.then_some((fraction_a, fraction_b))
}

/// How far along the segment it is nearest to `point_m`, 0 to 1.
#[must_use]
pub fn fraction_nearest(point_m: &Vector3<f64>, from_m: &Vector3<f64>, to_m: &Vector3<f64>) -> f64 {
    let along = to_m - from_m;
    let squared = along.norm_squared();
    if squared > 0.0 {
        ((point_m - from_m).dot(&along) / squared).clamp(0.0, 1.0)
    } else {
        0.0
    }
}

/// `away` over its length, or `otherwise` where that is rounding.
fn direction(
    away: &Vector3<f64>,
    length_m: f64,
    otherwise: impl FnOnce() -> Vector3<f64>,
) -> Vector3<f64> {
    if length_m > TOUCHING_M {
        away / length_m
    } else {
        otherwise()
    }
}

/// A unit vector at right angles to `along`, whatever that is.
fn perpendicular(along: &Vector3<f64>) -> Vector3<f64> {
    let axis = if along.x.abs() <= along.y.abs() && along.x.abs() <= along.z.abs() {
        Vector3::x()
    } else if along.y.abs() <= along.z.abs() {
        Vector3::y()
    } else {
        Vector3::z()
    };
    let across = axis.cross(along);
    let length = across.norm();
    if length > 0.0 { across / length } else { axis }
}

#[cfg(test)]
mod tests;
