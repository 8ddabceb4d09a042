//! The mesh of one group.
//!
//! A [`GroupMesh`] is what assets, textures, distances and tetrahedra are made of. It is cut out of
//! the common [`Complex`] after all surfaces have settled; from then on vertices don't move. Two
//! groups that touch have the same triangles at the common surface, wound the other way in the
//! other mesh.

use nalgebra::{Point3, Vector3};

use crate::number::{index, single};
use crate::surface::complex::Complex;

/// A group's closed surface in the scan's world (RAS), mm.
///
/// Positions are in double precision here and in single precision, metres, in assets. Closed (every
/// edge has two triangles) if the complex was; a group with several pieces is one mesh.
#[derive(Clone, Debug, Default)]
pub struct GroupMesh {
    /// The group's index in [`crate::groups::Groups::groups`].
    pub group: usize,
    /// Places of vertices, mm, in the order in which triangles first name them; each is a corner of
    /// some triangle.
    pub positions: Vec<Point3<f64>>,
    /// Corners, counter-clockwise from outside; indices into `positions`.
    pub triangles: Vec<[u32; 3]>,
    /// Unit normals of vertices, outwards, as many as `positions`.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates of each triangle's corners in the unit square, v upwards. They belong to
    /// corners, not vertices, since a vertex on a seam has several. Empty until
    /// [`crate::atlas::unwrap`], then as many as `triangles`.
    pub uv: Vec<[[f32; 2]; 3]>,
}

impl GroupMesh {
    /// The surface of the group with the index `group`; empty if it has none.
    ///
    /// O(all triangles and vertices of the complex), so all groups together cost groups times that;
    /// `build` runs them in parallel. `uv` stays empty.
    #[must_use]
    pub fn of(complex: &Complex, group: usize) -> Self {
        let mut places = vec![u32::MAX; complex.positions.len()];
        let mut mesh = Self {
            group,
            ..Self::default()
        };
        for (triangle, sides) in complex.triangles.iter().zip(&complex.sides) {
            let [a, b, c] = *triangle;
            let outwards = match sides.map(|side| usize::from(side) == group + 1) {
                [true, false] => [a, b, c],
                [false, true] => [a, c, b],
                _ => continue,
            };
            mesh.triangles.push(outwards.map(|v| {
                let place = &mut places[v as usize];
                if *place == u32::MAX {
                    *place = index(mesh.positions.len());
                    mesh.positions.push(complex.positions[v as usize]);
                }
                *place
            }));
        }
        mesh.normals = mesh.vertex_normals();
        mesh
    }

    /// Corners of a triangle, mm.
    #[must_use]
    pub fn corners(&self, triangle: usize) -> [Point3<f64>; 3] {
        self.triangles[triangle].map(|v| self.positions[v as usize])
    }

    /// Normals weighted by the angles of triangles at the vertex.
    ///
    /// Weights are by G. Thürmer and C. A. Wüthrich (1998): unlike area weights they do not depend
    /// on how a flat region is cut into triangles. Triangles without area are left out; a vertex of
    /// such triangles only gets +z.
    fn vertex_normals(&self) -> Vec<[f32; 3]> {
        let mut sums = vec![Vector3::zeros(); self.positions.len()];
        for triangle in 0..self.triangles.len() {
            let corners = self.corners(triangle);
            let [a, b, c] = corners;
            let Some(normal) = (b - a).cross(&(c - a)).try_normalize(1e-12) else {
                continue;
            };
            for i in 0..3 {
                let (left, right) = (
                    corners[(i + 1) % 3] - corners[i],
                    corners[(i + 2) % 3] - corners[i],
                );
                sums[self.triangles[triangle][i] as usize] += normal * left.angle(&right);
            }
        }
        sums.into_iter()
            .map(|sum| sum.try_normalize(1e-12).unwrap_or_else(Vector3::z))
            .map(|normal| [normal.x, normal.y, normal.z].map(single))
            .collect()
    }

    /// The volume inside, mm³.
    ///
    /// By the divergence theorem: `sum of a . (b x c) / 6` over triangles, about the first vertex
    /// to keep digits. Positive for a closed mesh wound outwards; without a meaning for an open
    /// one. 0 if it is empty.
    #[must_use]
    pub fn volume_mm3(&self) -> f64 {
        let Some(about) = self.positions.first() else {
            return 0.0;
        };
        let sixth = |t| {
            let [a, b, c] = self.corners(t).map(|p| p - about);
            a.dot(&b.cross(&c)) / 6.0
        };
        (0..self.triangles.len()).map(sixth).sum()
    }

    /// Edges with the triangles at them, sorted: (lower vertex, higher vertex, triangle, whether it
    /// runs from low to high).
    ///
    /// Three entries a triangle, sorted by vertices and then by triangle, so that those at one edge
    /// stand together for `chunk_by`. O(n log n).
    pub(crate) fn edges(&self) -> Vec<(u32, u32, u32, bool)> {
        let mut edges = Vec::with_capacity(3 * self.triangles.len());
        for (t, [a, b, c]) in self.triangles.iter().enumerate() {
            for (from, to) in [(*a, *b), (*b, *c), (*c, *a)] {
                edges.push((from.min(to), from.max(to), index(t), from < to));
            }
        }
        edges.sort_unstable();
        edges
    }

    /// Whether every edge has exactly two triangles, which run along it in opposite directions.
    ///
    /// An empty mesh is not. It says nothing of vertices where two fans touch, or of triangles that
    /// cross; the repairs and the decimation are there to prevent those.
    #[must_use]
    pub fn is_watertight(&self) -> bool {
        let edges = self.edges();
        let closed = |pair: &[(u32, u32, u32, bool)]| pair.len() == 2 && pair[0].3 != pair[1].3;
        !edges.is_empty() && edges.chunk_by(|a, b| (a.0, a.1) == (b.0, b.1)).all(closed)
    }
}
