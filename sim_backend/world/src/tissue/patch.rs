//! The mark as it is drawn: a round patch on the flap's upper face that bends with it.

use core::f64::consts::TAU;

use hal::Mesh;
use hal::count::count_u32;
use hal::mesh::single;
use nalgebra::Vector3;

use super::sheet::count;
use super::surface::Surface;

/// Rings around the middle, and points on each.
const RINGS: usize = 4;
const SPOKES: usize = 24;
/// How far the patch is above the face, m: enough to be in front of it everywhere.
const ABOVE_M: f64 = 0.000_12;

/// A round patch.
#[derive(Clone, Debug)]
pub struct Patch {
    mesh: Mesh,
    radius_m: f64,
}

impl Patch {
    /// The patch of radius `radius_m` about the material point `middle_m` of `surface`.
    #[must_use]
    pub fn new(surface: &Surface, middle_m: [f64; 2], radius_m: f64) -> Self {
        let vertices = 1 + RINGS * SPOKES;
        let mut patch = Self {
            mesh: Mesh {
                positions: vec![[0.0; 3]; vertices],
                normals: vec![[0.0; 3]; vertices],
                indices: indices(),
            },
            radius_m,
        };
        patch.update(surface, middle_m);
        patch
    }

    /// The mesh, scene frame.
    #[must_use]
    pub const fn mesh(&self) -> &Mesh {
        &self.mesh
    }

    /// Follows the surface. Indices and the number of vertices stay.
    pub fn update(&mut self, surface: &Surface, middle_m: [f64; 2]) {
        self.set(0, surface.upper(middle_m));
        for ring in 0..RINGS {
            let out_m = self.radius_m * count(ring + 1) / count(RINGS);
            for spoke in 0..SPOKES {
                let (sin, cos) = (TAU * count(spoke) / count(SPOKES)).sin_cos();
                let at_m = [middle_m[0] + out_m * cos, middle_m[1] + out_m * sin];
                self.set(1 + ring * SPOKES + spoke, surface.upper(at_m));
            }
        }
    }

    fn set(&mut self, vertex: usize, (at, normal): (Vector3<f64>, Vector3<f64>)) {
        self.mesh.positions[vertex] = single(&(at + normal * ABOVE_M));
        self.mesh.normals[vertex] = single(&normal);
    }
}

/// A fan in the middle and quads between the rings.
fn indices() -> Vec<u32> {
    let on = |ring: usize, spoke: usize| 1 + ring * SPOKES + spoke % SPOKES;
    let mut triangles: Vec<usize> = Vec::new();
    for spoke in 0..SPOKES {
        triangles.extend([0, on(0, spoke), on(0, spoke + 1)]);
        for ring in 1..RINGS {
            let (near, far) = (on(ring - 1, spoke), on(ring, spoke));
            let (near_next, far_next) = (on(ring - 1, spoke + 1), on(ring, spoke + 1));
            triangles.extend([near, far, far_next, near, far_next, near_next]);
        }
    }
    triangles.into_iter().map(count_u32).collect()
}
