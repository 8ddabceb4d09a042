//! Triangles by the cells of a lattice that their boxes touch, to find those that a collapse might
//! cross.
//!
//! A uniform lattice over the box of all vertices. Lists may hold too many triangles, never too
//! few: a triangle is put into the cells that it enters, and taken out of others only when their
//! list is written to.

use nalgebra::Point3;
use rayon::prelude::*;

use crate::geometry::cross;
use crate::number::{floor_to, index, real};
use crate::surface::complex::Complex;

/// Cells along the longest side.
const CELLS_MAX: usize = 128;

/// The least and the greatest corner of a box of cells.
type Range = [[usize; 3]; 2];

/// Triangles by cell; one that is gone, or has left, may still be in a list.
pub(super) struct Cells {
    /// The lower corner of the box of all vertices, mm. Points outside count as in the cell nearest
    /// to them.
    low: Point3<f64>,
    /// Side of a cell, mm.
    side: f64,
    /// Cells along x, y and z.
    dims: [usize; 3],
    /// Cell `x + dims[0] * (y + dims[1] * z)`.
    lists: Vec<Vec<u32>>,
}

impl Cells {
    pub(super) fn new(positions: &[Point3<f64>], triangles: &[[u32; 3]]) -> Self {
        let first = positions.first().copied().unwrap_or_default();
        let bounds =
            |(low, high): (Point3<f64>, Point3<f64>), p: &Point3<f64>| (low.inf(p), high.sup(p));
        let (low, high) = positions.iter().fold((first, first), bounds);
        let size = high - low;
        let side = (size.max() / real(CELLS_MAX)).max(1e-6);
        let dims = [0, 1, 2].map(|k| floor_to(size[k] / side, CELLS_MAX) + 1);
        let mut cells = Self {
            low,
            side,
            dims,
            lists: vec![Vec::new(); dims.iter().product()],
        };
        for (t, triangle) in triangles.iter().enumerate() {
            let range = cells.range(&triangle.map(|v| positions[v as usize]));
            for cell in cells.within(range) {
                cells.lists[cell].push(index(t));
            }
        }
        cells
    }

    /// The cells that the box of `points` touches, both ends included.
    fn range(&self, points: &[Point3<f64>]) -> Range {
        let at = |p: &Point3<f64>| {
            [0, 1, 2].map(|k| floor_to((p[k] - self.low[k]) / self.side, self.dims[k] - 1))
        };
        let none: Range = [[usize::MAX; 3], [0; 3]];
        points.iter().map(at).fold(none, |[low, high], cell| {
            [
                [0, 1, 2].map(|k| low[k].min(cell[k])),
                [0, 1, 2].map(|k| high[k].max(cell[k])),
            ]
        })
    }

    /// The places of those cells in `lists`, x fastest.
    fn within(&self, [low, high]: Range) -> impl Iterator<Item = usize> + use<> {
        let dims = self.dims;
        let column = move |y: usize, z: usize| {
            (low[0]..=high[0]).map(move |x| x + dims[0] * (y + dims[1] * z))
        };
        (low[2]..=high[2]).flat_map(move |z| (low[1]..=high[1]).flat_map(move |y| column(y, z)))
    }

    /// Triangles that may touch the box of `points`, each once, in order.
    ///
    /// What it gives may be far away, gone or one of those that are asked about: the caller sorts
    /// them out.
    pub(super) fn near(&self, points: &[Point3<f64>]) -> Vec<u32> {
        let cells = self.within(self.range(points));
        let mut found: Vec<u32> = cells.flat_map(|cell| &self.lists[cell]).copied().collect();
        found.sort_unstable();
        found.dedup();
        found
    }

    /// A triangle goes from `before` to `after`; lists that it enters lose those that are not
    /// `alive`.
    pub(super) fn change(
        &mut self,
        triangle: u32,
        before: &[Point3<f64>; 3],
        after: &[Point3<f64>; 3],
        alive: &[bool],
    ) {
        let [low, high] = self.range(before);
        let dims = self.dims;
        let was_in = |cell: usize| {
            let at = [
                cell % dims[0],
                cell / dims[0] % dims[1],
                cell / (dims[0] * dims[1]),
            ];
            (0..3).all(|k| (low[k]..=high[k]).contains(&at[k]))
        };
        for cell in self.within(self.range(after)).filter(|cell| !was_in(*cell)) {
            let list = &mut self.lists[cell];
            list.retain(|other| alive[*other as usize] && *other != triangle);
            list.push(triangle);
        }
    }
}

/// Vertices of triangles that cross others, of their own group where groups are apart; each once,
/// in order.
///
/// One lattice for all, then each triangle against those near it on all cores. Both triangles of a
/// crossing pair give their vertices.
pub(crate) fn crossing_vertices(complex: &Complex) -> Vec<u32> {
    let cells = Cells::new(&complex.positions, &complex.triangles);
    let corners = |t: usize| (&complex.triangles[t], complex.corners(t));
    let apart = complex.is_apart();
    let crosses = |t: &usize| {
        let (numbers, at) = corners(*t);
        let crossed = |other: u32| {
            let (others, place) = corners(other as usize);
            let alike = !apart || complex.sides[*t] == complex.sides[other as usize];
            alike && cross((numbers, &at), (others, &place))
        };
        cells.near(&at).into_iter().any(crossed)
    };
    let all = (0..complex.triangles.len()).into_par_iter();
    let found = all.filter(crosses).map(|t| complex.triangles[t]);
    let mut vertices = found.collect::<Vec<_>>().into_flattened();
    vertices.sort_unstable();
    vertices.dedup();
    vertices
}
