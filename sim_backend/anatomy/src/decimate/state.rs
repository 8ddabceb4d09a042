//! Triangles while edges collapse.
//!
//! Arrays by vertex, triangle and sample rather than linked half-edges: a non-manifold complex has
//! edges with three triangles and more, which half-edges do not hold. Nothing is removed while
//! edges collapse; what is gone is marked, and renumbered at the end.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use nalgebra::{Point3, Vector3};

use super::Sampled;
use super::cells::Cells;
use super::quadric::Quadric;
use crate::number::index;

/// No sample.
pub(super) const NONE: u32 = u32::MAX;

/// What holds a vertex.
#[derive(Clone, Copy, PartialEq, Eq, Debug)]
pub(super) enum Kind {
    /// Two groups meet; free to go anywhere.
    Sheet,
    /// On a line where three meet, or more along the line: exactly two edges at it have more than
    /// two groups. It goes along that line only.
    Line,
    /// Lines end or meet here, or a part's rim; it never moves.
    Fixed,
}

/// An edge that may collapse: cost as bits, which order like the number; vertices; their versions.
///
/// A candidate whose versions are not the vertices' own is stale and skipped, so that none has to
/// be looked up in the heap. Equal costs are ordered by vertices, so the result is deterministic.
type Candidate = Reverse<(u64, u32, u32, u32, u32)>;

/// Triangles with what a collapse needs to know of their vertices.
pub(super) struct State {
    /// By vertex, mm. Of vertices that are gone the last place is left.
    pub(super) positions: Vec<Point3<f64>>,
    /// By triangle; entries of those that vanished keep their old corners.
    pub(super) triangles: Vec<[u32; 3]>,
    /// By triangle: the groups behind and before it, as in `Complex`.
    pub(super) sides: Vec<[u8; 2]>,
    /// By triangle: whether it has not vanished.
    pub(super) alive: Vec<bool>,
    /// Triangles around each vertex, all alive; empty once the vertex is gone.
    pub(super) around: Vec<Vec<u32>>,
    /// By vertex, decided once: a collapse leaves the kind of the vertex that stays.
    pub(super) kinds: Vec<Kind>,
    /// Groups around each vertex, a bit a group.
    pub(super) groups: Vec<u32>,
    /// By vertex: the planes of the triangles, at the beginning of this pass, around all vertices
    /// that have collapsed into it, and those of `hold_line`.
    pub(super) quadrics: Vec<Quadric>,
    /// See `Sampled`.
    pub(super) samples: Vec<Point3<f64>>,
    /// The first sample of each triangle; `NONE` if it has none.
    pub(super) first: Vec<u32>,
    /// The sample after each one in the list of its triangle; `NONE` at the end.
    pub(super) next: Vec<u32>,
    /// Where triangles are, for the search for those that a collapse might cross.
    pub(super) cells: Cells,
    /// Whether groups have surfaces of their own, which may cross those of others.
    pub(super) apart: bool,
    /// Counts changes around each vertex.
    versions: Vec<u32>,
    /// The cheapest first.
    heap: BinaryHeap<Candidate>,
    /// See `Sampled`.
    locked: Vec<bool>,
    /// See `Sampled`.
    whole: Vec<u32>,
}

/// A normal and twice the area of a triangle; no normal without area.
pub(super) fn normal([a, b, c]: &[Point3<f64>; 3]) -> (Vector3<f64>, f64) {
    let cross = (b - a).cross(&(c - a));
    let norm = cross.norm();
    if norm > 0.0 {
        (cross / norm, norm)
    } else {
        (Vector3::zeros(), 0.0)
    }
}

impl State {
    /// Linear in triangles and samples; the heap is still empty.
    pub(super) fn new(part: Sampled) -> Self {
        let count = part.complex.positions.len();
        let apart = part.complex.is_apart();
        let triangles = part.complex.triangles;
        let mut state = Self {
            alive: vec![true; triangles.len()],
            around: vec![Vec::new(); count],
            kinds: vec![Kind::Sheet; count],
            groups: vec![0; count],
            quadrics: vec![Quadric::zero(); count],
            first: vec![NONE; triangles.len()],
            next: vec![NONE; part.samples.len()],
            apart,
            cells: Cells::new(&part.complex.positions, &triangles),
            versions: vec![0; count],
            heap: BinaryHeap::new(),
            positions: part.complex.positions,
            triangles,
            sides: part.complex.sides,
            samples: part.samples,
            locked: part.locked,
            whole: part.whole,
        };
        for (sample, triangle) in part.sampled.iter().enumerate() {
            state.next[sample] = state.first[*triangle as usize];
            state.first[*triangle as usize] = index(sample);
        }
        state.look_around();
        state
    }

    pub(super) fn corners(&self, triangle: u32) -> [Point3<f64>; 3] {
        self.triangles[triangle as usize].map(|v| self.positions[v as usize])
    }

    /// Groups on both sides of a triangle, a bit a group.
    pub(super) fn side_bits(&self, triangle: u32) -> u32 {
        let [a, b] = self.sides[triangle as usize];
        1 << a | 1 << b
    }

