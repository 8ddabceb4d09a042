//! Rows of one arm's instrument against its workspace and the forbidden regions.

use hal::psm::SHAFT_RADIUS_M;
use nalgebra::Vector3;

use super::{RowInput, Rows, approach_bound};
use crate::config::ControlConfig;
use crate::distance::Nearest;
use crate::instrument::{Link, PointJacobian};
use crate::region::{Block, Shape};

/// Six rows for each of control point and finger tips.
pub(super) fn workspace(
    rows: &mut Rows,
    config: &ControlConfig,
    first: usize,
    arm: &RowInput<'_>,
    workspace: &Block,
) {
    let (stance, deviation) = (arm.stance, &arm.deviation);
    let [left_m, right_m] = stance.instrument.fingers_m;
    let [left_off_m, right_off_m] = deviation.fingers_m;
    for (link, point_m, off_m) in [
        (Link::Wrist, stance.instrument.tip_m, deviation.tip_m),
        (Link::LeftFinger, left_m, left_off_m),
        (Link::RightFinger, right_m, right_off_m),
    ] {
        let jacobian = stance.point_jacobian(link, &point_m, 1.0);
        let bound = |distance_m: f64| approach_bound(distance_m, off_m, config);
        faces(rows, first, workspace, (&point_m, &jacobian), bound);
    }
}

/// A row for each face of `workspace` and one point with its Jacobian; `bound` is how fast it may
/// approach a face at a distance, m.
fn faces(
    rows: &mut Rows,
    first: usize,
    workspace: &Block,
    (point_m, jacobian): (&Vector3<f64>, &PointJacobian),
    bound: impl Fn(f64) -> f64,
) {
    let place_m = workspace.axes.inverse() * (point_m - workspace.center_m);
    for axis in 0..3 {
        let side = workspace.axes.matrix().column(axis);
        let outward = side.transpose() * jacobian;
        let (half_m, at_m) = (workspace.half_m[axis], place_m[axis]);
        rows.push(first, &-outward, bound(half_m + at_m));
        rows.push(first, &outward, bound(half_m - at_m));
    }
}

/// A row for each link where it is nearest to the region.
///
/// Where a shape has flat faces the nearest place of a link can jump from one of its ends to the
/// other, so there each link's end has a row of its own.
pub(super) fn region(
    rows: &mut Rows,
    config: &ControlConfig,
    first: usize,
    arm: &RowInput<'_>,
    shape: &Shape,
) {
    let stance = arm.stance;
    for (link, (from_m, to_m)) in Link::ALL.into_iter().zip(stance.instrument.links()) {
        let nearest = shape.nearest(&from_m, &to_m);
        let point_m = from_m + (to_m - from_m) * nearest.fraction;
        let place = Place {
            link,
            point_m,
            fraction: nearest.fraction,
        };
        away(rows, config, first, arm, &place, &nearest);
        if matches!(shape, Shape::HalfSpace { .. } | Shape::Box(_)) {
            let end = shape.nearest(&to_m, &to_m);
            let place = Place {
                link,
                point_m: to_m,
                fraction: 1.0,
            };
            away(rows, config, first, arm, &place, &end);
        }
    }
}

/// A place of the instrument.
///
/// Where a row of a region takes its Jacobian.
struct Place {
    link: Link,
    point_m: Vector3<f64>,
    /// Of the way along the link, 0 to 1. On the shaft, also the share of the insertion's motion
    /// that a point makes.
    fraction: f64,
}

/// Adds the row `-n' J u <= bound` of a place, whose distance counts from the instrument's surface:
/// the shaft's radius is taken off for every link.
fn away(
    rows: &mut Rows,
    config: &ControlConfig,
    first: usize,
    arm: &RowInput<'_>,
    place: &Place,
    nearest: &Nearest,
) {
    let jacobian = arm
        .stance
        .point_jacobian(place.link, &place.point_m, place.fraction);
    let towards = -(nearest.normal.transpose() * jacobian);
    let off_m = arm.deviation.links_m[place.link as usize];
    let bound = approach_bound(nearest.distance_m - SHAFT_RADIUS_M, off_m, config);
    rows.push(first, &towards, bound);
}
