//! Marching cubes (Lorensen and Cline 1987) of one group at a time, with vertices half-way between
//! voxels.
//!
//! The table of triangles is computed from one rule, that on a cube's face corners of the group are
//! cut off one by one, so that neighbouring cubes always agree.
//!
//! Labels have no values to interpolate between, so a vertex is always the middle of an edge
//! between two voxels. Each group is looked at as a binary volume of its own: neighbours get two
//! copies of their common surface, wound oppositely, that do not share vertices.
//!
//! It is there to compare with [`super::nets`]. Diagonals on a face, where marching cubes are
//! ambiguous, cut both corners off; the pipeline's repairs have removed them before.

use std::collections::BTreeMap;

use nalgebra::Point3;

use super::complex::Complex;
use crate::number::{index, real};
use crate::volume::Padded;

/// Corners of a cube's faces, counter-clockwise from outside; corner x + 2 y + 4 z.
const FACES: [[u8; 4]; 6] = [
    [0, 2, 3, 1],
    [4, 5, 7, 6],
    [0, 1, 5, 4],
    [2, 6, 7, 3],
    [0, 4, 6, 2],
    [1, 3, 7, 5],
];

/// An edge of a cube, by its corners, the lower first.
type Edge = (u8, u8);

/// Triangles through edges' middles for each set of corners in the group.
///
/// Indexed by the mask of a cube: bit `x + 2 y + 4 z` is set where that corner is in the group. 256
/// entries, most of a few triangles.
struct Table(Vec<Vec<[Edge; 3]>>);

/// The edge between two corners, whichever is named first.
const fn edge(a: u8, b: u8) -> Edge {
    if a < b { (a, b) } else { (b, a) }
}

/// The edge by which a run of corners of `mask` ends on a face, by the edge by which it begins, for
/// all faces of a cube.
///
/// Each face contributes segments of the contour, directed so that the group is on the same side
/// along all of them. As neighbouring cubes see the same four corners of their common face they cut
/// it in the same segments.
fn crossings(mask: u8) -> BTreeMap<Edge, Edge> {
    let inside = |corner: u8| mask >> corner & 1 == 1;
    let mut next = BTreeMap::new();
    for face in FACES {
        for i in 0..4 {
            let before = face[(i + 3) % 4];
            if !inside(face[i]) || inside(before) {
                continue;
            }
            // A run of corners in the group begins here; find where it ends.
            let end = (i..i + 4).find(|k| !inside(face[(k + 1) % 4])).unwrap_or(i);
            let leaves = edge(face[end % 4], face[(end + 1) % 4]);
            next.insert(edge(before, face[i]), leaves);
        }
    }
    next
}

impl Table {
    /// Computed once an extraction, which is nothing beside the sweep.
    fn new() -> Self {
        Self((0..=255).map(Self::triangles).collect())
    }

    /// Follows the segments to closed polygons and cuts each into a fan from its first edge. 0 and
    /// 255 have none.
    fn triangles(mask: u8) -> Vec<[Edge; 3]> {
        let mut next = crossings(mask);
        let mut triangles = Vec::new();
        while let Some((first, second)) = next.pop_first() {
            let mut around = vec![first];
            let mut at = second;
            while at != first {
                around.push(at);
                match next.remove(&at) {
                    Some(after) => at = after,
                    None => break,
                }
            }
            triangles.extend((1..around.len() - 1).map(|i| [first, around[i], around[i + 1]]));
        }
        triangles
    }
}

/// Vertices by the voxel before them and the axis.
type Vertices = BTreeMap<(usize, u32), u32>;

/// Adds the surface of `group` to `complex`, in voxel coordinates, with background before it.
///
/// A vertex is looked up by the voxel at the lower end of its edge and the axis of the edge; those
/// of layers that are done are dropped, so the map stays as large as a layer.
fn add_group(volume: &Padded, group: u8, table: &Table, complex: &mut Complex) {
    let strides = volume.strides();
    let mut vertices = Vertices::new();
    for z in 0..volume.dims[2] - 1 {
        for y in 0..volume.dims[1] - 1 {
            for x in 0..volume.dims[0] - 1 {
                let at = volume.index(x, y, z);
                let corner = |c: usize| {
                    at + (0..3)
                        .map(|axis| (c >> axis & 1) * strides[axis])
                        .sum::<usize>()
                };
                let mask = (0..8).fold(0, |mask, c| {
                    mask | u8::from(volume.voxels[corner(c)] == group) << c
                });
                for triangle in &table.0[usize::from(mask)] {
                    let corners = triangle.map(|(low, high)| {
                        let axis = (low ^ high).ilog2();
                        let voxel = corner(usize::from(low));
                        let place = || {
                            let c = |axis: usize| usize::from(low) >> axis & 1;
                            let mut p = [x + c(0), y + c(1), z + c(2)].map(|c| real(c) - 1.0);
                            p[axis as usize] += 0.5;
                            Point3::from(p)
                        };
                        *vertices.entry((voxel, axis)).or_insert_with(|| {
                            complex.positions.push(place());
                            index(complex.positions.len() - 1)
                        })
                    });
                    complex.triangles.push(corners);
                    complex.sides.push([group, 0]);
                }
            }
        }
        // Nothing below the next layer is met again.
        vertices = vertices.split_off(&(volume.index(0, 0, z + 1), 0));
    }
}

/// Surfaces of all groups of `volume`, each by itself, in voxel coordinates.
///
/// A sweep over the whole volume for each group that is there.
#[must_use]
pub fn extract(volume: &Padded) -> Complex {
    let table = Table::new();
    let counts = volume.counts();
    let mut complex = Complex::default();
    for group in (1..=u8::MAX).filter(|group| counts[usize::from(*group)] > 0) {
        add_group(volume, group, &table, &mut complex);
    }
    complex
}
