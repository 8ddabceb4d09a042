//! A tissue group of a patient that was read, and what its mesh must be like.
//!
//! Every reader ends here, ours and those of other programs' files: what the renderer and physics
//! may rely on is what `fault` checks. Closedness is not checked; patients of other programs are
//! often open.

use hal::Mesh;
use nalgebra::Vector3;

/// Most groups of a patient.
///
/// Our own patients have at most 31; it bounds what another program's file may ask for.
pub(super) const PARTS_MAX: usize = 64;

/// How far from the scan's origin a vertex may be, m.
///
/// It is there for wrong units: a file in mm that says metres is refused.
const FAR_M: f32 = 10.0;

/// A tissue group as it lies in the file.
#[derive(Clone, Debug)]
pub struct Part {
    /// Its name.
    pub name: String,
    /// Its surface in the scan's world (RAS), m; vertices are split where texture coordinates have
    /// seams.
    pub mesh: Mesh,
    /// Base colour, linear RGB in [0, 1].
    pub colour: [f32; 3],
    /// Roughness of the surface in [0, 1].
    pub roughness: f32,
    /// Strength of the clear film on it in [0, 1].
    pub wetness: f32,
}

/// What is wrong with a mesh.
///
/// The first of: no triangles or a part of one, lists of different lengths, a vertex that is not
/// finite or far away, a normal that is not of length 1 (1 % is allowed), an index past the end.
pub(super) fn fault(mesh: &Mesh) -> Option<&'static str> {
    let near = |p: &[f32; 3]| p.iter().all(|x| x.abs() <= FAR_M);
    let unit = |n: &[f32; 3]| (Vector3::from(*n).norm() - 1.0).abs() <= 0.01;
    let there = |index: &u32| (*index as usize) < mesh.positions.len();
    if mesh.indices.is_empty() || !mesh.indices.len().is_multiple_of(3) {
        Some("it has no whole number of triangles")
    } else if mesh.positions.len() != mesh.normals.len() {
        Some("it has more or fewer normals than vertices")
    } else if !mesh.positions.iter().all(near) {
        Some("a vertex is not finite or further than 10 m away")
    } else if !mesh.normals.iter().all(unit) {
        Some("a normal has not the length 1")
    } else if !mesh.indices.iter().all(there) {
        Some("a triangle has a corner that is not there")
    } else {
        None
    }
}
