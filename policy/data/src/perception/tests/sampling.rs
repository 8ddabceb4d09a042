//! Farthest-point sampling, thinning and neighbours against the plain algorithms.

use std::collections::BTreeMap;

use super::{between, scattered};
use crate::perception::{PerceptionError, Point, farthest_points, nearest_points, thin};
use hal::random::SplitMix64;

fn squared(a: &Point, b: &Point) -> f32 {
    let [x, y, z]: Point = core::array::from_fn(|axis| a[axis] - b[axis]);
    (x * x + y * y) + z * z
}

/// The plain algorithm: every point's distance is updated in every round, and the first maximum
/// wins.
fn plain(points: &[Point], count: usize) -> Vec<usize> {
    let mut nearest = vec![f32::INFINITY; points.len()];
    let mut taken = vec![0];
    while taken.len() < count {
        let sample = points[taken[taken.len() - 1]];
        let mut best = 0;
        for (index, point) in points.iter().enumerate() {
            nearest[index] = nearest[index].min(squared(point, &sample));
            if nearest[index] > nearest[best] {
                best = index;
            }
        }
        taken.push(best);
    }
    taken
}

fn check(name: &str, points: &[Point], count: usize) {
    let taken = farthest_points(points, count).unwrap();
    assert_eq!(taken, plain(points, count), "{name}");
}

#[test]
fn sampling_is_the_plain_algorithm_to_the_bit() {
    for seed in 0..6 {
        let random = &mut SplitMix64::new(seed);
        check("a cube", &scattered(random, 3000, [0.1, 0.1, 0.1]), 300);
        check("a sheet", &scattered(random, 3000, [0.2, 0.1, 0.0]), 300);
        check("a line", &scattered(random, 2000, [0.0, 0.3, 0.0]), 200);
        check("few", &scattered(random, 5, [0.1, 0.1, 0.1]), 5);
        let mut outlier = scattered(random, 2500, [0.1, 0.1, 0.01]);
        outlier[1234] = [50.0, -3.0, 2.0];
        check("an outlier", &outlier, 250);
        let mut clumps = scattered(random, 1500, [1e-3, 1e-3, 1e-3]);
        clumps.extend(scattered(random, 1500, [0.3, 0.3, 0.3]));
        check("a clump", &clumps, 250);
    }
}

#[test]
fn of_equal_maxima_the_first_wins() {
    // The corners of a square from one of them: the far one, then the first of the two others.
    let square = [
        [0.0, 0.0, 0.0],
        [1.0, 0.0, 0.0],
        [0.0, 1.0, 0.0],
        [1.0, 1.0, 0.0],
    ];
    assert_eq!(farthest_points(&square, 4).unwrap(), [0, 3, 1, 2]);
    // A lattice in random order is nothing but ties, within buckets and across them.
    for seed in 0..4 {
        let mut lattice: Vec<Point> = (0..2744_u16)
            .map(|i| [i % 14, i / 14 % 14, i / 196].map(|x| f32::from(x) * 0.125))
            .collect();
        SplitMix64::new(seed).shuffle(&mut lattice);
        check("a lattice", &lattice, 600);
    }
}

#[test]
fn when_all_points_are_taken_the_first_is_taken_again() {
    let twice = [[0.5; 3], [1.0; 3], [0.5; 3], [2.0; 3], [1.0; 3]];
    assert_eq!(farthest_points(&twice, 6).unwrap(), [0, 3, 1, 0, 0, 0]);
    assert_eq!(plain(&twice, 6), [0, 3, 1, 0, 0, 0]);
    assert_eq!(farthest_points(&[[7.0; 3]], 3).unwrap(), [0, 0, 0]);
}

#[test]
fn distances_beyond_single_precision_are_ties() {
    let far = [
        [0.0; 3],
        [1e30, 0.0, 0.0],
        [-3e38, 0.0, 0.0],
        [3e38, 0.0, 0.0],
    ];
    check("far", &far, 4);
}

#[test]
fn senseless_requests_are_refused() {
    let refuse = |points: &[Point], count| farthest_points(points, count).unwrap_err();
    assert_eq!(refuse(&[], 3), PerceptionError::NothingToChoose);
    assert_eq!(refuse(&[[0.0; 3]], 0), PerceptionError::NoPoints);
    let odd = [[0.0; 3], [0.0, f32::NAN, 0.0]];
    assert_eq!(refuse(&odd, 1), PerceptionError::NotFinite { index: 1 });
    for side_m in [0.0, -1.0, f32::NAN, f32::INFINITY] {
        let error = thin(&[[0.0; 3]], side_m).unwrap_err();
        assert!(matches!(error, PerceptionError::Voxel { .. }), "{side_m}");
    }
    let error = nearest_points(&[[0.0; 3]], &[], 2).unwrap_err();
    assert_eq!(
        error,
        PerceptionError::TooFewNeighbours {
            wanted: 2,
            points: 1
        }
    );
}

#[test]
fn thinning_keeps_the_first_point_of_every_cube() {
    let random = &mut SplitMix64::new(11);
    let points = scattered(random, 20_000, [0.1, 0.06, 0.02]);
    for side_m in [0.0009_f32, 0.005, 1.0] {
        let mut first = BTreeMap::new();
        for (index, point) in points.iter().enumerate() {
            #[expect(clippy::cast_possible_truncation, reason = "few cubes")]
            let cube = point.map(|x| (x / side_m).floor() as i64);
            first.entry(cube).or_insert(index);
        }
        let mut expected: Vec<usize> = first.into_values().collect();
        expected.sort_unstable();
        let expected: Vec<Point> = expected.into_iter().map(|index| points[index]).collect();
        assert_eq!(thin(&points, side_m).unwrap(), expected, "{side_m}");
    }
    assert_eq!(thin(&[], 0.1).unwrap(), Vec::<Point>::new());
}

#[test]
fn neighbours_are_the_nearest_and_the_first_of_equals() {
    let random = &mut SplitMix64::new(12);
    let mut points = scattered(random, 500, [0.1, 0.1, 0.1]);
    // Ties: a lattice among them.
    points.extend((0..125_u8).map(|i| [i % 5, i / 5 % 5, i / 25].map(|x| f32::from(x) * 0.25)));
    let mut centres: Vec<Point> = points.iter().step_by(7).copied().collect();
    centres.push([between(random, -1.0, 1.0), 0.0, 9.0]);
    let found = nearest_points(&points, &centres, 9).unwrap();
    for (centre, found) in centres.iter().zip(found.chunks_exact(9)) {
        let mut order: Vec<usize> = (0..points.len()).collect();
        order.sort_by(|&a, &b| squared(&points[a], centre).total_cmp(&squared(&points[b], centre)));
        assert_eq!(found, &order[..9], "{centre:?}");
    }
}
