//! Which voxels' middles lie in a mesh, by rays along the first axis.
//!
//! By the parity of crossings: a middle is inside if an odd number of triangles lies before it on
//! its ray. That needs a closed mesh, and does not care how triangles are wound. One pass over
//! triangles serves all rows at once.

use nalgebra::Point3;

use crate::number::{floor_to, real, single};
use crate::volume::Padded;

/// Rays pass beside voxels' middles by this, so that they hit no vertex.
const ASIDE: [f64; 2] = [1.234e-7, 2.718e-7];

/// Where rays cross the surface, by row of voxels.
///
/// `positions` are in voxels, with middles at whole numbers. Row `y + dims[1] * z`; each list of x
/// is sorted. Crossings are kept in single precision, which is off by less than a thousandth of a
/// voxel.
pub(super) fn crossings(
    positions: &[Point3<f64>],
    triangles: &[[u32; 3]],
    dims: [usize; 3],
) -> Vec<Vec<f32>> {
    let mut rows = vec![Vec::new(); dims[1] * dims[2]];
    for triangle in triangles {
        let corners = triangle.map(|v| positions[v as usize]);
        let range = |k: usize| {
            let low = corners.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min);
            let high = corners
                .iter()
                .map(|p| p[k])
                .fold(f64::NEG_INFINITY, f64::max);
            floor_to(low, dims[k] - 1)..=floor_to(high.ceil(), dims[k] - 1)
        };
        for z in range(2) {
            for y in range(1) {
                if let Some(x) = crossing(&corners, real(y) + ASIDE[0], real(z) + ASIDE[1]) {
                    rows[y + dims[1] * z].push(single(x));
                }
            }
        }
    }
    for row in &mut rows {
        row.sort_by(f32::total_cmp);
    }
    rows
}

/// Where the ray at (y, z) crosses a triangle.
///
/// By signed areas in the yz plane. A side shared by two triangles gets the same magnitude in both,
/// bit by bit, so no ray slips between them. None also for a triangle parallel to the ray.
fn crossing([a, b, c]: &[Point3<f64>; 3], y: f64, z: f64) -> Option<f64> {
    let side = |p: &Point3<f64>, q: &Point3<f64>| {
        // From the same end for both triangles at an edge, so that the ray passes one of them.
        let (p, q, sign) = if (p.y, p.z) < (q.y, q.z) {
            (p, q, 1.0)
        } else {
            (q, p, -1.0)
        };
        sign * ((q.y - p.y) * (z - p.z) - (q.z - p.z) * (y - p.y))
    };
    let [u, v, w] = [side(b, c), side(c, a), side(a, b)];
    let inside = (u >= 0.0 && v >= 0.0 && w >= 0.0) || (u <= 0.0 && v <= 0.0 && w <= 0.0);
    let sum = u + v + w;
    (inside && sum.abs() > 0.0).then(|| (u * a.x + v * b.x + w * c.x) / sum)
}

/// Voxels of `group`, voxels whose middles are in the mesh, and those that are both.
///
/// The three counts from which Dice is made.
pub(super) fn compare(
    positions: &[Point3<f64>],
    triangles: &[[u32; 3]],
    volume: &Padded,
    group: u8,
) -> (usize, usize, usize) {
    let rows = crossings(positions, triangles, volume.dims);
    let (mut voxels, mut inside, mut both) = (0, 0, 0);
    for (row, line) in rows.iter().zip(volume.voxels.chunks_exact(volume.dims[0])) {
        let mut passed = 0;
        for (x, label) in line.iter().enumerate() {
            while passed < row.len() && f64::from(row[passed]) < real(x) {
                passed += 1;
            }
            let (is_label, is_inside) = (*label == group, passed % 2 == 1);
            voxels += usize::from(is_label);
            inside += usize::from(is_inside);
            both += usize::from(is_label && is_inside);
        }
    }
    (voxels, inside, both)
}
