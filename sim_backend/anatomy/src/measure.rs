//! How well a mesh stands for its voxels.
//!
//! Two surfaces are compared, the mesh and the faces of the group's voxels, and two volumes. All
//! distances are in voxels, in the padded volume's coordinates: 1 is the distance of neighbours
//! along any axis, whatever it is in mm. That is the scale on which a segmentation is uncertain.
//!
//! Distances are sampled, so the largest one found is a lower bound of the Hausdorff distance.
//! Samples depend on mesh and group alone and not on the cores.

mod boundary;
pub(crate) mod nearest;
mod voxelise;

#[cfg(test)]
mod tests;

use nalgebra::Point3;
use rayon::prelude::*;

use hal::random::SplitMix64;

use crate::grid::Grid;
use crate::mesh::GroupMesh;
use crate::number::{floor_to, real};
use crate::volume::Padded;
use boundary::{distance_to_boundary, face_middles};
use nearest::Nearest;

/// Most points at which a distance is measured, of each direction.
const SAMPLES: usize = 150_000;

/// What was measured of a group's mesh.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Measures {
    /// Volume of the group's voxels, islands removed and holes filled, mm³.
    pub voxels_mm3: f64,
    /// Volume of the mesh, mm³.
    pub mesh_mm3: f64,
    /// The mesh's volume over the voxels'.
    pub volume_ratio: f64,
    /// Whether every edge has two triangles.
    pub watertight: bool,
    /// The largest distance between the mesh and the faces of its voxels, in either direction,
    /// voxels.
    pub hausdorff_voxels: f64,
    /// The mean of the distances in both directions, voxels.
    pub mean_voxels: f64,
    /// Twice the common voxels of label and re-voxelised mesh, over the sum of both.
    pub dice: f64,
    /// Points at which distances were measured, from voxels' faces to the mesh and back.
    pub samples: [usize; 2],
}

/// The mesh's vertices in voxel coordinates of the padded volume.
fn in_voxels(mesh: &GroupMesh, grid: &Grid) -> Option<Vec<Point3<f64>>> {
    let voxel_from_world = grid.voxel_from_world()?;
    let place = |p: &Point3<f64>| {
        Point3::from(voxel_from_world * (p.coords - grid.origin)) + nalgebra::Vector3::repeat(1.0)
    };
    Some(mesh.positions.iter().map(place).collect())
}

/// Points spread over the mesh: each triangle's middle, and more by its area, in voxels.
fn points_on(positions: &[Point3<f64>], triangles: &[[u32; 3]], seed: u64) -> Vec<Point3<f64>> {
    let mut random = SplitMix64::named("samples", seed);
    let corners = |t: &[u32; 3]| t.map(|v| positions[v as usize]);
    let area = |t: &[u32; 3]| {
        let [a, b, c] = corners(t);
        0.5 * (b - a).cross(&(c - a)).norm()
    };
    let total: f64 = triangles.iter().map(area).sum();
    let density = (real(SAMPLES.saturating_sub(triangles.len())) / total.max(1e-9)).min(2.0);
    let mut points = Vec::new();
    for triangle in triangles {
        let [a, b, c] = corners(triangle);
        points.push(a + ((b - a) + (c - a)) / 3.0);
        for _ in 0..floor_to(area(triangle) * density, SAMPLES) {
            let (mut u, mut v) = (random.unit(), random.unit());
            if u + v > 1.0 {
                (u, v) = (1.0 - u, 1.0 - v);
            }
            points.push(a + (b - a) * u + (c - a) * v);
        }
    }
    points.extend_from_slice(positions);
    let stride = points.len().div_ceil(SAMPLES).max(1);
    points.into_iter().step_by(stride).collect()
}

/// Largest, and sum.
fn largest_and_sum(distances: &[f64]) -> (f64, f64) {
    distances
        .iter()
        .fold((0.0, 0.0), |(most, sum), d| (f64::max(most, *d), sum + d))
}

/// Measures `mesh` against its voxels in `volume`, and its volume against `voxels_mm3`; none if the
/// lattice is flat or the group has no voxels.
#[must_use]
pub fn measure(mesh: &GroupMesh, volume: &Padded, voxels_mm3: f64) -> Option<Measures> {
    let group = u8::try_from(mesh.group + 1).ok()?;
    let positions = in_voxels(mesh, &volume.grid)?;
    let faces = face_middles(volume, group, SAMPLES);
    if faces.is_empty() || mesh.triangles.is_empty() {
        return None;
    }
    let nearest = Nearest::new(&positions, &mesh.triangles);
    let to_mesh: Vec<f64> = faces.par_iter().map(|p| nearest.distance(p)).collect();
    let points = points_on(&positions, &mesh.triangles, u64::from(group));
    let to_voxels: Vec<f64> = points
        .par_iter()
        .map(|p| distance_to_boundary(volume, group, p))
        .collect();
    let ((most_a, sum_a), (most_b, sum_b)) =
        (largest_and_sum(&to_mesh), largest_and_sum(&to_voxels));
    let (voxels, inside, both) = voxelise::compare(&positions, &mesh.triangles, volume, group);
    let mesh_mm3 = mesh.volume_mm3();
    Some(Measures {
        voxels_mm3,
        mesh_mm3,
        volume_ratio: mesh_mm3 / voxels_mm3,
        watertight: mesh.is_watertight(),
        hausdorff_voxels: most_a.max(most_b),
        mean_voxels: 0.5 * (sum_a / real(to_mesh.len()) + sum_b / real(to_voxels.len())),
        dice: 2.0 * real(both) / real(voxels + inside),
        samples: [to_mesh.len(), to_voxels.len()],
    })
}

/// Whether the middle of each voxel of `grid` lies in `mesh`, the first axis fastest.
pub(crate) fn inside(mesh: &GroupMesh, grid: &Grid) -> Vec<bool> {
    let Some(positions) = in_voxels(mesh, grid) else {
        return vec![false; grid.len()];
    };
    let dims = grid.dims.map(|side| side + 2);
    let rows = voxelise::crossings(&positions, &mesh.triangles, dims);
    let mut inside = Vec::with_capacity(grid.len());
    for z in 1..=grid.dims[2] {
        for y in 1..=grid.dims[1] {
            let row = &rows[y + dims[1] * z];
            let mut passed = 0;
            inside.extend((1..=grid.dims[0]).map(|x| {
                while passed < row.len() && f64::from(row[passed]) < real(x) {
                    passed += 1;
                }
                passed % 2 == 1
            }));
        }
    }
    inside
}
