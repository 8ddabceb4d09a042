//! Smoothing of a net without shrinkage: Taubin's low-pass filter (1995), every vertex within half
//! a voxel of where it began.
//!
//! A vertex between two groups moves with all its neighbours, one on a line where three meet with
//! those along that line, so that such lines become smooth and stay what they are.
//!
//! A step moves vertex `i` by `step * (mean of its neighbours - p_i)`. Of a component whose
//! eigenvalue of this umbrella operator is `-k` (`k` in 0 to 2) a pair of steps leaves
//! `(1 - 0.5 k) (1 + 0.53 k)`: about 1 below the pass-band frequency `1 / 0.5 - 1 / 0.53` = 0.113,
//! so the shape stays, and 0 at `k` = 2, so the stairs of voxels go (G. Taubin, SIGGRAPH 1995).
//!
//! All is in voxel coordinates: voxels of 1 x 1 x 5 mm are smoothed five times as far along z.
//! Volumes change a little all the same; `balance` puts them right.

use nalgebra::{Point3, Vector3};
use rayon::prelude::*;

use crate::number::{index, real};
use crate::surface::nets::Net;

/// How far a vertex may go from its corner along each axis, voxels.
const REACH: f64 = 0.49;

/// Taubin's two steps: the first smooths and shrinks, the second grows again.
///
/// Taubin's lambda and mu.
const STEPS: [f64; 2] = [0.5, -0.53];

/// No neighbour.
const NONE: u32 = u32::MAX;

/// Neighbours of a vertex along the six directions of the lattice, with the groups around the edge
/// to each, a bit a group.
///
/// Entry `d` is direction `d`, see `direction`. A vertex of a net lies at a corner of voxels, so
/// six neighbours are all it can have.
#[derive(Clone, Copy)]
struct Star {
    /// `NONE` where no edge of a quad leads.
    neighbours: [u32; 6],
    /// 0 where no edge leads; two bits along a sheet, three or more along a line.
    groups: [u32; 6],
}

impl Star {
    /// A quad is met at each of its edges, so each edge comes once for every quad at it.
    fn add(&mut self, direction: usize, neighbour: u32, groups: u32) {
        self.neighbours[direction] = neighbour;
        self.groups[direction] |= groups;
    }

    /// Neighbours that a vertex moves with.
    ///
    /// On a sheet all of them, on a line only those along lines, so that a line's shape does not
    /// depend on how the sheets leave it.
    fn active(&self) -> impl Iterator<Item = u32> + '_ {
        let around = self.groups.iter().fold(0, |all, groups| all | groups);
        let least = if around.count_ones() > 2 { 3 } else { 2 };
        let pairs = self.neighbours.iter().zip(&self.groups);
        pairs
            .filter(move |(_, groups)| groups.count_ones() >= least)
            .map(|(neighbour, _)| *neighbour)
    }
}

/// The direction from one corner of the lattice to the next.
///
/// `2 * axis`, plus 1 upwards; the opposite direction differs in the lowest bit.
fn direction(from: &Point3<f64>, to: &Point3<f64>) -> usize {
    let step = to - from;
    let axis = step.iamax();
    2 * axis + usize::from(step[axis] > 0.0)
}

/// The stars of all vertices, from one pass over the quads.
fn stars(net: &Net) -> Vec<Star> {
    let empty = Star {
        neighbours: [NONE; 6],
        groups: [0; 6],
    };
    let mut stars = vec![empty; net.positions.len()];
    for (quad, sides) in net.quads.iter().zip(&net.sides) {
        let groups = 1 << sides[0] | 1 << sides[1];
        for i in 0..4 {
            let (a, b) = (quad[i], quad[(i + 1) % 4]);
            let along = direction(&net.positions[a as usize], &net.positions[b as usize]);
            stars[a as usize].add(along, b, groups);
            stars[b as usize].add(along ^ 1, a, groups);
        }
    }
    stars
}

/// Neighbours with which each vertex moves, one list after the other.
///
/// A list in compressed rows, so that a pass over all vertices reads memory in order.
pub(crate) struct Neighbours {
    /// Where each vertex' neighbours begin in `list`, and the end: one entry more than vertices.
    starts: Vec<u32>,
    /// Indices of vertices.
    list: Vec<u32>,
}

impl Neighbours {
    /// Of a net as [`crate::surface::nets::extract`] gives it, its vertices at corners of voxels.
    pub(crate) fn of_net(net: &Net) -> Self {
        let stars = stars(net);
        let mut all = Self {
            starts: vec![0],
            list: Vec::with_capacity(5 * stars.len()),
        };
        for star in &stars {
            all.list.extend(star.active());
            all.starts.push(index(all.list.len()));
        }
        all
    }

    /// Of closed surfaces that do not touch: all neighbours of each of `count` vertices.
    ///
    /// Relies on each directed edge being there once, as marching cubes give it, so that each
    /// neighbour is counted once.
    pub(crate) fn of_triangles(triangles: &[[u32; 3]], count: usize) -> Self {
        let mut starts = vec![0; count + 1];
        for v in triangles.as_flattened() {
            starts[*v as usize + 1] += 1;
        }
        for v in 0..count {
            starts[v + 1] += starts[v];
        }
        let mut free = starts.clone();
        let mut list = vec![0; 3 * triangles.len()];
        for &[a, b, c] in triangles {
            // Each edge is there once in each direction.
            for (from, to) in [(a, b), (b, c), (c, a)] {
                list[free[from as usize] as usize] = to;
                free[from as usize] += 1;
            }
        }
        Self { starts, list }
    }

    /// The neighbours of one vertex.
    fn of(&self, vertex: usize) -> &[u32] {
        &self.list[self.starts[vertex] as usize..self.starts[vertex + 1] as usize]
    }
}

/// Where a vertex at `here` goes, of which `begin` is the beginning.
///
/// A vertex with fewer than two neighbours stays: it is the end of a line.
fn moved(
    here: &Point3<f64>,
    begin: &Point3<f64>,
    neighbours: &[u32],
    all: &[Point3<f64>],
    step: f64,
) -> Point3<f64> {
    if neighbours.len() < 2 {
        return *here;
    }
    let sum: Vector3<f64> = neighbours.iter().map(|v| all[*v as usize].coords).sum();
    within_reach(
        begin,
        here + (sum / real(neighbours.len()) - here.coords) * step,
    )
}

/// The place nearest to `target` that a vertex may have which began at `begin`, in voxel
/// coordinates.
///
/// Where each stays in the cell of its own corner, triangles without a common vertex can't cross:
/// each lies in the block of the cells of its quad, and blocks that have a cell in common have its
/// vertex in common.
///
/// Clamped along each axis by itself, so that it stays in a cube, not in a ball.
pub(crate) fn within_reach(begin: &Point3<f64>, target: Point3<f64>) -> Point3<f64> {
    begin + (target - begin).map(|x| x.clamp(-REACH, REACH))
}

/// Smooths `positions` (voxel coordinates) by `passes` pairs of steps.
///
/// Each step reads only places from before it (Jacobi, not Gauss-Seidel), so vertices run in
/// parallel and the result does not depend on the cores. Two buffers of positions besides the
/// beginning.
pub(crate) fn smooth(positions: &mut Vec<Point3<f64>>, neighbours: &Neighbours, passes: usize) {
    let begin = positions.clone();
    for step in (0..passes).flat_map(|_| STEPS) {
        let before = std::mem::take(positions);
        *positions = (0..before.len())
            .into_par_iter()
            .map(|v| moved(&before[v], &begin[v], neighbours.of(v), &before, step))
            .collect();
    }
}
