//! Distances against dense sampling and against the shapes' own definitions.

use super::{between_segments, fraction_nearest};
use crate::region::{Block, Shape};
use hal::random::SplitMix64;
use nalgebra::{Rotation3, Vector3};

type Point = Vector3<f64>;

fn point(random: &mut SplitMix64, size: f64) -> Point {
    Point::from_fn(|_, _| random.between(-size, size))
}

fn rotation(random: &mut SplitMix64) -> Rotation3<f64> {
    Rotation3::from_euler_angles(
        random.between(-3.0, 3.0),
        random.between(-3.0, 3.0),
        random.between(-3.0, 3.0),
    )
}

fn shape(random: &mut SplitMix64) -> Shape {
    match random.next_u64() % 4 {
        0 => Shape::Sphere {
            center_m: point(random, 0.1),
            radius_m: random.between(0.001, 0.08),
        },
        1 => Shape::Capsule {
            from_m: point(random, 0.1),
            to_m: point(random, 0.1),
            radius_m: random.between(0.001, 0.05),
        },
        2 => Shape::HalfSpace {
            point_m: point(random, 0.1),
            normal: rotation(random) * Point::z(),
        },
        _ => Shape::Box(Block {
            center_m: point(random, 0.05),
            half_m: Point::from_fn(|_, _| random.between(0.001, 0.08)),
            axes: rotation(random),
        }),
    }
}

/// The signed distance of one point, straight from what each shape is.
fn signed(shape: &Shape, p: &Point) -> f64 {
    match shape {
        Shape::Sphere { center_m, radius_m } => (p - center_m).norm() - radius_m,
        Shape::Capsule {
            from_m,
            to_m,
            radius_m,
        } => {
            let nearest = from_m + (to_m - from_m) * fraction_nearest(p, from_m, to_m);
            (p - nearest).norm() - radius_m
        }
        Shape::HalfSpace { point_m, normal } => (p - point_m).dot(normal),
        Shape::Box(block) => {
            let q = (block.axes.transpose() * (p - block.center_m)).abs() - block.half_m;
            q.sup(&Point::zeros()).norm() + q.max().min(0.0)
        }
    }
}

/// A segment of any length, sometimes a point, sometimes along a box's axis.
fn segment(random: &mut SplitMix64, shape: &Shape) -> (Point, Point) {
    let from_m = point(random, 0.15);
    let length = random.between(0.0, 0.2);
    let to_m = match (random.next_u64() % 6, shape) {
        (0, _) => from_m,
        (1, Shape::Box(block)) => from_m + block.axes * Point::y() * length,
        (
            1,
            Shape::Capsule {
                from_m: a, to_m: b, ..
            },
        ) => from_m + (b - a).normalize() * length,
        (2, Shape::Box(block)) => 2.0 * block.center_m - from_m,
        _ => point(random, 0.15),
    };
    (from_m, to_m)
}

/// No sampled point is nearer and the nearest one is where it says.
#[test]
fn nearest_point_is_nearer_than_all_samples() {
    let mut random = SplitMix64::new(71);
    let (mut inside, mut outside) = (0, 0);
    for case in 0..6_000 {
        let shape = shape(&mut random);
        let (from_m, to_m) = segment(&mut random, &shape);
        let nearest = shape.nearest(&from_m, &to_m);
        assert!((0.0..=1.0).contains(&nearest.fraction), "case {case}");
        let at = |fraction: f64| from_m + (to_m - from_m) * fraction;
        let there = signed(&shape, &at(nearest.fraction));
        assert!(
            (there - nearest.distance_m).abs() < 1e-14,
            "case {case}: {there} {nearest:?} {shape:?}"
        );
        for i in 0..=400 {
            let sampled = signed(&shape, &at(f64::from(i) / 400.0));
            assert!(
                sampled >= nearest.distance_m - 1e-14,
                "case {case}: {sampled} {nearest:?} {shape:?} {from_m} {to_m}"
            );
        }
        if nearest.distance_m < 0.0 {
            inside += 1;
        } else {
            outside += 1;
        }
    }
    assert!(inside > 1_000 && outside > 1_000, "{inside} {outside}");
}

#[test]
fn the_normal_is_the_gradient_of_the_distance() {
    let mut random = SplitMix64::new(72);
    for case in 0..6_000 {
        let shape = shape(&mut random);
        let (from_m, to_m) = segment(&mut random, &shape);
        let nearest = shape.nearest(&from_m, &to_m);
        assert!((nearest.normal.norm() - 1.0).abs() < 1e-12, "case {case}");
        // A step along the normal gains its length where the normal is unique: here, outside.
        if nearest.distance_m > 1e-4 {
            let step = nearest.normal * 1e-5;
            let here = from_m + (to_m - from_m) * nearest.fraction;
            let gained = signed(&shape, &(here + step)) - nearest.distance_m;
            assert!((gained - 1e-5).abs() < 1e-12, "case {case}: {gained}");
        }
    }
}

