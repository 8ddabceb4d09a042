//! The pipeline from a label volume to a patient of meshes.

mod report;
mod surfaces;

use std::fs;
use std::io;
use std::path::Path;

use rayon::prelude::*;
use serde::Serialize;

use crate::assets::{
    Asset, FRAME, GLB_FILE, glb, level_file, levels_usda, tetrahedra_usda, texture_file, usda, usdz,
};
use crate::atlas::unwrap;
use crate::clean::{Cleaned, remove_islands, separate_touching};
use crate::decimate::decimate;
use crate::groups::{Group, Groups};
use crate::measure::measure;
use crate::mesh::GroupMesh;
use crate::nifti::{LabelVolume, read_labels};
use crate::number::{floor_to, index};
use crate::surface::Method;
use crate::surface::complex::Complex;
use crate::tetra::Tetrahedra;
use crate::texture::png;
use crate::volume::Padded;

use surfaces::{settle, stage_distances, surfaces};

pub use report::{
    BuildError, GroupReport, LevelReport, Report, Stage, StageDistance, TetrahedraReport,
};

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
    /// Whether distances are measured after each stage that moves surfaces, rather than of the
    /// result alone.
    pub measure_stages: bool,
    /// Side of the cells of the lattice of tetrahedra, mm; none if there are to be none.
    pub tetrahedra_mm: Option<f64>,
    /// Side of the groups' textures, pixels; none if there are to be none.
    pub textures_px: Option<u32>,
    /// How many coarser levels of detail there are to be, each with twice the error of the one
    /// before, at most [`LEVELS_MAX`].
    pub levels: u32,
}

/// Most coarser levels of detail.
pub const LEVELS_MAX: u32 = 4;

impl Default for Options {
    fn default() -> Self {
        Self {
            max_error_mm: 0.5,
            surface: Method::Nets,
            min_island_mm3: 30.0,
            smoothing: 20,
            measure_stages: false,
            tetrahedra_mm: None,
            textures_px: None,
            levels: 0,
        }
    }
}

/// The meshes of a patient, and the report on them.
#[derive(Clone, Debug)]
pub struct Patient {
    /// A mesh a group that is there.
    pub meshes: Vec<GroupMesh>,
    /// Tetrahedra of the groups that have any, if they were asked for.
    pub tetrahedra: Vec<Tetrahedra>,
    /// Coarser meshes, a level of detail each, if they were asked for; the same groups in the same
    /// order, but for those that vanish.
    pub levels: Vec<Vec<GroupMesh>>,
    /// What was made.
    pub report: Report,
}

impl Patient {
    /// Makes tetrahedra of all groups that are not too thin for them.
    fn fill(&mut self, groups: &Groups, side_mm: f64) {
        let meshes = self.meshes.par_iter();
        let filled: Vec<_> = meshes
            .map(|mesh| (mesh, Tetrahedra::fill(mesh, side_mm)))
            .collect();
        for (mesh, filled) in filled {
            let group = groups.groups[mesh.group].name.clone();
            let report = match &filled {
                Ok(filled) => TetrahedraReport::of(group, filled, mesh),
                Err(reason) => TetrahedraReport::none(group, reason),
            };
            self.report.tetrahedra.push(report);
            self.tetrahedra.extend(filled);
        }
    }
}

/// Volumes by group number, mm³.
fn targets(volume: &Padded) -> Vec<f64> {
    #[expect(clippy::cast_precision_loss, reason = "voxels stay far below 2^53")]
    let mm3 = |count: &u64| *count as f64 * volume.grid.voxel_mm3();
    volume.counts().iter().take(32).map(mm3).collect()
}

