//! Triangle meshes: what physics makes of its shapes and the renderer draws.

use nalgebra::{Point3, Vector3};

use crate::count::count_u32;

/// A triangle mesh in its own frame, metres; triangles that are counter-clockwise from where one
/// looks face there, which is outwards for solids.
#[derive(Clone, Debug, Default)]
pub struct Mesh {
    /// Vertex positions, m.
    pub positions: Vec<[f32; 3]>,
    /// Unit vertex normals, as many as there are positions.
    pub normals: Vec<[f32; 3]>,
    /// Three indices a triangle.
    pub indices: Vec<u32>,
}

impl Mesh {
    /// Adds a vertex at `position` (m) whose normal has the direction of `normal`, +z if that has
    /// no length; its index.
    pub fn vertex(&mut self, position: Point3<f64>, normal: Vector3<f64>) -> u32 {
        let index = count_u32(self.positions.len());
        let normal = normal.try_normalize(1e-12).unwrap_or_else(Vector3::z);
        self.positions.push(single(&position.coords));
        self.normals.push(single(&normal));
        index
    }

    /// Adds a triangle, counter-clockwise from outside.
    pub fn triangle(&mut self, corners: [u32; 3]) {
        self.indices.extend(corners);
    }

    /// A flat quad, counter-clockwise from outside; corners may coincide.
    fn face(&mut self, corners: [Point3<f64>; 4]) {
        let [a, b, c, d] = corners;
        let normal = (c - a).cross(&(d - b));
        let [a, b, c, d] = corners.map(|corner| self.vertex(corner, normal));
        self.triangle([a, b, c]);
        self.triangle([a, c, d]);
    }

    /// A convex solid between two quads, both counter-clockwise seen from above (from +z), m.
    #[must_use]
    pub fn hexahedron([below, above]: [[Point3<f64>; 4]; 2]) -> Self {
        let mut mesh = Self::default();
        mesh.face([below[3], below[2], below[1], below[0]]);
        mesh.face(above);
        for (i, j) in [(0, 1), (1, 2), (2, 3), (3, 0)] {
            mesh.face([below[i], below[j], above[j], above[i]]);
        }
        mesh.without_slivers()
    }

    /// One mesh out of several in the same frame.
    #[must_use]
    pub fn merged(meshes: impl IntoIterator<Item = Self>) -> Self {
        let mut whole = Self::default();
        for mesh in meshes {
            let first = count_u32(whole.positions.len());
            whole.positions.extend(mesh.positions);
            whole.normals.extend(mesh.normals);
            whole
                .indices
                .extend(mesh.indices.into_iter().map(|index| first + index));
        }
        whole
    }

    /// The same without triangles that have no area, as they arise at poles. The vertices stay.
    #[must_use]
    pub fn without_slivers(mut self) -> Self {
        let at = |index: u32| Vector3::from(self.positions[index as usize].map(f64::from));
        let area = |t: &[u32]| {
            let [a, b, c] = [t[0], t[1], t[2]].map(at);
            (b - a).cross(&(c - a)).norm()
        };
        self.indices = self
            .indices
            .chunks_exact(3)
            .filter(|t| area(t) > 1e-14)
            .flatten()
            .copied()
            .collect();
        self
    }
}

/// A vector in the single precision that meshes have.
#[inline]
#[must_use]
#[expect(
    clippy::cast_possible_truncation,
    reason = "meshes are drawn in single precision"
)]
pub const fn single(v: &Vector3<f64>) -> [f32; 3] {
    let [[x, y, z]] = v.data.0;
    [x as f32, y as f32, z as f32]
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A wedge over the unit square: its upper quad is an edge.
    fn wedge() -> Mesh {
        let quad = |z: f64, width: f64| {
            [(0.0, 0.0), (1.0, 0.0), (1.0, width), (0.0, width)].map(|(x, y)| Point3::new(x, y, z))
        };
        Mesh::hexahedron([quad(0.0, 1.0), quad(1.0, 0.0)])
    }

    /// Volume enclosed by the triangles, m³: positive when they face outwards.
    fn volume_m3(mesh: &Mesh) -> f64 {
        let at = |index: u32| Vector3::from(mesh.positions[index as usize].map(f64::from));
        let signed = |t: &[u32]| at(t[0]).dot(&at(t[1]).cross(&at(t[2]))) / 6.0;
        mesh.indices.chunks_exact(3).map(signed).sum()
    }

    #[test]
    fn a_solid_faces_outwards_and_has_no_slivers() {
        let mesh = wedge();
        assert_eq!(mesh.positions.len(), 24);
        // Of twelve triangles the upper quad's two and one each of the two ends have no area.
        assert_eq!(mesh.indices.len(), 3 * 8);
        assert!((volume_m3(&mesh) - 0.5).abs() < 1e-6);
        for normal in &mesh.normals {
            assert!((Vector3::from(*normal).norm() - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn what_is_merged_keeps_its_triangles() {
        let both = Mesh::merged([wedge(), Mesh::default(), wedge()]);
        assert_eq!(both.positions.len(), 48);
        assert_eq!(both.indices[24] as usize, 24 + wedge().indices[0] as usize);
        assert!((volume_m3(&both) - 1.0).abs() < 1e-6);
    }
}
