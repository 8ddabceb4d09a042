//! The nearest point of a segment to a box in the box's own frame. Hot path: bounded, no
//! allocation, no I/O, no lock.

use nalgebra::Vector3;

use super::{Nearest, TOUCHING_M};

/// Where the segment from `start_m` along `along` is nearest to the box of half size `half_m` about
/// the origin or, if they meet, deepest in it.
pub(super) fn nearest(
    start_m: &Vector3<f64>,
    along: &Vector3<f64>,
    half_m: &Vector3<f64>,
) -> Nearest {
    let fraction = match span_within(start_m, along, half_m) {
        Some((enter, leave)) => deepest(start_m, along, half_m, enter, leave),
        None => nearest_outside(start_m, along, half_m),
    };
    let (distance_m, normal) = to_surface(&(start_m + along * fraction), half_m);
    Nearest {
        fraction,
        distance_m,
        normal,
    }
}

/// How far a point is from the surface of the box, m, negative inside, and the surface's normal
/// there.
fn to_surface(point_m: &Vector3<f64>, half_m: &Vector3<f64>) -> (f64, Vector3<f64>) {
    let beyond = point_m.abs() - half_m;
    let excess = beyond.sup(&Vector3::zeros());
    let outside_m = excess.norm();
    if outside_m > TOUCHING_M {
        let out = Vector3::from_fn(|axis, _| excess[axis].copysign(point_m[axis]));
        return (outside_m, out / outside_m);
    }
    let face = beyond.imax();
    let mut normal = Vector3::zeros();
    normal[face] = 1.0_f64.copysign(point_m[face]);
    (beyond[face], normal)
}

/// From which fraction to which the segment is in the box.
fn span_within(
    start_m: &Vector3<f64>,
    along: &Vector3<f64>,
    half_m: &Vector3<f64>,
) -> Option<(f64, f64)> {
    let (mut enter, mut leave) = (0.0_f64, 1.0_f64);
    for axis in 0..3 {
        let (start, slope, half) = (start_m[axis], along[axis], half_m[axis]);
        if slope == 0.0 {
            if start.abs() > half {
                return None;
            }
        } else {
            let (one, other) = ((-half - start) / slope, (half - start) / slope);
            enter = enter.max(one.min(other));
            leave = leave.min(one.max(other));
        }
    }
    (enter <= leave).then_some((enter, leave))
}

/// The fraction between `enter` and `leave` at which the segment is deepest.
///
/// Inside, the signed distance is the highest of six linear functions, one a face: it is least at
/// an end or where two of them meet.
fn deepest(
    start_m: &Vector3<f64>,
    along: &Vector3<f64>,
    half_m: &Vector3<f64>,
    enter: f64,
    leave: f64,
) -> f64 {
    let depth = |fraction: f64| (start_m + along * fraction).abs() - half_m;
    let mut best = enter;
    let mut least = depth(enter).max();
    let mut consider = |fraction: f64| {
        // NaN, from parallel ones, is in no range.
        if fraction >= enter && fraction <= leave {
            let here = depth(fraction).max();
            if here < least {
                (best, least) = (fraction, here);
            }
        }
    };
    consider(leave);
    let faces: [(f64, f64); 6] = core::array::from_fn(|face| {
        let (axis, side) = (face % 3, if face < 3 { 1.0 } else { -1.0 });
        (side * start_m[axis] - half_m[axis], side * along[axis])
    });
    for (index, (at, slope)) in faces.iter().enumerate() {
        for (other_at, other_slope) in &faces[index + 1..] {
            consider((other_at - at) / (slope - other_slope));
        }
    }
    best
}

/// The fraction at which a segment that does not meet the box is nearest to it.
///
/// The squared distance is convex with a continuous slope that is linear between the fractions at
/// which the segment passes a face's plane.
fn nearest_outside(start_m: &Vector3<f64>, along: &Vector3<f64>, half_m: &Vector3<f64>) -> f64 {
    let slope = |fraction: f64| {
        let mut sum = 0.0;
        for axis in 0..3 {
            let place = start_m[axis] + along[axis] * fraction;
            sum += along[axis] * (place - place.clamp(-half_m[axis], half_m[axis]));
        }
        sum
    };
    let mut before = (0.0, slope(0.0));
    if before.1 >= 0.0 {
        return 0.0;
    }
    if slope(1.0) <= 0.0 {
        return 1.0;
    }
    let mut breaks: [f64; 6] = core::array::from_fn(|index| {
        let (axis, side) = (index % 3, if index < 3 { 1.0 } else { -1.0 });
        let fraction = (side * half_m[axis] - start_m[axis]) / along[axis];
        if fraction > 0.0 && fraction < 1.0 {
            fraction
        } else {
            1.0
        }
    });
    breaks.sort_unstable_by(f64::total_cmp);
    for fraction in breaks.into_iter().chain([1.0]) {
        let after = (fraction, slope(fraction));
        if after.1 >= 0.0 {
            return before.0 + (after.0 - before.0) * (before.1 / (before.1 - after.1));
        }
        before = after;
    }
    1.0
}
