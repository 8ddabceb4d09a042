//! A chart: triangles side by side in a plane.
//!
//! Coordinates are mm in the plane that the chart is seen along. Overlaps arise where a surface
//! folds back behind itself and still faces the same way; such a triangle begins another chart.

use std::collections::BTreeMap;

use nalgebra::{Point2, Vector2};

use crate::mesh::GroupMesh;

/// Triangles in a plane, none over another.
pub(super) struct Chart {
    /// Indices in the mesh, with corners in the plane, counter-clockwise.
    triangles: Vec<(usize, [Point2<f64>; 3])>,
    /// Places in `triangles` by the grid cells that their boxes touch.
    cells: BTreeMap<(i64, i64), Vec<usize>>,
    /// Side of a cell, mm: twice an edge of the mesh's first triangle.
    cell: f64,
    /// The box of all triangles; infinite the wrong way round while there is none.
    low: Point2<f64>,
    high: Point2<f64>,
}

/// Whether two triangles have points in common besides those on their sides.
///
/// The separating axis theorem with the six normals of sides. What overlaps by less than 1e-9 mm
/// only touches; sides without length separate nothing.
fn overlap(a: &[Point2<f64>; 3], b: &[Point2<f64>; 3]) -> bool {
    let separated = |one: &[Point2<f64>; 3], other: &[Point2<f64>; 3]| {
        (0..3).any(|i| {
            let side = one[(i + 1) % 3] - one[i];
            let normal = Vector2::new(side.y, -side.x);
            let Some(normal) = normal.try_normalize(1e-12) else {
                return false;
            };
            let along = |p: &Point2<f64>| normal.dot(&(p - one[i]));
            let reach = |t: &[Point2<f64>; 3]| {
                let along = t.map(|p| along(&p));
                let low = along.iter().copied().fold(f64::INFINITY, f64::min);
                (low, along.iter().copied().fold(f64::NEG_INFINITY, f64::max))
            };
            let ((low_a, high_a), (low_b, high_b)) = (reach(one), reach(other));
            high_a <= low_b + 1e-9 || high_b <= low_a + 1e-9
        })
    };
    !separated(a, b) && !separated(b, a)
}

impl Chart {
    /// An empty chart of triangles of `mesh`.
    pub(super) fn new(mesh: &GroupMesh) -> Self {
        let edge = mesh.triangles.first().map_or(1.0, |t| {
            (mesh.positions[t[0] as usize] - mesh.positions[t[1] as usize]).norm()
        });
        Self {
            triangles: Vec::new(),
            cells: BTreeMap::new(),
            cell: (2.0 * edge).max(1e-3),
            low: Point2::from([f64::INFINITY; 2]),
            high: Point2::from([f64::NEG_INFINITY; 2]),
        }
    }

    /// The cells that the box of a triangle touches.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "cells of a body some metres in size"
    )]
    fn cells_of(&self, corners: &[Point2<f64>; 3]) -> impl Iterator<Item = (i64, i64)> + use<> {
        let [a, b, c] = corners;
        let (low, high) = (a.inf(b).inf(c), a.sup(b).sup(c));
        let cell = |x: f64| (x / self.cell).floor() as i64;
        let (columns, rows) = (cell(low.x)..=cell(high.x), cell(low.y)..=cell(high.y));
        columns.flat_map(move |i| rows.clone().map(move |j| (i, j)))
    }

    /// Adds a triangle if it covers none that is there.
    pub(super) fn take(&mut self, triangle: usize, corners: [Point2<f64>; 3]) -> bool {
        let cells: Vec<(i64, i64)> = self.cells_of(&corners).collect();
        let mut near: Vec<usize> = cells
            .iter()
            .filter_map(|cell| self.cells.get(cell))
            .flatten()
            .copied()
            .collect();
        near.sort_unstable();
        near.dedup();
        if near
            .into_iter()
            .any(|other| overlap(&corners, &self.triangles[other].1))
        {
            return false;
        }
        for cell in cells {
            self.cells
                .entry(cell)
                .or_default()
                .push(self.triangles.len());
        }
        for p in corners {
            self.low = self.low.inf(&p);
            self.high = self.high.sup(&p);
        }
        self.triangles.push((triangle, corners));
        true
    }

    /// Its triangles with their corners.
    pub(super) fn triangles(&self) -> impl Iterator<Item = (usize, [Point2<f64>; 3])> + '_ {
        self.triangles.iter().copied()
    }

    /// The corner of its box.
    pub(super) const fn low(&self) -> Point2<f64> {
        self.low
    }

    /// The size of its box.
    pub(super) fn size(&self) -> Vector2<f64> {
        self.high - self.low
    }
}
