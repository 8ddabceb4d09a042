//! The pipeline from a label volume to a patient of meshes.

use std::fs;
use std::io;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::Serialize;

use crate::assets::{Asset, FRAME, GLB_FILE, glb, usda};
use crate::atlas::unwrap;
use crate::balance::balance;
use crate::clean::{Cleaned, remove_islands, separate_touching};
use crate::decimate::decimate;
use crate::groups::Groups;
use crate::measure::{Measures, measure};
use crate::mesh::GroupMesh;
use crate::nifti::{LabelVolume, NiftiError, read_labels};
use crate::number::floor_to;
use crate::smooth::{Neighbours, smooth};
use crate::surface::complex::Complex;
use crate::surface::{Method, cubes, nets};
use crate::volume::Padded;

/// Share of the error that decimation may take; the last correction of volumes may take the rest.
const DECIMATION_SHARE: f64 = 0.8;

/// How a patient is made.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Options {
    /// How far the mesh may be from the smooth surface, mm.
    pub max_error_mm: f64,
    /// How surfaces are found.
    pub surface: Method,
    /// Pieces of a group that are smaller go to their neighbours, mm³.
    pub min_island_mm3: f64,
    /// Pairs of smoothing steps.
    pub smoothing: usize,
}

impl Default for Options {
    fn default() -> Self {
        Self {
            max_error_mm: 0.5,
            surface: Method::Nets,
            min_island_mm3: 30.0,
            smoothing: 20,
        }
    }
}

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

/// The meshes of a patient, and the report on them.
#[derive(Clone, Debug)]
pub struct Patient {
    /// A mesh a group that is there.
    pub meshes: Vec<GroupMesh>,
    /// What was made.
    pub report: Report,
}

/// Volumes by group number, mm³.
fn targets(volume: &Padded) -> Vec<f64> {
    #[expect(clippy::cast_precision_loss, reason = "voxels stay far below 2^53")]
    let mm3 = |count: &u64| *count as f64 * volume.grid.voxel_mm3();
    volume.counts().iter().take(32).map(mm3).collect()
}

/// What was changed, and the volumes that meshes shall have: those before voxels that touch are separated, which is for the surfaces' sake.
fn repair(volume: &mut Padded, groups: &Groups, options: &Options) -> (Cleaned, Vec<f64>) {
    let least = (options.min_island_mm3 / volume.grid.voxel_mm3()).ceil();
    let mut cleaned = remove_islands(volume, floor_to(least, 1 << 30) as u64);
    let targets = targets(volume);
    cleaned.touching_voxels = separate_touching(volume, &groups.ranks());
    (cleaned, targets)
}

/// The surfaces between groups, smooth, with the volumes of their voxels.
fn surfaces(
    volume: &Padded,
    targets: &[f64],
    options: &Options,
    watch: &mut dyn FnMut(Stage),
) -> Complex {
    let grid = &volume.grid;
    let mut complex = match options.surface {
        Method::Nets => {
            let mut net = nets::extract(volume);
            watch(Stage::Smooth);
            let neighbours = Neighbours::of_net(&net);
            smooth(&mut net.positions, &neighbours, options.smoothing);
            Complex::of_net(net, grid)
        }
        Method::MarchingCubes => {
            let mut complex = cubes::extract(volume);
            watch(Stage::Smooth);
            let neighbours = Neighbours::of_triangles(&complex.triangles, complex.positions.len());
            smooth(&mut complex.positions, &neighbours, options.smoothing);
            complex.placed(grid)
        }
    };
    let half_voxel = 0.5 * grid.spacing().into_iter().fold(f64::INFINITY, f64::min);
    balance(&mut complex, targets, half_voxel);
    complex
}

/// A mesh a group with the share of its texture square that is used.
fn meshes(complex: &Complex, groups: &Groups) -> Vec<(GroupMesh, f64)> {
    (0..groups.groups.len())
        .into_par_iter()
        .map(|group| GroupMesh::of(complex, group))
        .filter(|mesh| !mesh.triangles.is_empty())
        .map(|mut mesh| {
            let used = unwrap(&mut mesh);
            (mesh, used)
        })
        .collect()
}

