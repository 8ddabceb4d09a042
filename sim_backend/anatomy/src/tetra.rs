//! Tetrahedra that fill a group's mesh, for finite elements: a body-centred cubic lattice, clipped
//! to the mesh.
//!
//! Of the lattice's tetrahedra those stay whose middles lie in the mesh. Vertices at the boundary
//! go to the surface as far as no tetrahedron becomes flat, and then a little along their normals,
//! until the volume is the mesh's.
//!
//! The lattice is the one of isosurface stuffing (F. Labelle and J. Shewchuk, 2007), but its
//! tetrahedra are moved whole to the surface and not cut at it: all keep four corners of the
//! lattice, and there is no bound on dihedral angles, only the one on volumes (`FLAT`).

mod lattice;

use nalgebra::{Point3, Vector3};

use crate::measure::nearest::Nearest;
use crate::mesh::GroupMesh;
use crate::number::real;

/// Least volume of a tetrahedron of the result to one of the lattice. It keeps every Jacobian of a
/// finite-element code positive.
const FLAT: f64 = 0.05;

/// Times that the whole way to the surface is tried again, by halves.
const HALVES: u32 = 5;

/// Times that the volume is corrected.
const ROUNDS: u32 = 40;

/// Most that the volume may differ from the mesh's.
const VOLUME: f64 = 0.002;

/// How often the lattice may be made finer where tissue is thinner than it.
const FINER_MAX: u32 = 3;

/// Most of the mesh's volume that the lattice's tetrahedra may lack or have too much before they
/// are moved.
const ROUGH: f64 = 0.15;

/// Most that the mesh's vertices may be from the surface in the mean, in sides of a cell.
///
/// Volumes alone could agree by chance, with a thin part left out and another too thick.
const NEAR: f64 = 0.2;

/// Most tetrahedra of a group.
pub const TETRAHEDRA_MAX: usize = 4_000_000;

/// A group's inside as tetrahedra, in the scan's world (RAS), mm.
#[derive(Clone, Debug, Default)]
pub struct Tetrahedra {
    /// The group's index in [`crate::groups::Groups::groups`].
    pub group: usize,
    /// Side of the lattice's cells, mm: the one that was asked for, or a half, a quarter or an
    /// eighth of it.
    pub side_mm: f64,
    /// Places of vertices, mm.
    pub positions: Vec<Point3<f64>>,
    /// Corners of tetrahedra. The first three run counter-clockwise seen from the fourth, so that
    /// volumes are positive.
    pub corners: Vec<[u32; 4]>,
    /// Faces that have one tetrahedron, counter-clockwise from outside; indices into `positions`.
    /// Where the lattice touches itself at an edge or a corner they are no manifold.
    pub surface: Vec<[u32; 3]>,
}

/// Six times the volume of a tetrahedron.
fn sixfold(positions: &[Point3<f64>], corners: &[u32; 4]) -> f64 {
    let [a, b, c, d] = corners.map(|v| positions[v as usize]);
    (b - a).cross(&(c - a)).dot(&(d - a))
}

impl Tetrahedra {
    /// Fills `mesh` by a lattice whose cells have sides of `side_mm`, or of a half, a quarter or an
    /// eighth where it is too thin for them.
    ///
    /// A finer lattice is tried where the coarse one is off by more than 15 % before anything is
    /// moved, or volume or surface are not met after it; each halving makes eight times as many
    /// tetrahedra. The mesh must be closed and in mm. Deterministic; the caller fills groups in
    /// parallel.
    ///
    /// # Errors
    /// Why the group has none: it would be more than [`TETRAHEDRA_MAX`], or its volume is not met
    /// within 1 %, nor its surface.
    pub fn fill(mesh: &GroupMesh, side_mm: f64) -> Result<Self, String> {
        let wanted = mesh.volume_mm3();
        let mut side = side_mm;
        for finer in 0..=FINER_MAX {
            let mut filled = lattice::inside(mesh, side)?;
            let rough = (filled.volume_mm3() / wanted - 1.0).abs();
            if rough <= ROUGH || finer == FINER_MAX {
                filled.fit(mesh, wanted);
                let off = (filled.volume_mm3() / wanted - 1.0).abs();
                if off <= 0.01 && filled.distance_mm(mesh) <= NEAR * side {
                    return Ok(filled);
                }
            }
            side *= 0.5;
        }
        Err(format!(
            "it is too thin for cells of {:.2} mm",
            side_mm * 0.5_f64.powi(FINER_MAX.cast_signed())
        ))
    }