/// What was changed, and the volumes that meshes shall have: those before voxels that touch are
/// separated, which is for the surfaces' sake.
fn repair(volume: &mut Padded, groups: &Groups, options: &Options) -> (Cleaned, Vec<f64>) {
    let least = (options.min_island_mm3 / volume.grid.voxel_mm3()).ceil();
    let mut cleaned = remove_islands(volume, floor_to(least, 1 << 30) as u64);
    let targets = targets(volume);
    cleaned.touching_voxels = separate_touching(volume, &groups.ranks());
    (cleaned, targets)
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

/// Coarser levels of detail: each made of the one before, so that what one loses the next has not.
fn coarser(
    mut complex: Complex,
    groups: &Groups,
    targets: &[f64],
    options: &Options,
) -> (Vec<Vec<GroupMesh>>, Vec<LevelReport>) {
    let mut further_mm = options.max_error_mm;
    (0..options.levels.min(LEVELS_MAX))
        .map(|_| {
            complex = decimate(core::mem::take(&mut complex), DECIMATION_SHARE * further_mm);
            settle(&mut complex, targets, (1.0 - DECIMATION_SHARE) * further_mm);
            let level = meshes(&complex, groups).into_iter().map(|(mesh, _)| mesh);
            // What the levels before are off, and this one from them.
            further_mm *= 2.0;
            let report = LevelReport {
                max_error_mm: further_mm,
                triangles: complex.triangles.len(),
            };
            (level.collect(), report)
        })
        .unzip()
}

/// Makes a patient of the labels in `path`; `watch` is told each stage as it begins, but for
/// [`Stage::Write`].
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
    let mut by_stage = Vec::new();
    let mut look = |stage: Stage, complex: &dyn Fn() -> Complex| {
        if options.measure_stages {
            let found = stage_distances(stage, &complex(), &volume, groups, &targets);
            by_stage.extend(found);
        }
    };
    let fine = surfaces(&volume, &targets, options, watch, &mut |complex| {
        look(Stage::Surface, complex);
    });
    look(Stage::Smooth, &|| fine.clone());
    let triangles_fine = fine.triangles.len();
    watch(Stage::Decimate);
    let mut complex = decimate(fine, DECIMATION_SHARE * options.max_error_mm);
    let rest_mm = (1.0 - DECIMATION_SHARE) * options.max_error_mm;
    settle(&mut complex, &targets, rest_mm);
    look(Stage::Decimate, &|| complex.clone());
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
            mass_kg: asset(group, mesh, None).mass_kg(),
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
        stage_distances: by_stage,
        tetrahedra: Vec::new(),
        levels: Vec::new(),
    };
    let mut patient = Patient {
        meshes: meshes.into_iter().map(|(mesh, _)| mesh).collect(),
        tetrahedra: Vec::new(),
        levels: Vec::new(),
        report,
    };
    (patient.levels, patient.report.levels) = coarser(complex, groups, &targets, options);
    if let Some(side_mm) = options.tetrahedra_mm {
        patient.fill(groups, side_mm);
    }
    patient
}

/// A mesh with what it is made of.
const fn asset<'a>(group: &'a Group, mesh: &'a GroupMesh, texture: Option<&'a [u8]>) -> Asset<'a> {
    Asset {
        group,
        mesh,
        texture,
    }
}

/// What belongs to `meshes`, as files have it.
fn assets<'a>(meshes: &'a [GroupMesh], groups: &'a Groups) -> Vec<Asset<'a>> {
    let plain = |mesh: &'a GroupMesh| asset(&groups.groups[mesh.group], mesh, None);
    meshes.iter().map(plain).collect()
}

