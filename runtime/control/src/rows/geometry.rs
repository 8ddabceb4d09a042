//! Rows of one arm's instrument against its workspace and the forbidden regions.

use hal::psm::SHAFT_RADIUS_M;
use nalgebra::Vector3;

use super::{Rows, approach_bound};
use crate::config::ControlConfig;
use crate::instrument::{Link, Stance};
use crate::region::{Block, Shape};

/// Six rows for each of control point and finger tips.
pub(super) fn workspace(
    rows: &mut Rows,
    config: &ControlConfig,
    first: usize,
    stance: &Stance,
    workspace: &Block,
) {
    let [left_m, right_m] = stance.instrument.fingers_m;
    for (link, point_m) in [
        (Link::Wrist, stance.instrument.tip_m),
        (Link::LeftFinger, left_m),
        (Link::RightFinger, right_m),
    ] {
        let jacobian = stance.point_jacobian(link, &point_m, 1.0);
        let place_m = workspace.axes.inverse() * (point_m - workspace.center_m);
        for axis in 0..3 {
            let side = workspace.axes.matrix().column(axis);
            let outward = side.transpose() * jacobian;
            let (half_m, at_m) = (workspace.half_m[axis], place_m[axis]);
            rows.push(first, &-outward, approach_bound(half_m + at_m, config));
            rows.push(first, &outward, approach_bound(half_m - at_m, config));
        }
    }
}

/// A row for each link where it is nearest to the region.
///
/// Where a shape has flat faces the nearest place of a link can jump from one of its ends to the other, so there each link's
/// end has a row of its own.
pub(super) fn region(
    rows: &mut Rows,
    config: &ControlConfig,
    first: usize,
    stance: &Stance,
    shape: &Shape,
) {
    for (link, (from_m, to_m)) in Link::ALL.into_iter().zip(stance.instrument.links()) {
        let nearest = shape.nearest(&from_m, &to_m);
        let point_m = from_m + (to_m - from_m) * nearest.fraction;
        let place = Place {
            link,
            point_m,
            fraction: nearest.fraction,
        };
        away(
            rows,
            config,
            first,
            stance,
            &place,
            &nearest.normal,
            nearest.distance_m,
        );
        if matches!(shape, Shape::HalfSpace { .. } | Shape::Box(_)) {
            let end = shape.nearest(&to_m, &to_m);
            let place = Place {
                link,
                point_m: to_m,
                fraction: 1.0,
            };
            away(
                rows,
                config,
                first,
                stance,
                &place,
                &end.normal,
                end.distance_m,
            );
        }
    }
}

/// A place of the instrument.
struct Place {
    link: Link,
    point_m: Vector3<f64>,
    fraction: f64,
}

fn away(
    rows: &mut Rows,
    config: &ControlConfig,
    first: usize,
    stance: &Stance,
    place: &Place,
    normal: &Vector3<f64>,
    distance_m: f64,
) {
    let jacobian = stance.point_jacobian(place.link, &place.point_m, place.fraction);
    let towards = -(normal.transpose() * jacobian);
    let bound = approach_bound(distance_m - SHAFT_RADIUS_M, config);
    rows.push(first, &towards, bound);
}
