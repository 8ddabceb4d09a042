//! Repairs of a segmentation: islands and holes, and voxels that touch at an edge or a corner only.
//!
//! The order is fixed: [`remove_islands`] first, since its counts decide the volumes that meshes
//! shall have, then [`separate_touching`], which moves a few voxels for the surfaces' sake alone.
//! Both work on the groups of the padded volume, not on labels.

mod components;
mod touching;

#[cfg(test)]
mod tests;

pub use components::remove_islands;
pub use touching::separate_touching;

/// What was changed in a volume.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Cleaned {
    /// Pieces of groups that went to their neighbours.
    pub islands: u64,
    /// Their voxels.
    pub island_voxels: u64,
    /// Voids that were filled.
    pub holes: u64,
    /// Their voxels.
    pub hole_voxels: u64,
    /// Voxels that went to a neighbour so that no surface touches itself.
    pub touching_voxels: u64,
}