/// Writes `patient.glb`, `patient.usda`, the same in `patient.usdz`, `patient.json` (the report)
/// and, as far as they were asked for, `tetrahedra.usda`, `patient-textured.glb` and `.usdz`, and
/// coarser levels (`patient-level-1.usda` and following) with `patient-levels.usda`, which has all
/// as variants, into `folder`, which is made.
///
/// # Errors
/// [`BuildError::Unwritable`].
pub fn write(patient: &Patient, groups: &Groups, folder: &Path) -> Result<(), BuildError> {
    let unwritable = |path: &Path| {
        let path = path.to_owned();
        move |source| BuildError::Unwritable { path, source }
    };
    fs::create_dir_all(folder).map_err(unwritable(folder))?;
    let assets = assets(&patient.meshes, groups);
    let (binary, text) = rayon::join(|| glb(&assets), || usda(&assets));
    let report = serde_json::to_string_pretty(&patient.report).map_err(io::Error::other);
    let report = report.map_err(unwritable(&folder.join("patient.json")))?;
    let files = vec![
        (GLB_FILE.to_owned(), Some(binary)),
        (
            "patient.usdz".to_owned(),
            Some(usdz(&[("patient.usda".to_owned(), text.as_bytes())])),
        ),
        ("patient.usda".to_owned(), Some(text.into_bytes())),
        ("patient.json".to_owned(), Some(report.into_bytes())),
    ];
    let textured = textured(patient, groups).map_err(unwritable(folder))?;
    let further = on_request(patient, groups).into_iter().chain(textured);
    for (name, bytes) in files.into_iter().chain(further) {
        let path = folder.join(name);
        match bytes {
            Some(bytes) => fs::write(&path, bytes).map_err(unwritable(&path))?,
            // Those of other meshes.
            None if path.exists() => fs::remove_file(&path).map_err(unwritable(&path))?,
            None => {}
        }
    }
    Ok(())
}

/// `patient-textured.glb` and `patient-textured.usdz`, which have a texture a group in them, if
/// they are asked for.
fn textured(patient: &Patient, groups: &Groups) -> io::Result<[(String, Option<Vec<u8>>); 2]> {
    let file = |suffix: &str, bytes| (format!("patient-textured.{suffix}"), bytes);
    let Some(side) = patient.report.options.textures_px else {
        return Ok(["glb", "usdz"].map(|suffix| file(suffix, None)));
    };
    // One after another: a texture is painted on all cores, and takes 50 bytes a pixel meanwhile.
    let meshes = patient.meshes.iter();
    let paint = |mesh: &GroupMesh| png(&groups.groups[mesh.group], mesh, side);
    let pictures: Result<Vec<Vec<u8>>, _> = meshes.map(paint).collect();
    let pictures = pictures.map_err(io::Error::other)?;
    let pairs = patient.meshes.iter().zip(&pictures);
    let assets: Vec<Asset<'_>> = pairs
        .map(|(mesh, png)| asset(&groups.groups[mesh.group], mesh, Some(png)))
        .collect();
    let text = usda(&assets);
    let stage = ("patient-textured.usda".to_owned(), text.as_bytes());
    let pictures = assets.iter().zip(&pictures);
    let pictures = pictures.map(|(asset, png)| (texture_file(asset.group), png.as_slice()));
    let packed: Vec<(String, &[u8])> = [stage].into_iter().chain(pictures).collect();
    Ok([
        file("glb", Some(glb(&assets))),
        file("usdz", Some(usdz(&packed))),
    ])
}

/// The files that are made if they are asked for, and have no bytes if they are not.
fn on_request(patient: &Patient, groups: &Groups) -> Vec<(String, Option<Vec<u8>>)> {
    let filled = (!patient.tetrahedra.is_empty())
        .then(|| tetrahedra_usda(groups, &patient.tetrahedra).into_bytes());
    let levels = index(patient.levels.len());
    let all = (levels > 0).then(|| levels_usda(levels).into_bytes());
    let mut files = vec![
        ("tetrahedra.usda".to_owned(), filled),
        ("patient-levels.usda".to_owned(), all),
    ];
    for level in 1..=LEVELS_MAX {
        let meshes = patient.levels.get(level as usize - 1);
        let text = meshes.map(|meshes| usda(&assets(meshes, groups)).into_bytes());
        files.push((level_file(level), text));
    }
    files
}

#[cfg(test)]
mod tests;
