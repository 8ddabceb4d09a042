//! The tetrahedra of a body-centred cubic lattice whose middles lie in a mesh.
//!
//! Vertices are the corners and the middles of cubic cells. Two cells with a common face make four
//! tetrahedra, each of their two middles and an edge of the face; twelve a cell, all of one shape.
//!
//! Each tetrahedron has two edges of the length of the side and four of `sqrt(3) / 2` of it, and a
//! twelfth of a cell's volume. Places are counted in halves of a side while vertices are numbered,
//! so that equal places are equal numbers, and middles of tetrahedra in quarters.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Point3, Vector3};

use super::{TETRAHEDRA_MAX, Tetrahedra, sixfold};
use crate::grid::Grid;
use crate::measure::inside as voxels_inside;
use crate::mesh::GroupMesh;
use crate::number::{index, real};

/// Steps of a cell's side in which all middles of tetrahedra are whole numbers.
const STEPS: usize = 4;

/// Corners of a face's edges, from the lowest corner of the face, along its two axes.
///
/// Each of the four, with the two middles, is a tetrahedron.
const EDGES: [[[usize; 2]; 2]; 4] = [
    [[0, 0], [1, 0]],
    [[1, 0], [1, 1]],
    [[1, 1], [0, 1]],
    [[0, 1], [0, 0]],
];

/// Vertices by their place in halves of a cell's side.
struct Vertices {
    /// The number of each place.
    known: BTreeMap<[usize; 3], u32>,
    /// The places by number, in halves of a side from the lowest corner.
    places: Vec<[usize; 3]>,
}

impl Vertices {
    /// The number of a place, a new one the first time.
    fn number(&mut self, place: [usize; 3]) -> u32 {
        *self.known.entry(place).or_insert_with(|| {
            self.places.push(place);
            index(self.places.len() - 1)
        })
    }
}

/// How many cells there are along x, y and z around the mesh with one to spare, and the lowest
/// corner, mm.
fn cells(mesh: &GroupMesh, side: f64) -> ([usize; 3], Point3<f64>) {
    let first = mesh.positions.first().copied().unwrap_or_default();
    let bounds = mesh
        .positions
        .iter()
        .fold((first, first), |(low, high), p| (low.inf(p), high.sup(p)));
    let spare = Vector3::repeat(side);
    let (low, size) = (bounds.0 - spare, bounds.1 - bounds.0 + 2.0 * spare);
    let counts = [0, 1, 2].map(|k| crate::number::floor_to((size[k] / side).ceil(), 1 << 20));
    (counts, low)
}

/// The tetrahedra of a lattice with cells of `side` whose middles are in `mesh`.
///
/// Insides are found by rays on a grid four times as fine as the cells, all middles at once.
///
/// # Errors
/// If cells or tetrahedra would be more than `TETRAHEDRA_MAX`; it is judged before anything is
/// allocated.
pub(super) fn inside(mesh: &GroupMesh, side: f64) -> Result<Tetrahedra, String> {
    let too_many = || format!("cells of {side:.2} mm are more than {TETRAHEDRA_MAX} tetrahedra");
    let (counts, low) = cells(mesh, side);
    if mesh.volume_mm3() / side.powi(3) * 12.0 > real(TETRAHEDRA_MAX)
        || counts.iter().map(|count| real(*count)).product::<f64>() > real(TETRAHEDRA_MAX)
    {
        return Err(too_many());
    }
    let grid = Grid {
        dims: counts.map(|count| STEPS * count + 1),
        steps: Matrix3::identity() * (side / real(STEPS)),
        origin: low.coords,
    };
    let filled = voxels_inside(mesh, &grid);
    let is_in = |at: [usize; 3]| filled[at[0] + grid.dims[0] * (at[1] + grid.dims[1] * at[2])];
    let mut vertices = Vertices {
        known: BTreeMap::new(),
        places: Vec::new(),
    };
    let mut corners = Vec::new();
    for (cell, axis) in pairs(counts) {
        for tetrahedron in of_pair(cell, axis) {
            // In quarters of a side: the mean of four places in halves.
            let middle =
                [0, 1, 2].map(|k| tetrahedron.iter().map(|place| place[k]).sum::<usize>() / 2);
            if is_in(middle) {
                corners.push(tetrahedron.map(|place| vertices.number(place)));
            }
        }
    }
    let half = |place: &[usize; 3]| low + Vector3::from(place.map(real)) * (0.5 * side);
    let positions: Vec<_> = vertices.places.iter().map(half).collect();
    for tetrahedron in &mut corners {
        if sixfold(&positions, tetrahedron) < 0.0 {
            tetrahedron.swap(2, 3);
        }
    }
    let surface = surface(&corners);
    Ok(Tetrahedra {
        group: mesh.group,
        side_mm: side,
        positions,
        corners,
        surface,
    })
}

/// Cells that have a next one along an axis, with that axis.
fn pairs([x, y, z]: [usize; 3]) -> impl Iterator<Item = ([usize; 3], usize)> {
    let cells = (0..z).flat_map(move |k| (0..y).flat_map(move |j| (0..x).map(move |i| [i, j, k])));
    cells.flat_map(move |cell| {
        let next = move |axis: &usize| cell[*axis] + 1 < [x, y, z][*axis];
        (0..3).filter(next).map(move |axis| (cell, axis))
    })
}

/// Places of the corners, in halves of a side, of the four tetrahedra between `cell` and the next
/// along `axis`.
fn of_pair(cell: [usize; 3], axis: usize) -> [[[usize; 3]; 4]; 4] {
    let low = cell.map(|c| 2 * c);
    let first = low.map(|c| c + 1);
    let mut second = first;
    second[axis] += 2;
    EDGES.map(|edge| {
        let [a, b] = edge.map(|[u, v]| {
            let mut place = low;
            place[axis] += 2;
            place[(axis + 1) % 3] += 2 * u;
            place[(axis + 2) % 3] += 2 * v;
            place
        });
        [first, second, a, b]
    })
}

/// Faces that one tetrahedron has, outwards.
///
/// Sorts all faces by their vertices: the two of an inner face stand together. O(n log n).
fn surface(corners: &[[u32; 4]]) -> Vec<[u32; 3]> {
    let mut faces: Vec<([u32; 3], [u32; 3])> = corners
        .iter()
        .flat_map(|&[a, b, c, d]| [[a, c, b], [a, b, d], [b, c, d], [a, d, c]])
        .map(|face| {
            let mut sorted = face;
            sorted.sort_unstable();
            (sorted, face)
        })
        .collect();
    faces.sort_unstable();
    let single = faces
        .chunk_by(|a, b| a.0 == b.0)
        .filter(|same| same.len() == 1);
    single.map(|same| same[0].1).collect()
}
