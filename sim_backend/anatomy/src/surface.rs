//! Surfaces between groups of voxels.
//!
//! From a [`Padded`](crate::volume::Padded) volume to triangles with a group on either side:
//! [`nets`] or [`cubes`] find the faces, [`complex`] holds them in the world. Neither smooths nor
//! decimates. Vertices begin at corners of voxels (nets) or half-way between two centres (cubes).

pub mod complex;
pub mod cubes;
pub mod nets;

#[cfg(test)]
mod tests;

/// How surfaces are made.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// Surface nets of all groups at once: neighbours share vertices, without gap or overlap.
    Nets,
    /// Marching cubes of each group alone. Neighbours' surfaces agree before they are smoothed
    /// where two groups meet, and leave gaps of up to half a voxel where three do.
    MarchingCubes,
}
