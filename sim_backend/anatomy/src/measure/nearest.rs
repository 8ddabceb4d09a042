//! The triangle nearest to a point, by a lattice of cells.
//!
//! Cells are walked in growing cubic rings about the point until no farther ring can hold anything
//! nearer. Built once a mesh, read by many threads. Used for distances of voxel faces from meshes,
//! and by [`crate::tetra`] to bring vertices to a surface.

use nalgebra::Point3;

use crate::geometry::{distance_squared, nearest_on_triangle};
use crate::number::{floor_to, index, real};

/// Cells along an axis at most.
const CELLS_MAX: usize = 128;

/// Triangles by cells.
pub(crate) struct Nearest<'a> {
    /// In voxels or mm: distances come out in the same unit.
    positions: &'a [Point3<f64>],
    triangles: &'a [[u32; 3]],
    /// The lower corner of the box of all vertices.
    low: Point3<f64>,
    /// Side of a cell: a 128th of the longest side of the box, and at least 1.
    cell: f64,
    /// Cells along x, y and z.
    dims: [usize; 3],
    /// Where the triangles of each cell begin in `list`, and the end.
    starts: Vec<u32>,
    /// Triangles by cell; one that reaches over several cells is in each of them.
    list: Vec<u32>,
}

impl<'a> Nearest<'a> {
    /// Sorts one entry a triangle and cell; some times as many as triangles.
    pub(crate) fn new(positions: &'a [Point3<f64>], triangles: &'a [[u32; 3]]) -> Self {
        let none = (
            Point3::from([f64::INFINITY; 3]),
            Point3::from([f64::NEG_INFINITY; 3]),
        );
        let (low, high) = positions
            .iter()
            .fold(none, |(low, high), p| (low.inf(p), high.sup(p)));
        let size = high - low;
        let cell = (size.max() / real(CELLS_MAX)).max(1.0);
        let dims = [0, 1, 2].map(|k| floor_to(size[k] / cell, CELLS_MAX) + 1);
        let mut nearest = Self {
            positions,
            triangles,
            low,
            cell,
            dims,
            starts: vec![0; dims.iter().product::<usize>() + 1],
            list: Vec::new(),
        };
        let entries = |nearest: &Self| -> Vec<(u32, u32)> {
            let cells = |t: usize| nearest.cells_of(t).map(move |cell| (index(cell), index(t)));
            (0..triangles.len()).flat_map(cells).collect()
        };
        let mut entries = entries(&nearest);
        entries.sort_unstable();
        for (cell, _) in &entries {
            nearest.starts[*cell as usize + 1] += 1;
        }
        for cell in 1..nearest.starts.len() {
            nearest.starts[cell] += nearest.starts[cell - 1];
        }
        nearest.list = entries.into_iter().map(|(_, triangle)| triangle).collect();
        nearest
    }

    fn corners(&self, triangle: usize) -> [Point3<f64>; 3] {
        self.triangles[triangle].map(|v| self.positions[v as usize])
    }

    fn cell_at(&self, p: &Point3<f64>) -> [usize; 3] {
        [0, 1, 2].map(|k| floor_to((p[k] - self.low[k]) / self.cell, self.dims[k] - 1))
    }

    /// Cells that the triangle's box touches.
    fn cells_of(&self, triangle: usize) -> impl Iterator<Item = usize> + use<> {
        let [a, b, c] = self.corners(triangle);
        let (low, high) = (
            self.cell_at(&a.inf(&b).inf(&c)),
            self.cell_at(&a.sup(&b).sup(&c)),
        );
        let dims = self.dims;
        let column = move |y: usize, z: usize| {
            (low[0]..=high[0]).map(move |x| x + dims[0] * (y + dims[1] * z))
        };
        (low[2]..=high[2]).flat_map(move |z| (low[1]..=high[1]).flat_map(move |y| column(y, z)))
    }

    /// The nearer of `best` and the nearest triangle of a cell, as squared distance and triangle.
    fn in_cell(&self, p: &Point3<f64>, cell: usize, best: (f64, u32)) -> (f64, u32) {
        let range = self.starts[cell] as usize..self.starts[cell + 1] as usize;
        self.list[range].iter().fold(best, |best, t| {
            let squared = distance_squared(p, &self.corners(*t as usize));
            if squared < best.0 {
                (squared, *t)
            } else {
                best
            }
        })
    }

    /// The distance of `p` from the nearest triangle.
    ///
    /// Infinite if there is no triangle.
    pub(crate) fn distance(&self, p: &Point3<f64>) -> f64 {
        self.find(p).0.sqrt()
    }

    /// The point of the nearest triangle that is nearest to `p`; `p` if there is no triangle.
    pub(crate) fn point(&self, p: &Point3<f64>) -> Point3<f64> {
        match self.find(p) {
            (_, u32::MAX) => *p,
            (_, t) => nearest_on_triangle(p, &self.corners(t as usize)),
        }
    }

    /// The nearest triangle, with its squared distance.
    ///
    /// Triangle `u32::MAX` at an infinite distance if there is none.
    fn find(&self, p: &Point3<f64>) -> (f64, u32) {
        let at = self.cell_at(p);
        let most = self.dims.into_iter().max().unwrap_or(1);
        let mut best = (f64::INFINITY, u32::MAX);
        for ring in 0..=most {
            let range =
                |k: usize| at[k].saturating_sub(ring)..=(at[k] + ring).min(self.dims[k] - 1);
            for z in range(2) {
                for y in range(1) {
                    for x in range(0) {
                        let far = x
                            .abs_diff(at[0])
                            .max(y.abs_diff(at[1]))
                            .max(z.abs_diff(at[2]));
                        if far == ring {
                            let cell = x + self.dims[0] * (y + self.dims[1] * z);
                            best = self.in_cell(p, cell, best);
                        }
                    }
                }
            }
            // What lies in farther rings is at least this far; a point outside of the cells is
            // farther still.
            let seen = real(ring) * self.cell;
            if best.0 <= seen * seen {
                break;
            }
        }
        best
    }
}