    /// Neighbours of `v` with the groups around the edge to each.
    ///
    /// Each neighbour once, in order of its number. Allocates.
    fn edges(&self, v: u32) -> Vec<(u32, u32)> {
        let mut edges: Vec<(u32, u32)> = Vec::with_capacity(2 * self.around[v as usize].len());
        for &triangle in &self.around[v as usize] {
            let others = self.triangles[triangle as usize]
                .into_iter()
                .filter(|other| *other != v);
            edges.extend(others.map(|other| (other, self.side_bits(triangle))));
        }
        edges.sort_unstable();
        edges.dedup_by(|later, kept| {
            let same = later.0 == kept.0;
            if same {
                kept.1 |= later.1;
            }
            same
        });
        edges
    }

    /// Fills what is known of vertices.
    fn look_around(&mut self) {
        for triangle in 0..index(self.triangles.len()) {
            let corners = self.corners(triangle);
            let (n, area) = normal(&corners);
            let plane = Quadric::plane(&corners[0], &n, area);
            for v in self.triangles[triangle as usize].map(|v| v as usize) {
                self.around[v].push(triangle);
                self.groups[v] |= self.side_bits(triangle);
                self.quadrics[v].add(&plane);
            }
        }
        for v in 0..index(self.positions.len()) {
            let edges = self.edges(v);
            let lines: Vec<u32> = edges
                .iter()
                .filter(|(_, bits)| bits.count_ones() > 2)
                .map(|(w, _)| *w)
                .collect();
            self.kinds[v as usize] = match lines.len() {
                _ if self.locked[v as usize] => Kind::Fixed,
                0 => Kind::Sheet,
                2 => Kind::Line,
                _ => Kind::Fixed,
            };
            for w in lines {
                self.hold_line(v, w);
            }
        }
    }

    /// Planes through the line from `v` to `w`, upright on the triangles at it, hold `v` on it.
    ///
    /// Garland and Heckbert's constraint planes for boundaries, with the squared length as weight
    /// so that they count like triangles as wide as the edge.
    fn hold_line(&mut self, v: u32, w: u32) {
        let (p, along) = (
            self.positions[v as usize],
            self.positions[w as usize] - self.positions[v as usize],
        );
        let at_edge = |t: &&u32| self.triangles[**t as usize].contains(&w);
        let triangles: Vec<u32> = self.around[v as usize]
            .iter()
            .filter(at_edge)
            .copied()
            .collect();
        for triangle in triangles {
            let (n, _) = normal(&self.corners(triangle));
            if let Some(upright) = along.cross(&n).try_normalize(1e-12) {
                let plane = Quadric::plane(&p, &upright, along.norm_squared());
                self.quadrics[v as usize].add(&plane);
            }
        }
    }

    /// Whether `v` is at the rim of a part, so that not all its triangles are here.
    pub(super) fn is_locked(&self, v: u32) -> bool {
        self.locked[v as usize]
    }

    /// Offers the edge from `u` to `v`, if it may collapse.
    ///
    /// The place is not kept: it is computed again when the edge's turn comes, from the same
    /// numbers.
    fn offer(&mut self, u: u32, v: u32, bits: u32) {
        let (u, v) = (u.min(v), u.max(v));
        let Some(place) = self.place(u, v, bits) else {
            return;
        };
        let mut sum = self.quadrics[u as usize];
        sum.add(&self.quadrics[v as usize]);
        let length = (self.positions[u as usize] - self.positions[v as usize]).norm_squared();
        // Of edges that cost the same, short ones first: triangles stay of a shape.
        let cost = sum.at(&place) + 1e-4 * length * sum.weight();
        let versions = [u, v].map(|v| self.versions[v as usize]);
        self.heap
            .push(Reverse((cost.to_bits(), u, v, versions[0], versions[1])));
    }

    /// Collapses edges, cheapest first, until each that is left would break a rule.
    ///
    /// O(n log n) in edges. An edge that is refused is not tried again until a vertex of it has
    /// moved.
    pub(super) fn run(mut self, error_mm: f64) -> Sampled {
        for v in 0..index(self.positions.len()) {
            for (w, bits) in self.edges(v) {
                if v < w {
                    self.offer(v, w, bits);
                }
            }
        }
        while let Some(Reverse((_, u, v, old_u, old_v))) = self.heap.pop() {
            let fresh = self.versions[u as usize] == old_u && self.versions[v as usize] == old_v;
            if !fresh || self.around[u as usize].is_empty() || self.around[v as usize].is_empty() {
                continue;
            }
            if let Some(kept) = self.collapse(u, v, error_mm) {
                self.versions[u as usize] += 1;
                self.versions[v as usize] += 1;
                for (w, bits) in self.edges(kept) {
                    self.offer(kept, w, bits);
                }
            }
        }
        self.finish()
    }

    /// What is left, renumbered.
    fn finish(self) -> Sampled {
        let mut result = Sampled::default();
        let mut places = vec![NONE; self.positions.len()];
        let used = (0..self.positions.len()).filter(|v| !self.around[*v].is_empty());
        for v in used {
            places[v] = index(result.complex.positions.len());
            result.complex.positions.push(self.positions[v]);
            result.locked.push(self.locked[v]);
            result.whole.push(self.whole[v]);
        }
        for triangle in (0..self.triangles.len()).filter(|t| self.alive[*t]) {
            let mut sample = self.first[triangle];
            while sample != NONE {
                result.samples.push(self.samples[sample as usize]);
                result.sampled.push(index(result.complex.triangles.len()));
                sample = self.next[sample as usize];
            }
            result
                .complex
                .triangles
                .push(self.triangles[triangle].map(|v| places[v as usize]));
            result.complex.sides.push(self.sides[triangle]);
        }
        result
    }
}
