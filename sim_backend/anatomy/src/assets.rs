//! A patient as files that other programs open: glTF (`.glb`) and OpenUSD (`.usda`, `.usdz`).
//!
//! Coordinates are the scan's world, right-anterior-superior, in metres. OpenUSD has z upwards, as
//! the scan; glTF's y upwards and z forward come from a rotation at the root, and its meshes keep
//! the scan's coordinates.

mod foreign;
mod glb;
mod gltf;
mod part;
mod read;
mod tetra;
mod usda;
mod usdz;

#[cfg(test)]
mod tests;

use crate::groups::Group;
use crate::mesh::GroupMesh;
use crate::number::single;

pub use glb::glb;
pub use gltf::Numbers;
pub use part::Part;
pub use read::{PatientError, file_of, read};
pub use tetra::tetrahedra_usda;
pub use usda::{level_file, levels_usda, texture_file, usda};
pub use usdz::usdz;

/// The patient's glTF file in its folder.
pub const GLB_FILE: &str = "patient.glb";

/// The frame and unit of all assets, as files say it.
pub const FRAME: &str = "RAS of the scan, m";

/// A group's mesh and what it is made of.
#[derive(Clone, Copy, Debug)]
pub struct Asset<'a> {
    /// Its name, material and density.
    pub group: &'a Group,
    /// Its mesh.
    pub mesh: &'a GroupMesh,
    /// Its base-colour texture, a PNG, if it has one.
    pub texture: Option<&'a [u8]>,
}

impl Asset<'_> {
    /// Its mass by its mesh's volume, kg.
    #[must_use]
    pub fn mass_kg(&self) -> f64 {
        self.group.density_kg_m3 * self.mesh.volume_mm3() * 1e-9
    }

    /// Places of vertices, m.
    fn metres(&self) -> impl Iterator<Item = [f32; 3]> + '_ {
        self.mesh
            .positions
            .iter()
            .map(|p| [p.x, p.y, p.z].map(|x| single(x * 1e-3)))
    }
}

/// The least and the greatest of each coordinate.
fn extent(positions: impl Iterator<Item = [f32; 3]>) -> [[f32; 3]; 2] {
    let none = [[f32::INFINITY; 3], [f32::NEG_INFINITY; 3]];
    positions.fold(none, |[low, high], p| {
        [
            [0, 1, 2].map(|k| low[k].min(p[k])),
            [0, 1, 2].map(|k| high[k].max(p[k])),
        ]
    })
}
