//! Hot path: bounded, no allocation, no I/O, no lock.
//! Material points between the nodes: the sheet as fine as a finger needs it, sixteen to a cell.

use nalgebra::Vector3;

use super::sheet::{Sheet, count};

/// Samples along each side of a cell.
const SIDE: usize = 4;
/// Samples in a cell.
pub(super) const PER_CELL: usize = SIDE * SIDE;

/// A point of the sheet's material: a cell, by its lowest node, and the weights of the cell's
/// corners.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct MaterialPoint {
    corners: [usize; 4],
    weights: [f64; 4],
}

impl MaterialPoint {
    fn new(first: usize, row: usize, [s, t]: [f64; 2]) -> Self {
        Self {
            corners: [first, first + 1, first + row, first + row + 1],
            weights: [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t],
        }
    }

    /// The point at the material coordinates `at_m`, held inside the sheet.
    pub(super) fn at(sheet: &Sheet, at_m: [f64; 2]) -> Self {
        let [(i, s), (j, t)] = [0, 1].map(|axis| {
            let cells = sheet.nodes[axis] - 1;
            let along = (at_m[axis] / sheet.spacing_m[axis]).clamp(0.0, count(cells));
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "clamped to the number of cells"
            )]
            let cell = (along as usize).min(cells - 1);
            (cell, along - count(cell))
        });
        Self::new(j * sheet.nodes[0] + i, sheet.nodes[0], [s, t])
    }

    /// Its value of a field over the nodes.
    #[inline]
    pub(super) fn of(&self, field: &[Vector3<f64>]) -> Vector3<f64> {
        let [a, b, c, d] = self.corners;
        let [p, q, r, s] = self.weights;
        field[a] * p + field[b] * q + field[c] * r + field[d] * s
    }

    /// Its material coordinates, m.
    pub(super) fn material_m(&self, sheet: &Sheet) -> [f64; 2] {
        let (row, [first, ..]) = (sheet.nodes[0], self.corners);
        let [_, q, r, s] = self.weights;
        [
            (count(first % row) + q + s) * sheet.spacing_m[0],
            (count(first / row) + r + s) * sheet.spacing_m[1],
        ]
    }

    /// Derivatives of the position along u and v, over the cell's corners.
    pub(super) fn tangents(&self, field: &[Vector3<f64>]) -> [Vector3<f64>; 2] {
        let [a, b, c, d] = self.corners.map(|corner| field[corner]);
        let [p, q, r, s] = self.weights;
        [
            (b - a) * (p + q) + (d - c) * (r + s),
            (c - a) * (p + r) + (d - b) * (q + s),
        ]
    }

    /// The corners with their weights.
    #[inline]
    pub(super) fn shares(&self) -> impl Iterator<Item = (usize, f64)> + '_ {
        self.corners.iter().copied().zip(self.weights)
    }
}

/// All samples of a sheet.
#[derive(Clone, Debug)]
pub(super) struct Samples {
    points: Vec<MaterialPoint>,
    /// Area of the sheet for which one sample stands, m².
    pub(super) area_m2: f64,
    /// Furthest that a sample may be from the nearest corner of its cell, m, be the cell stretched
    /// up to tearing.
    cell_m: f64,
}

impl Samples {
    pub(super) fn new(sheet: &Sheet) -> Self {
        let row = sheet.nodes[0];
        let share = |index: usize| (count(index) + 0.5) / count(SIDE);
        let mut points = Vec::new();
        for j in 0..sheet.nodes[1] - 1 {
            for i in 0..row - 1 {
                points.extend((0..PER_CELL).map(|sub| {
                    MaterialPoint::new(j * row + i, row, [share(sub % SIDE), share(sub / SIDE)])
                }));
            }
        }
        let [u, v] = sheet.spacing_m;
        let cell_m = 0.5 * (1.0 + sheet.material.tear_strain) * (u * u + v * v).sqrt();
        Self {
            points,
            area_m2: u * v / count(PER_CELL),
            cell_m,
        }
    }

    /// How many there are.
    pub(super) const fn len(&self) -> usize {
        self.points.len()
    }

    /// One of them.
    #[inline]
    pub(super) fn get(&self, index: usize) -> &MaterialPoint {
        &self.points[index]
    }

    /// Visits, in order, all samples within `reach_m` of `middle` and some that are further away.
    pub(super) fn around(
        &self,
        sheet: &Sheet,
        middle: &Vector3<f64>,
        reach_m: f64,
        mut visit: impl FnMut(usize, &MaterialPoint),
    ) {
        let reach_m2 = (reach_m + self.cell_m) * (reach_m + self.cell_m);
        for (cell, points) in self.points.chunks_exact(PER_CELL).enumerate() {
            let close =
                |corner: &usize| (sheet.positions[*corner] - middle).norm_squared() < reach_m2;
            if points[0].corners.iter().any(close) {
                for (sub, point) in points.iter().enumerate() {
                    visit(cell * PER_CELL + sub, point);
                }
            }
        }
    }
}
