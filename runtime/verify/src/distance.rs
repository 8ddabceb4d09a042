//! Distances by search, where the controller has closed forms.
//!
//! How far a point is from a convex shape is a convex function of the point, and it changes no
//! faster than the point moves. The first makes a golden-section search along a segment find its
//! least value, the second says how far from it a search can still be. All that has to be right
//! about a shape is the distance of one point.

use hal::psm::SHAFT_RADIUS_M;
use nalgebra::{Isometry3, Point3, Vector3};

/// Length to which the nearest place of a segment is found, m; the distance found is too long by no
/// more.
const RESOLUTION_M: f64 = 1e-9;

/// A segment of the length of a light year would be searched to the end.
const STEPS_MAX: u32 = 128;

/// The golden section's larger part.
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// A convex region, m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Shape {
    /// A ball.
    Sphere { center: Point3<f64>, radius_m: f64 },
    /// All that is near a segment.
    Capsule {
        start: Point3<f64>,
        end: Point3<f64>,
        radius_m: f64,
    },
    /// All that is on the side of a plane that its unit normal points away from.
    HalfSpace {
        point: Point3<f64>,
        normal: Vector3<f64>,
    },
    /// A box: half its edges in a frame of its own.
    Box {
        box_from_scene: Isometry3<f64>,
        half_m: Vector3<f64>,
    },
}

impl Shape {
    /// How far outside `point` is, m; negative inside.
    pub(super) fn distance_m(&self, point: &Point3<f64>) -> f64 {
        match self {
            Self::Sphere { center, radius_m } => (point - center).norm() - radius_m,
            Self::Capsule {
                start,
                end,
                radius_m,
            } => distance_to_segment_m(point, start, end) - radius_m,
            Self::HalfSpace { point: on, normal } => (point - on).dot(normal),
            Self::Box {
                box_from_scene,
                half_m,
            } => {
                let beyond = (box_from_scene * point).coords.abs() - half_m;
                let outside = beyond.map(|by| if by > 0.0 { by } else { 0.0 }).norm();
                let inside = beyond.x.max(beyond.y).max(beyond.z).min(0.0);
                outside + inside
            }
        }
    }
}

/// Distance from `point` to the segment from `start` to `end`, m.
fn distance_to_segment_m(point: &Point3<f64>, start: &Point3<f64>, end: &Point3<f64>) -> f64 {
    let along = end - start;
    let length_squared = along.norm_squared();
    let fraction = if length_squared > 0.0 {
        (point - start).dot(&along) / length_squared
    } else {
        0.0
    };
    (point - (start + along * fraction.clamp(0.0, 1.0))).norm()
}

/// The gap between `shape` and the surface of a part of the instrument whose centre line goes from
/// `start` to `end`, m; negative where they overlap. `None` if it is proven to be more than
/// `enough_m`. NaN if the line is not finite.
///
/// Wrist and fingers are thinner than the shaft; they count as thick as it is.
pub(super) fn least_gap_m(
    shape: &Shape,
    start: &Point3<f64>,
    end: &Point3<f64>,
    enough_m: f64,
) -> Option<f64> {
    let distance_m = least_distance_m(shape, start, end, enough_m + SHAFT_RADIUS_M);
    distance_m.map(|distance_m| distance_m - SHAFT_RADIUS_M)
}

/// The least distance between `shape` and the segment from `start` to `end`, m; negative inside.
/// `None` if it is proven to be more than `enough_m`. NaN if the segment is not finite.
fn least_distance_m(
    shape: &Shape,
    start: &Point3<f64>,
    end: &Point3<f64>,
    enough_m: f64,
) -> Option<f64> {
    let along = end - start;
    let length_m = along.norm();
    if !(length_m.is_finite() && start.coords.norm().is_finite()) {
        return Some(f64::NAN);
    }
    let at = |share: f64| shape.distance_m(&(start + along * share));
    // The least value lies between `low` and `high`; `left` and `right` cut that by the golden
    // section.
    let (mut low, mut high) = (0.0, 1.0);
    let (mut left, mut right) = (1.0 - GOLDEN, GOLDEN);
    let (mut at_left, mut at_right) = (at(left), at(right));
    for _ in 0..STEPS_MAX {
        let width_m = (high - low) * length_m;
        if at_left.min(at_right) - width_m > enough_m {
            return None;
        }
        if width_m < RESOLUTION_M {
            break;
        }
        if at_left < at_right {
            high = right;
            (right, at_right) = (left, at_left);
            left = high - GOLDEN * (high - low);
            at_left = at(left);
        } else {
            low = left;
            (left, at_left) = (right, at_right);
            right = low + GOLDEN * (high - low);
            at_right = at(right);
        }
    }
    Some(at_left.min(at_right).min(at(low)).min(at(high)))
}
