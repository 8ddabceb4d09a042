//! Rows between two instruments: shaft to shaft, and wrist and fingers of each to the shaft of the
//! other.

use hal::Pose;
use hal::psm::SHAFT_RADIUS_M;
use nalgebra::Vector3;

use super::{Row, RowInput, Rows, approach_bound};
use crate::active_set::VARIABLES_MAX;
use crate::config::{BetweenArms, ControlConfig};
use crate::distance::between_segments;
use crate::instrument::{KinematicState, Link};
use crate::motion::AXES;

/// Which links are kept apart, the first arm's and the second's; the tips may meet.
pub(super) const PAIRS: [(Link, Link); 7] = [
    (Link::Shaft, Link::Shaft),
    (Link::Wrist, Link::Shaft),
    (Link::LeftFinger, Link::Shaft),
    (Link::RightFinger, Link::Shaft),
    (Link::Shaft, Link::Wrist),
    (Link::Shaft, Link::LeftFinger),
    (Link::Shaft, Link::RightFinger),
];

/// Adds seven rows. Both instruments are brought into the scene's frame for the distance, and the
/// normal back into each arm's own for its Jacobian, so that one row holds the velocities of both
/// arms: `-n' (J_a u_a - J_b u_b) <= bound`, the speed at which they approach.
///
/// The gap is measured between surfaces, and the deviations of both links are kept together.
pub(super) fn links(
    rows: &mut Rows,
    config: &ControlConfig,
    gaps: &BetweenArms,
    arms: [&RowInput<'_>; 2],
    scene_from_rcm: [&Pose; 2],
) {
    let [one, other] = arms.map(|arm| arm.stance);
    let [one_frame, other_frame] = scene_from_rcm;
    let in_scene = [
        one.instrument.moved(one_frame).links(),
        other.instrument.moved(other_frame).links(),
    ];
    for (link, other_link) in PAIRS {
        let gap_m = if link == other_link {
            gaps.shaft_to_shaft_m
        } else {
            gaps.tip_to_shaft_m
        };
        let (from_m, to_m) = in_scene[0][link as usize];
        let (other_from_m, other_to_m) = in_scene[1][other_link as usize];
        let between = between_segments(&from_m, &to_m, &other_from_m, &other_to_m);
        let mut coefficients = [0.0; VARIABLES_MAX];
        let (own, others) = coefficients.split_at_mut(AXES);
        // The normal leads from the second arm to the first.
        let towards = one_frame.rotation.inverse() * -between.normal;
        moving(own, one, link, between.fraction_a, &towards);
        let towards = other_frame.rotation.inverse() * between.normal;
        moving(others, other, other_link, between.fraction_b, &towards);
        let clear_m = between.distance_m - 2.0 * SHAFT_RADIUS_M - gap_m;
        let off_m = arms[0].deviation.links_m[link as usize]
            + arms[1].deviation.links_m[other_link as usize];
        rows.geometry.push(Row {
            coefficients,
            bound: approach_bound(clear_m, off_m, config),
        });
    }
}

/// How fast the place of `link` moves in the direction `towards` (RCM frame) per velocity of each
/// axis.
fn moving(
    entries: &mut [f64],
    stance: &KinematicState,
    link: Link,
    fraction: f64,
    towards: &Vector3<f64>,
) {
    let (from_m, to_m) = stance.instrument.links()[link as usize];
    let point_m = from_m + (to_m - from_m) * fraction;
    let along = towards.transpose() * stance.point_jacobian(link, &point_m, fraction);
    for (entry, value) in entries.iter_mut().zip(along.iter()) {
        *entry = *value;
    }
}