#[test]
fn a_segment_moved_out_along_the_normal_is_free() {
    let mut random = SplitMix64::new(73);
    let mut moved = 0;
    for case in 0..6_000 {
        let shape = shape(&mut random);
        let p = point(&mut random, 0.1);
        let nearest = shape.nearest(&p, &p);
        if nearest.distance_m < 0.0 {
            let out = p - nearest.normal * nearest.distance_m;
            assert!(signed(&shape, &out).abs() < 1e-12, "case {case}");
            moved += 1;
        }
    }
    assert!(moved > 500, "{moved}");
}

#[test]
fn centres_have_normals() {
    let center_m = Point::new(0.01, -0.02, 0.03);
    let sphere = Shape::Sphere {
        center_m,
        radius_m: 0.01,
    };
    let side = Point::new(0.02, 0.01, 0.0);
    for (from_m, to_m) in [
        (center_m, center_m),
        (center_m - side, center_m + side),
        (center_m, center_m + side),
    ] {
        let nearest = sphere.nearest(&from_m, &to_m);
        assert!((nearest.distance_m + 0.01).abs() < 1e-15);
        assert!((nearest.normal.norm() - 1.0).abs() < 1e-12);
        assert!(nearest.normal.dot(&(to_m - from_m)).abs() < 1e-12);
    }
}

#[test]
fn no_sampled_pair_of_points_of_two_segments_is_nearer() {
    let mut random = SplitMix64::new(74);
    let mut crossed = 0;
    for case in 0..6_000 {
        let a = (point(&mut random, 0.1), point(&mut random, 0.1));
        let along = a.1 - a.0;
        let b = match case % 6 {
            // A point, parallel, the same line, nearly parallel, crossing, anything.
            0 => (point(&mut random, 0.1), Point::zeros()),
            1 => {
                let start = point(&mut random, 0.1);
                (start, start + along * random.between(-2.0, 2.0))
            }
            2 => (
                a.0 + along * random.between(-1.0, 2.0),
                a.0 + along * random.between(-1.0, 2.0),
            ),
            3 => {
                let start = point(&mut random, 0.1);
                let off = point(&mut random, 0.1) * 10.0_f64.powf(random.between(-14.0, -2.0));
                (start, start + along + off)
            }
            4 => {
                let meet = a.0 + along * random.between(0.0, 1.0);
                let other = point(&mut random, 0.1);
                (meet + other * 0.4, meet - other * 0.6)
            }
            _ => (point(&mut random, 0.1), point(&mut random, 0.1)),
        };
        let b = if case % 6 == 0 { (b.0, b.0) } else { b };
        let found = between_segments(&a.0, &a.1, &b.0, &b.1);
        let on = |s: (Point, Point), fraction: f64| s.0 + (s.1 - s.0) * fraction;
        let away = on(a, found.fraction_a) - on(b, found.fraction_b);
        assert!(
            (away.norm() - found.distance_m).abs() < 1e-15,
            "case {case}"
        );
        assert!((found.normal.norm() - 1.0).abs() < 1e-12, "case {case}");
        if found.distance_m > 1e-9 {
            assert!((away - found.normal * found.distance_m).norm() < 1e-14);
        } else {
            assert!(found.normal.dot(&along).abs() < 1e-9, "case {case}");
            crossed += 1;
        }
        for i in 0..=200 {
            // The other segment's nearest point to a sampled one is exact, so one loop samples
            // both.
            let p = on(a, f64::from(i) / 200.0);
            let q = on(b, f64::from(i) / 200.0);
            let to_b = (p - on(b, fraction_nearest(&p, &b.0, &b.1))).norm();
            let to_a = (q - on(a, fraction_nearest(&q, &a.0, &a.1))).norm();
            let least = to_a.min(to_b);
            assert!(
                least >= found.distance_m - 1e-13,
                "case {case}: {least} {found:?}"
            );
        }
    }
    assert!(crossed > 900, "{crossed}");
}

#[test]
fn a_blocks_clearances_are_to_its_faces() {
    let mut random = SplitMix64::new(75);
    for case in 0..2_000 {
        let block = Block {
            center_m: point(&mut random, 0.1),
            half_m: Point::from_fn(|_, _| random.between(0.01, 0.1)),
            axes: rotation(&mut random),
        };
        let p = point(&mut random, 0.15);
        let clearances = block.clearances_m(&p);
        let least = clearances
            .iter()
            .fold(f64::INFINITY, |least, &h| least.min(h));
        let signed_m = signed(&Shape::Box(block), &p);
        // Inside both are the depth; outside a face can't be further than the box.
        if least >= 0.0 {
            assert!((least + signed_m).abs() < 1e-15, "case {case}");
        } else {
            assert!(-least <= signed_m + 1e-15 && signed_m > 0.0, "case {case}");
        }
        for (index, inward) in block.inward().iter().enumerate() {
            let moved = block.clearances_m(&(p + inward * 1e-3))[index];
            assert!(
                (moved - clearances[index] - 1e-3).abs() < 1e-15,
                "case {case}"
            );
        }
    }
}