    /// The volume inside, mm³.
    #[must_use]
    pub fn volume_mm3(&self) -> f64 {
        let all = self.corners.iter().map(|t| sixfold(&self.positions, t));
        all.sum::<f64>() / 6.0
    }

    /// The mean distance of the vertices of `mesh` from the surface, mm.
    #[must_use]
    pub fn distance_mm(&self, mesh: &GroupMesh) -> f64 {
        let nearest = Nearest::new(&self.positions, &self.surface);
        let all = mesh.positions.iter().map(|p| nearest.distance(p));
        all.sum::<f64>() / real(mesh.positions.len().max(1))
    }

    /// The least volume of a tetrahedron to one of the lattice; positive where none is turned
    /// inside out.
    #[must_use]
    pub fn least_share(&self) -> f64 {
        let all = self.corners.iter().map(|t| sixfold(&self.positions, t));
        all.fold(f64::INFINITY, f64::min) / self.regular()
    }

    /// Six times the volume of the lattice's tetrahedra, of which a cell has twelve.
    const fn regular(&self) -> f64 {
        self.side_mm * self.side_mm * self.side_mm / 2.0
    }

    /// Moves the boundary to the surface of `mesh`, and until the volume is `wanted`.
    ///
    /// First each vertex of the boundary goes to the nearest point of the mesh, then all of them
    /// along their normals by the lacking volume over the area, a tenth of a cell at most a round.
    /// Inner vertices stay.
    fn fit(&mut self, mesh: &GroupMesh, wanted: f64) {
        let around = self.around();
        let nearest = Nearest::new(&mesh.positions, &mesh.triangles);
        for v in self.boundary() {
            let to = nearest.point(&self.positions[v as usize]);
            self.go(v, &to, &around[v as usize]);
        }
        for _ in 0..ROUNDS {
            let lacking = wanted - self.volume_mm3();
            if lacking.abs() <= VOLUME * wanted {
                break;
            }
            let normals = self.area_normals();
            let area: f64 = normals.iter().map(|(_, normal)| normal.norm()).sum();
            for (v, normal) in normals {
                let by = normal.normalize()
                    * (lacking / area).clamp(-0.1 * self.side_mm, 0.1 * self.side_mm);
                let to = self.positions[v as usize] + by;
                self.go(v, &to, &around[v as usize]);
            }
        }
    }

    /// Moves a vertex towards `to`, as far as no tetrahedron of `around` becomes flat.
    ///
    /// Halves the way five times at most, and then leaves the vertex where it was.
    fn go(&mut self, v: u32, to: &Point3<f64>, around: &[u32]) {
        let from = self.positions[v as usize];
        let least = FLAT * self.regular();
        for half in 0..HALVES {
            self.positions[v as usize] = from + (to - from) * 0.5_f64.powi(half.cast_signed());
            let flat = |t: &u32| sixfold(&self.positions, &self.corners[*t as usize]) < least;
            if !around.iter().any(flat) {
                return;
            }
        }
        self.positions[v as usize] = from;
    }

    /// Tetrahedra around each vertex.
    fn around(&self) -> Vec<Vec<u32>> {
        let mut around = vec![Vec::new(); self.positions.len()];
        for (t, corners) in (0..).zip(&self.corners) {
            for v in corners {
                around[*v as usize].push(t);
            }
        }
        around
    }

    /// Vertices of the surface, each once.
    fn boundary(&self) -> Vec<u32> {
        let mut vertices = self.surface.as_flattened().to_vec();
        vertices.sort_unstable();
        vertices.dedup();
        vertices
    }

    /// A third of the area of the faces around each vertex of the surface, outwards, mm².
    ///
    /// Vertices whose faces cancel have no direction and are left out.
    fn area_normals(&self) -> Vec<(u32, Vector3<f64>)> {
        let mut sums = vec![Vector3::zeros(); self.positions.len()];
        for face in &self.surface {
            let [a, b, c] = face.map(|v| self.positions[v as usize]);
            let third = (b - a).cross(&(c - a)) / 6.0;
            for v in face {
                sums[*v as usize] += third;
            }
        }
        let boundary = self.boundary().into_iter();
        let found = boundary.map(|v| (v, sums[v as usize]));
        found.filter(|(_, sum)| sum.norm() > 0.0).collect()
    }

    /// Mean edges of a tetrahedron to each side of a cell, for tests of the form.
    #[cfg(test)]
    fn mean_edge(&self) -> f64 {
        let edge =
            |t: &[u32; 4]| (self.positions[t[1] as usize] - self.positions[t[0] as usize]).norm();
        self.corners.iter().map(edge).sum::<f64>() / real(self.corners.len())
    }
}

#[cfg(test)]
mod tests;