/// Makes a patient of the labels in `path`; `watch` is told each stage as it begins, but for [`Stage::Write`].
///
/// The same file and options give the same patient, on however many cores.
///
/// # Errors
/// [`BuildError`] if the volume is refused or has no group.
pub fn build(
    path: &Path,
    groups: &Groups,
    options: &Options,
    watch: &mut dyn FnMut(Stage),
) -> Result<Patient, BuildError> {
    watch(Stage::Read);
    let volume = read_labels(path, groups)?;
    if volume.voxels.iter().all(|group| *group == 0) {
        return Err(BuildError::Empty {
            path: path.to_owned(),
            table: groups.table.clone(),
        });
    }
    Ok(build_volume(path, volume, groups, options, watch))
}

fn build_volume(
    path: &Path,
    volume: LabelVolume,
    groups: &Groups,
    options: &Options,
    watch: &mut dyn FnMut(Stage),
) -> Patient {
    let mut volume = Padded::new(volume);
    let read = volume.counts();
    watch(Stage::Repair);
    let (repaired, targets) = repair(&mut volume, groups, options);
    watch(Stage::Surface);
    let fine = surfaces(&volume, &targets, options, watch);
    let triangles_fine = fine.triangles.len();
    watch(Stage::Decimate);
    let mut complex = decimate(fine, DECIMATION_SHARE * options.max_error_mm);
    balance(
        &mut complex,
        &targets,
        (1.0 - DECIMATION_SHARE) * options.max_error_mm,
    );
    watch(Stage::Meshes);
    let meshes = meshes(&complex, groups);
    watch(Stage::Measure);
    let after = volume.counts();
    let report_on = |(mesh, atlas_used): &(GroupMesh, f64)| {
        let group = &groups.groups[mesh.group];
        Some(GroupReport {
            name: group.name.clone(),
            voxels_read: read[mesh.group + 1],
            voxels: after[mesh.group + 1],
            vertices: mesh.positions.len(),
            triangles: mesh.triangles.len(),
            mass_kg: Asset { group, mesh }.mass_kg(),
            atlas_used: *atlas_used,
            measures: measure(mesh, &volume, targets[mesh.group + 1])?,
        })
    };
    let report = Report {
        source: path.to_owned(),
        table: groups.table.clone(),
        size: volume.grid.dims,
        spacing_mm: volume.grid.spacing(),
        orientation: volume.grid.orientation(),
        frame: FRAME,
        options: *options,
        repaired,
        triangles_fine,
        triangles: complex.triangles.len(),
        groups: meshes.par_iter().filter_map(report_on).collect(),
    };
    Patient {
        meshes: meshes.into_iter().map(|(mesh, _)| mesh).collect(),
        report,
    }
}

/// Writes `patient.glb`, `patient.usda` and `patient.json` (the report) into `folder`, which is made.
///
/// # Errors
/// [`BuildError::Unwritable`].
pub fn write(patient: &Patient, groups: &Groups, folder: &Path) -> Result<(), BuildError> {
    let unwritable = |path: &Path| {
        let path = path.to_owned();
        move |source| BuildError::Unwritable { path, source }
    };
    fs::create_dir_all(folder).map_err(unwritable(folder))?;
    let assets: Vec<Asset<'_>> = patient
        .meshes
        .iter()
        .map(|mesh| Asset {
            group: &groups.groups[mesh.group],
            mesh,
        })
        .collect();
    let (binary, text) = rayon::join(|| glb(&assets), || usda(&assets));
    let report = serde_json::to_string_pretty(&patient.report).map_err(io::Error::other);
    let report = report.map_err(unwritable(&folder.join("patient.json")))?;
    let files = [
        (GLB_FILE, binary),
        ("patient.usda", text.into_bytes()),
        ("patient.json", report.into_bytes()),
    ];
    for (name, bytes) in files {
        let path = folder.join(name);
        fs::write(&path, bytes).map_err(unwritable(&path))?;
    }
    Ok(())
}

#[cfg(test)]
mod tests;
