//! Surfaces of balls and of noise are closed, have the voxels' volume, and stay within half a
//! voxel.

use std::collections::BTreeMap;

use hal::random::SplitMix64;
use nalgebra::{Matrix3, Point3};

use super::complex::Complex;
use super::{Method, cubes, nets};
use crate::balance::balance;
use crate::clean::separate_touching;
use crate::decimate::decimate;
use crate::grid::Grid;
use crate::nifti::LabelVolume;
use crate::smooth::{Neighbours, smooth};
use crate::volume::Padded;

const RANKS: [u32; 4] = [u32::MAX, 3, 1, 2];

fn volume(side: usize, group: impl Fn([f64; 3]) -> u8) -> Padded {
    let mut grid = Grid::centred([side; 3], [0.8, 1.0, 1.5]);
    // Left-handed, as most scans are stored.
    grid.steps = Matrix3::from_diagonal(&nalgebra::Vector3::new(-0.8, 1.0, 1.5));
    let at =
        |i: usize| group([i % side, i / side % side, i / side / side].map(crate::number::real));
    let voxels = (0..side * side * side).map(at).collect();
    let mut volume = Padded::new(LabelVolume { grid, voxels });
    separate_touching(&mut volume, &RANKS);
    volume
}

/// Two balls that touch, in a third group around them, which is cut off by the scan below.
fn organs(side: usize) -> Padded {
    let middle = 0.5 * crate::number::real(side);
    let ball = move |p: [f64; 3], dx: f64, r: f64| {
        let d = [p[0] - middle - dx, p[1] - middle, p[2] - middle];
        d.iter().map(|x| x * x).sum::<f64>() < r * r
    };
    volume(side, move |p| {
        if ball(p, -0.2 * middle, 0.36 * middle) {
            1
        } else if ball(p, 0.4 * middle, 0.3 * middle) {
            2
        } else {
            3 * u8::from(ball([p[0], p[1], p[2].max(middle)], 0.0, 0.9 * middle))
        }
    })
}

fn complex(volume: &Padded, method: Method, passes: usize) -> Complex {
    match method {
        Method::Nets => {
            let mut net = nets::extract(volume);
            let neighbours = Neighbours::of_net(&net);
            smooth(&mut net.positions, &neighbours, passes);
            Complex::of_net(net, &volume.grid)
        }
        Method::MarchingCubes => {
            let mut complex = cubes::extract(volume);
            let neighbours = Neighbours::of_triangles(&complex.triangles, complex.positions.len());
            smooth(&mut complex.positions, &neighbours, passes);
            complex.placed(&volume.grid)
        }
    }
}

/// Edges of a group's surface that have not one triangle on either side.
fn open_edges(complex: &Complex, group: u8) -> usize {
    let mut edges: BTreeMap<(u32, u32), i32> = BTreeMap::new();
    for (triangle, sides) in complex.triangles.iter().zip(&complex.sides) {
        if !sides.contains(&group) {
            continue;
        }
        let [a, b, c] = if sides[0] == group {
            *triangle
        } else {
            [triangle[0], triangle[2], triangle[1]]
        };
        for edge in [(a, b), (b, c), (c, a)] {
            *edges.entry(edge).or_insert(0) += 1;
        }
    }
    edges
        .iter()
        .filter(|((a, b), count)| **count != 1 || edges.get(&(*b, *a)) != Some(&1))
        .count()
}

fn targets(volume: &Padded) -> Vec<f64> {
    #[expect(clippy::cast_precision_loss, reason = "small counts")]
    let mm3 = |count: &u64| *count as f64 * volume.grid.voxel_mm3();
    volume.counts().iter().take(32).map(mm3).collect()
}

#[test]
fn unsmoothed_nets_have_exactly_the_voxels_volume() {
    let volume = organs(20);
    let volumes = complex(&volume, Method::Nets, 0).volumes();
    for (group, target) in targets(&volume).iter().enumerate().skip(1) {
        assert!(
            (volumes[group] - target).abs() < 1e-6,
            "{group}: {} {target}",
            volumes[group]
        );
    }
}

