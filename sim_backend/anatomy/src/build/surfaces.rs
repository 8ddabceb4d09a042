//! Surfaces on their way: found, smooth, decimated, each with the volumes of its voxels.

use nalgebra::Point3;
use rayon::prelude::*;

use super::{Options, Stage, StageDistance};
use crate::balance::balance;
use crate::decimate::crossing_vertices;
use crate::groups::{Group, Groups};
use crate::measure::measure;
use crate::mesh::GroupMesh;
use crate::smooth::{Neighbours, smooth, within_reach};
use crate::surface::complex::Complex;
use crate::surface::{Method, cubes, nets};
use crate::volume::Padded;

/// Times that vertices of crossing triangles are put back after decimation: each may lay bare
/// others.
const BACK_MAX: usize = 4;

/// The surfaces between groups, smooth, with the volumes of their voxels; `look` sees them before
/// they are smooth.
pub(super) fn surfaces(
    volume: &Padded,
    targets: &[f64],
    options: &Options,
    watch: &mut dyn FnMut(Stage),
    look: &mut dyn FnMut(&dyn Fn() -> Complex),
) -> Complex {
    let grid = &volume.grid;
    let half_voxel = 0.5 * grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
    match options.surface {
        Method::Nets => {
            let mut net = nets::extract(volume);
            look(&|| Complex::of_net(net.clone(), grid));
            watch(Stage::Smooth);
            let neighbours = Neighbours::of_net(&net);
            let begin = net.positions.clone();
            smooth(&mut net.positions, &neighbours, options.smoothing);
            let mut complex = Complex::of_net(net, grid);
            let voxel_from_world = grid.voxel_from_world().unwrap_or_default();
            let in_cell = |v: usize, to: Point3<f64>| {
                let voxel = Point3::from(voxel_from_world * (to.coords - grid.origin));
                grid.world(&within_reach(&begin[v], voxel))
            };
            balance(&mut complex, targets, half_voxel, in_cell);
            // Sheets a voxel apart may still fold through each other. What is back at the corners
            // of voxels does not: those are faces of voxels. So none crosses in the end: each round
            // puts more of them back.
            let corners: Vec<_> = begin.iter().map(|voxel| grid.world(voxel)).collect();
            put_back(&mut complex, &corners, corners.len());
            complex
        }
        Method::MarchingCubes => {
            let mut complex = cubes::extract(volume);
            look(&|| complex.clone().placed(grid));
            watch(Stage::Smooth);
            let neighbours = Neighbours::of_triangles(&complex.triangles, complex.positions.len());
            smooth(&mut complex.positions, &neighbours, options.smoothing);
            let mut complex = complex.placed(grid);
            balance(&mut complex, targets, half_voxel, |_, to| to);
            complex
        }
    }
}

/// Puts vertices of crossing triangles back to where they were, `before`, until none crosses, in so
/// many `rounds` at most; whether that is so.
fn put_back(complex: &mut Complex, before: &[Point3<f64>], rounds: usize) -> bool {
    for _ in 0..rounds {
        let crossing = crossing_vertices(complex);
        if crossing.is_empty() {
            return true;
        }
        let mut has_moved = false;
        for v in crossing.into_iter().map(|v| v as usize) {
            has_moved |= complex.positions[v] != before[v];
            complex.positions[v] = before[v];
        }
        if !has_moved {
            return false;
        }
    }
    crossing_vertices(complex).is_empty()
}

/// Volumes put right after decimation, by moves of at most `most_mm`; sheets that would pass each
/// other stay where they are, and all do if that is not enough.
pub(super) fn settle(complex: &mut Complex, targets: &[f64], most_mm: f64) {
    let before = complex.positions.clone();
    balance(complex, targets, most_mm, |_, to| to);
    if put_back(complex, &before, BACK_MAX) {
        return;
    }
    let settled = core::mem::replace(&mut complex.positions, before);
    // Sheets that had crossed before, as marching cubes' may, are no reason.
    if !crossing_vertices(complex).is_empty() {
        complex.positions = settled;
    }
}

/// Distances of all groups' surfaces in `complex` from their voxels.
pub(super) fn stage_distances(
    stage: Stage,
    complex: &Complex,
    volume: &Padded,
    groups: &Groups,
    targets: &[f64],
) -> Vec<StageDistance> {
    let of_group = |(number, group): (usize, &Group)| {
        let mesh = GroupMesh::of(complex, number);
        let found = measure(&mesh, volume, targets[number + 1])?;
        Some(StageDistance {
            stage,
            group: group.name.clone(),
            triangles: mesh.triangles.len(),
            hausdorff_voxels: found.hausdorff_voxels,
            mean_voxels: found.mean_voxels,
            dice: found.dice,
        })
    };
    let all = groups.groups.par_iter().enumerate();
    all.filter_map(of_group).collect()
}
