//! The search against closed forms and against sampling that closes in on the nearest place.

use hal::Pose;
use hal::psm::SHAFT_RADIUS_M;
use nalgebra::{Point3, Translation3, UnitQuaternion, Vector3};

use super::scene::Random;
use crate::distance::{Shape, least_gap_m};

fn point(random: &mut Random) -> Point3<f64> {
    Point3::from(Vector3::from(random.vector(0.2)))
}

/// How far `point` is from the segment: the foot of the perpendicular, or the nearer end.
pub(super) fn to_segment(point: Point3<f64>, start: Point3<f64>, end: Point3<f64>) -> f64 {
    let (along, from_start) = ((end - start).normalize(), point - start);
    let foot = from_start.dot(&along);
    if foot > 0.0 && foot < (end - start).norm() {
        from_start.cross(&along).norm()
    } else {
        (point - start).norm().min((point - end).norm())
    }
}

/// The least value over the segment: the best of many samples, then of many about that, until they
/// coincide.
pub(super) fn sampled(
    start: Point3<f64>,
    end: Point3<f64>,
    value: impl Fn(Point3<f64>) -> f64,
) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    let mut best = f64::INFINITY;
    for _ in 0..12 {
        let share = |k: u32| low + (high - low) * f64::from(k) / 100.0;
        let values = (0..=100).map(|k| (value(start.lerp(&end, share(k))), share(k)));
        let (least, at) = values.fold((f64::INFINITY, 0.0), |best, next| {
            if next.0 < best.0 { next } else { best }
        });
        best = best.min(least);
        let width = (high - low) / 50.0;
        (low, high) = ((at - width).max(0.0), (at + width).min(1.0));
    }
    best
}

fn agree(shape: &Shape, start: Point3<f64>, end: Point3<f64>, expected_m: f64) {
    let expected_m = expected_m - SHAFT_RADIUS_M;
    let found_m = least_gap_m(shape, &start, &end, f64::INFINITY).unwrap();
    assert!(
        (found_m - expected_m).abs() < 2e-9,
        "{shape:?} {start} {end}: {found_m}, {expected_m}"
    );
    // What is said to be farther than enough is farther.
    for enough_m in [expected_m - 0.05, expected_m - 1e-8, expected_m + 1e-8, 0.0] {
        match least_gap_m(shape, &start, &end, enough_m) {
            Some(same) => assert!((same - expected_m).abs() < 2e-9),
            None => assert!(expected_m > enough_m),
        }
    }
}

#[test]
fn sphere_and_half_space_distances_match_closed_forms() {
    let mut random = Random(5);
    for _ in 0..3000 {
        let (start, end, center) = (point(&mut random), point(&mut random), point(&mut random));
        let radius_m = random.between(0.001, 0.1);
        let sphere = Shape::Sphere { center, radius_m };
        agree(
            &sphere,
            start,
            end,
            to_segment(center, start, end) - radius_m,
        );
        let normal = Vector3::from(random.vector(1.0)).normalize();
        let height = |point: Point3<f64>| (point - center).dot(&normal);
        let half_space = Shape::HalfSpace {
            point: center,
            normal,
        };
        agree(&half_space, start, end, height(start).min(height(end)));
    }
}

#[test]
fn capsules_are_as_far_as_sampling_says() {
    let mut random = Random(6);
    for trial in 0..1500 {
        let (start, end, from, mut to) = (
            point(&mut random),
            point(&mut random),
            point(&mut random),
            point(&mut random),
        );
        if trial % 10 == 0 {
            // Parallel.
            to = from + (end - start) * random.between(-1.0, 1.0);
        }
        let radius_m = random.between(0.001, 0.05);
        let capsule = Shape::Capsule {
            start: from,
            end: to,
            radius_m,
        };
        let expected = sampled(start, end, |point| to_segment(point, from, to)) - radius_m;
        agree(&capsule, start, end, expected);
    }
}

#[test]
fn boxes_are_as_far_as_sampling_says() {
    let mut random = Random(7);
    let mut inside = 0;
    for _ in 0..1500 {
        let (start, end) = (point(&mut random), point(&mut random));
        let half_m = Vector3::from_fn(|_, _| random.between(0.001, 0.1));
        let [roll, pitch, yaw] = random.vector(3.0);
        let scene_from_box = Pose::from_parts(
            Translation3::from(random.vector(0.1)),
            UnitQuaternion::from_euler_angles(roll, pitch, yaw),
        );
        let block = Shape::Box {
            box_from_scene: scene_from_box.inverse(),
            half_m,
        };
        // Inside a box: the nearest face. Outside: the nearest point of it.
        let distance = |point: Point3<f64>| {
            let seen = scene_from_box.inverse_transform_point(&point).coords;
            let depth = (half_m - seen.abs()).min();
            if depth > 0.0 {
                -depth
            } else {
                let nearest = seen.zip_map(&half_m, |at, half| at.clamp(-half, half));
                (seen - nearest).norm()
            }
        };
        let expected = sampled(start, end, distance);
        inside += u32::from(expected < 0.0);
        agree(&block, start, end, expected);
    }
    assert!((200..1300).contains(&inside), "{inside}");
}

#[test]
fn a_point_and_nan_are_no_trouble() {
    let sphere = Shape::Sphere {
        center: Point3::origin(),
        radius_m: 0.01,
    };
    let at = Point3::new(0.0, 0.03, 0.04);
    agree(&sphere, at, at, 0.04);
    let nowhere = Point3::new(f64::NAN, 0.0, 0.0);
    for (start, end) in [(at, nowhere), (nowhere, at)] {
        assert!(least_gap_m(&sphere, &start, &end, 0.0).is_some_and(f64::is_nan));
    }
}