#[test]
fn every_groups_surface_is_closed_at_every_stage() {
    for method in [Method::Nets, Method::MarchingCubes] {
        let volume = organs(24);
        let smoothed = complex(&volume, method, 10);
        let coarse = decimate(smoothed.clone(), 0.6);
        assert!(coarse.triangles.len() * 4 < smoothed.triangles.len());
        for group in 0..4 {
            assert_eq!(open_edges(&smoothed, group), 0, "{method:?} {group}");
            assert_eq!(
                open_edges(&coarse, group),
                0,
                "{method:?} {group} decimated"
            );
        }
    }
}

#[test]
fn noise_has_closed_surfaces_too() {
    let mut random = SplitMix64::new(8);
    let values: Vec<u8> = (0..1000)
        .map(|_| u8::try_from(random.below(4)).expect("small"))
        .collect();
    let volume = volume(10, |p| {
        values[crate::number::floor_to(p[0] + 10.0 * p[1] + 100.0 * p[2], 999)]
    });
    for method in [Method::Nets, Method::MarchingCubes] {
        let fine = complex(&volume, method, 5);
        let coarse = decimate(fine.clone(), 0.5);
        for group in 1..4 {
            assert_eq!(open_edges(&fine, group), 0, "{method:?} {group}");
            assert_eq!(
                open_edges(&coarse, group),
                0,
                "{method:?} {group} decimated"
            );
        }
    }
}

#[test]
fn balancing_gives_every_group_its_volume() {
    for method in [Method::Nets, Method::MarchingCubes] {
        let volume = organs(24);
        let mut coarse = decimate(complex(&volume, method, 20), 0.4);
        let targets = targets(&volume);
        balance(&mut coarse, &targets, 1.0, |_, to| to);
        for (group, volume) in coarse.volumes().iter().enumerate().skip(1).take(3) {
            let ratio = volume / targets[group];
            assert!((ratio - 1.0).abs() < 2e-3, "{method:?} {group}: {ratio}");
        }
    }
}

#[test]
fn smoothing_keeps_within_half_a_voxel_and_does_not_shrink() {
    let volume = organs(32);
    let begin = nets::extract(&volume);
    let mut net = begin.clone();
    let neighbours = Neighbours::of_net(&net);
    smooth(&mut net.positions, &neighbours, 20);
    let most = |a: &Point3<f64>, b: &Point3<f64>| (a - b).amax();
    assert!(
        begin
            .positions
            .iter()
            .zip(&net.positions)
            .all(|(a, b)| most(a, b) < 0.5)
    );
    let volumes = Complex::of_net(net, &volume.grid).volumes();
    let ratio = volumes[1] / targets(&volume)[1];
    assert!((ratio - 1.0).abs() < 0.03, "{ratio}");
}

/// A decimated surface's vertices and the fine one's lie within the bound of each other's.
#[test]
fn decimation_keeps_its_bound() {
    let fine = complex(&organs(24), Method::Nets, 10);
    for error_mm in [0.1, 0.5] {
        let coarse = decimate(fine.clone(), error_mm);
        let distance = |p: &Point3<f64>| {
            (0..coarse.triangles.len())
                .map(|t| crate::geometry::distance_squared(p, &coarse.corners(t)))
                .fold(f64::INFINITY, f64::min)
        };
        let worst = fine
            .positions
            .iter()
            .map(distance)
            .fold(0.0, f64::max)
            .sqrt();
        assert!(worst <= error_mm + 1e-9, "{worst} mm of {error_mm}");
    }
}

#[test]
fn decimation_does_not_depend_on_cores() {
    let fine = complex(&organs(24), Method::Nets, 10);
    let alone = rayon::ThreadPoolBuilder::new()
        .num_threads(1)
        .build()
        .expect("a pool");
    let one = alone.install(|| decimate(fine.clone(), 0.5));
    let many = decimate(fine, 0.5);
    assert!(one.positions == many.positions && one.triangles == many.triangles);
}
