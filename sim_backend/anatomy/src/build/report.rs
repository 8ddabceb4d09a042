//! What was made, by which stages, and what can go wrong.

use std::io;
use std::path::PathBuf;

use serde::Serialize;

use super::Options;
use crate::clean::Cleaned;
use crate::measure::Measures;
use crate::mesh::GroupMesh;
use crate::nifti::NiftiError;
use crate::tetra::Tetrahedra;

/// What the pipeline does, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Stage {
    /// The volume is read, and labels become groups.
    Read,
    /// Islands, holes, touching voxels.
    Repair,
    /// Faces between groups.
    Surface,
    /// Smoothing, and volumes put right.
    Smooth,
    /// Decimation, and volumes put right.
    Decimate,
    /// A mesh a group, texture coordinates, normals.
    Meshes,
    /// Distances, volumes, overlap with the voxels.
    Measure,
    /// glTF and OpenUSD.
    Write,
}

impl Stage {
    /// All stages.
    pub const ALL: [Self; 8] = [
        Self::Read,
        Self::Repair,
        Self::Surface,
        Self::Smooth,
        Self::Decimate,
        Self::Meshes,
        Self::Measure,
        Self::Write,
    ];

    /// Its name.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Read => "read",
            Self::Repair => "repair",
            Self::Surface => "surface",
            Self::Smooth => "smooth",
            Self::Decimate => "decimate",
            Self::Meshes => "meshes",
            Self::Measure => "measure",
            Self::Write => "write",
        }
    }
}

/// A group of the result.
#[derive(Clone, Debug, Serialize)]
pub struct GroupReport {
    /// Its name.
    pub name: String,
    /// Its voxels in the file.
    pub voxels_read: u64,
    /// Its voxels after repairs.
    pub voxels: u64,
    /// Vertices of its mesh.
    pub vertices: usize,
    /// Triangles of its mesh.
    pub triangles: usize,
    /// Its mass, kg.
    pub mass_kg: f64,
    /// Share of the texture square that its charts cover.
    pub atlas_used: f64,
    /// How well its mesh stands for its voxels.
    #[serde(flatten)]
    pub measures: Measures,
}

/// How far the surface of a group is from the faces of its voxels after a stage.
#[derive(Clone, Debug, Serialize)]
pub struct StageDistance {
    /// [`Stage::Surface`], [`Stage::Smooth`] or [`Stage::Decimate`].
    pub stage: Stage,
    /// The group's name.
    pub group: String,
    /// Triangles of its mesh.
    pub triangles: usize,
    /// The largest distance in either direction, voxels.
    pub hausdorff_voxels: f64,
    /// The mean of the distances in both directions, voxels.
    pub mean_voxels: f64,
    /// Of label and re-voxelised mesh.
    pub dice: f64,
}

/// A coarser level of detail.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct LevelReport {
    /// How far its meshes may be from the smooth surface, mm.
    pub max_error_mm: f64,
    /// Triangles of all groups' surfaces, shared ones once.
    pub triangles: usize,
}

/// A group's tetrahedra, or why it has none.
#[derive(Clone, Debug, Serialize)]
pub struct TetrahedraReport {
    /// The group's name.
    pub group: String,
    /// Side of the lattice's cells, mm.
    pub side_mm: f64,
    /// How many there are.
    pub tetrahedra: usize,
    /// Their volume over the mesh's.
    pub volume_ratio: f64,
    /// The mean distance of the mesh's vertices from their surface, mm.
    pub distance_mm: f64,
    /// The least volume of one to one of the lattice.
    pub least_share: f64,
    /// Why there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub none_since: Option<String>,
}

impl TetrahedraReport {
    pub(super) fn of(group: String, filled: &Tetrahedra, mesh: &GroupMesh) -> Self {
        Self {
            group,
            side_mm: filled.side_mm,
            tetrahedra: filled.corners.len(),
            volume_ratio: filled.volume_mm3() / mesh.volume_mm3(),
            distance_mm: filled.distance_mm(mesh),
            least_share: filled.least_share(),
            none_since: None,
        }
    }

    pub(super) fn none(group: String, reason: &str) -> Self {
        Self {
            group,
            side_mm: 0.0,
            tetrahedra: 0,
            volume_ratio: 0.0,
            distance_mm: 0.0,
            least_share: 0.0,
            none_since: Some(reason.to_owned()),
        }
    }
}

/// What was made, and how well.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The volume's file.
    pub source: PathBuf,
    /// The table of labels.
    pub table: String,
    /// Voxels along the axes of the file.
    pub size: [usize; 3],
    /// Voxel size, mm.
    pub spacing_mm: [f64; 3],
    /// Where the file's axes lead.
    pub orientation: String,
    /// The frame and unit of the assets.
    pub frame: &'static str,
    /// How it was made.
    pub options: Options,
    /// What was repaired.
    pub repaired: Cleaned,
    /// Triangles between groups before decimation.
    pub triangles_fine: usize,
    /// And after it; one between two groups counts once.
    pub triangles: usize,
    /// The groups that are there.
    pub groups: Vec<GroupReport>,
    /// Distances by stage and group, if they were asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub stage_distances: Vec<StageDistance>,
    /// Tetrahedra by group, if they were asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub tetrahedra: Vec<TetrahedraReport>,
    /// Coarser levels of detail, if they were asked for.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub levels: Vec<LevelReport>,
}

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
pub enum BuildError {
    /// The volume is refused.
    #[error(transparent)]
    Volume(#[from] NiftiError),
    /// The volume has background only.
    #[error("{path}: no voxel belongs to a group of {table}")]
    Empty {
        /// The volume.
        path: PathBuf,
        /// The table of labels.
        table: String,
    },
    /// An asset can't be written.
    #[error("{path}: cannot be written")]
    Unwritable {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        #[source]
        source: io::Error,
    },
}

impl BuildError {
    /// Whether the volume is at fault, rather than the work itself.
    #[must_use]
    pub const fn is_bad_input(&self) -> bool {
        match self {
            Self::Volume(error) => !matches!(error, NiftiError::Unwritable { .. }),
            Self::Empty { .. } => true,
            Self::Unwritable { .. } => false,
        }
    }
}
