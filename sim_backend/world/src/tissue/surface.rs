//! The flap as a closed surface for drawing: a smooth refinement of the grid, both faces and the
//! rim.
//!
//! Vertices and triangles are chosen once; a frame only moves them and allocates nothing.

use hal::Mesh;
use hal::count::count_u32;
use hal::mesh::single;
use nalgebra::Vector3;

use super::sheet::{Sheet, count};

/// Parts into which each cell side is split for drawing.
const SPLIT: usize = 3;

/// What to draw of a sheet.
#[derive(Clone, Debug)]
pub struct Surface {
    mesh: Mesh,
    nodes: [usize; 2],
    points: [usize; 2],
    /// Distance of the points in the material, m.
    spacing_m: [f64; 2],
    half_thickness_m: f64,
    weights: [[f64; 4]; SPLIT],
    /// Rows of nodes refined along u, then everything refined along both.
    rows: Vec<Vector3<f64>>,
    middle: Vec<Vector3<f64>>,
    /// Vertices of the rim in order around the sheet, as numbers of `middle`.
    rim: Vec<usize>,
}

impl Surface {
    /// The surface of `sheet` as it is now; the upper face is the one that u cross v points out of.
    #[must_use]
    pub fn new(sheet: &Sheet) -> Self {
        let nodes = sheet.nodes();
        let points = nodes.map(|nodes| (nodes - 1) * SPLIT + 1);
        let whole = points[0] * points[1];
        let rim = rim(points);
        let vertices = 2 * whole + 2 * rim.len();
        let mut surface = Self {
            mesh: Mesh {
                positions: vec![[0.0; 3]; vertices],
                normals: vec![[0.0; 3]; vertices],
                indices: indices(points, rim.len()),
            },
            nodes,
            points,
            spacing_m: sheet.spacing_m.map(|spacing_m| spacing_m / count(SPLIT)),
            half_thickness_m: 0.5 * sheet.material.thickness_m,
            weights: core::array::from_fn(|part| spline(count(part) / count(SPLIT))),
            rows: vec![Vector3::zeros(); points[0] * nodes[1]],
            middle: vec![Vector3::zeros(); whole],
            rim,
        };
        surface.update(&sheet.positions);
        surface
    }

    /// The mesh, scene frame.
    #[must_use]
    pub const fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// How many nodes it is laid through.
    #[must_use]
    pub const fn node_count(&self) -> usize {
        self.nodes[0] * self.nodes[1]
    }

    /// Follows the sheet, whose nodes are at `positions` (m, in their order), [`Self::node_count`]
    /// of them. Indices and the number of vertices stay.
    pub fn update(&mut self, positions: &[Vector3<f64>]) {
        self.refine(positions);
        let [columns, rows] = self.points;
        let whole = columns * rows;
        for j in 0..rows {
            for i in 0..columns {
                let here = j * columns + i;
                let normal = self.normal(i, j);
                let offset = normal * self.half_thickness_m;
                self.set(here, &(self.middle[here] + offset), &normal);
                self.set(whole + here, &(self.middle[here] - offset), &-normal);
            }
        }
        self.update_rim();
    }

    /// The edge, whose normals lead away from the sheet.
    fn update_rim(&mut self) {
        let [columns, rows] = self.points;
        let whole = columns * rows;
        for corner in 0..self.rim.len() {
            let here = self.rim[corner];
            let next = self.rim[(corner + 1) % self.rim.len()];
            let before = self.rim[(corner + self.rim.len() - 1) % self.rim.len()];
            let up = self.normal(here % columns, here / columns);
            let along = self.middle[next] - self.middle[before];
            let out = along.cross(&up).try_normalize(0.0).unwrap_or(up);
            let offset = up * self.half_thickness_m;
            self.set(2 * whole + 2 * corner, &(self.middle[here] + offset), &out);
            self.set(
                2 * whole + 2 * corner + 1,
                &(self.middle[here] - offset),
                &out,
            );
        }
    }

    /// Lays cubic splines through the nodes, first along u, then along v.
    fn refine(&mut self, positions: &[Vector3<f64>]) {
        let (nodes, columns) = (self.nodes, self.points[0]);
        for j in 0..nodes[1] {
            let row = &positions[j * nodes[0]..(j + 1) * nodes[0]];
            for i in 0..columns {
                let at = |node: usize| row[node];
                self.rows[j * columns + i] = along(nodes[0], i, &self.weights, at);
            }
        }
        for i in 0..columns {
            for j in 0..self.points[1] {
                let at = |node: usize| self.rows[node * columns + i];
                self.middle[j * columns + i] = along(nodes[1], j, &self.weights, at);
            }
        }
    }

    /// The upper face at the material coordinates `at_m`, held inside the sheet: place and unit
    /// normal.
    pub(super) fn upper(&self, at_m: [f64; 2]) -> (Vector3<f64>, Vector3<f64>) {
        let [(i, s), (j, t)] = [0, 1].map(|axis| {
            let last = self.points[axis] - 1;
            let along = (at_m[axis] / self.spacing_m[axis]).clamp(0.0, count(last));
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "clamped to the number of points"
            )]
            let low = (along as usize).min(last - 1);
            (low, along - count(low))
        });
        let corners = [(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)];
        let weights = [(1.0 - s) * (1.0 - t), s * (1.0 - t), (1.0 - s) * t, s * t];
        let mut at = Vector3::zeros();
        let mut normal = Vector3::zeros();
        for ((i, j), weight) in corners.into_iter().zip(weights) {
            let here = self.normal(i, j);
            at += (self.middle[j * self.points[0] + i] + here * self.half_thickness_m) * weight;
            normal += here * weight;
        }
        (at, normal.try_normalize(0.0).unwrap_or_else(Vector3::z))
    }

    fn normal(&self, i: usize, j: usize) -> Vector3<f64> {
        let [columns, rows] = self.points;
        let at = |i: usize, j: usize| self.middle[j * columns + i];
        let along_u = at((i + 1).min(columns - 1), j) - at(i.saturating_sub(1), j);
        let along_v = at(i, (j + 1).min(rows - 1)) - at(i, j.saturating_sub(1));
        along_u
            .cross(&along_v)
            .try_normalize(0.0)
            .unwrap_or_else(Vector3::z)
    }

    fn set(&mut self, vertex: usize, position: &Vector3<f64>, normal: &Vector3<f64>) {
        self.mesh.positions[vertex] = single(position);
        self.mesh.normals[vertex] = single(normal);
    }
}

/// Weights of four neighbouring nodes at the share `t` between the inner two (Catmull and Rom).
fn spline(t: f64) -> [f64; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (2.0 * t2 - t - t3),
        0.5 * (2.0 - 5.0 * t2 + 3.0 * t3),
        0.5 * (t + 4.0 * t2 - 3.0 * t3),
        0.5 * (t3 - t2),
    ]
}

/// The spline through `nodes` nodes at refined point `point`; beyond the ends the line goes on
/// straight.
fn along(
    nodes: usize,
    point: usize,
    weights: &[[f64; 4]; SPLIT],
    at: impl Fn(usize) -> Vector3<f64>,
) -> Vector3<f64> {
    let (cell, part) = (point / SPLIT, point % SPLIT);
    if part == 0 {
        return at(cell);
    }
    let (low, high) = (at(cell), at(cell + 1));
    let before = if cell == 0 {
        low * 2.0 - high
    } else {
        at(cell - 1)
    };
    let after = if cell + 2 < nodes {
        at(cell + 2)
    } else {
        high * 2.0 - low
    };
    let [p, q, r, s] = weights[part];
    before * p + low * q + high * r + after * s
}

/// Points around a grid, so that the outside is on the right: along u, up v, and back.
fn rim([columns, rows]: [usize; 2]) -> Vec<usize> {
    let bottom = 0..columns - 1;
    let right = (0..rows - 1).map(|j| j * columns + columns - 1);
    let top = (1..columns).rev().map(|i| (rows - 1) * columns + i);
    let left = (1..rows).rev().map(|j| j * columns);
    bottom.chain(right).chain(top).chain(left).collect()
}

/// Triangles of the upper face, the lower face and the rim.
fn indices([columns, rows]: [usize; 2], rim: usize) -> Vec<u32> {
    let whole = columns * rows;
    let mut triangles: Vec<usize> = Vec::new();
    for j in 0..rows - 1 {
        for i in 0..columns - 1 {
            let here = j * columns + i;
            let (beside, above) = (here + 1, here + columns);
            triangles.extend([here, beside, above + 1, here, above + 1, above]);
            let lower = [here, above + 1, beside, here, above, above + 1];
            triangles.extend(lower.map(|vertex| vertex + whole));
        }
    }
    for corner in 0..rim {
        let (here, next) = (2 * whole + 2 * corner, 2 * whole + 2 * ((corner + 1) % rim));
        triangles.extend([here, here + 1, next + 1, here, next + 1, next]);
    }
    triangles.into_iter().map(count_u32).collect()
}
