//! Voxels of a patient: labels and a CT, slice by slice.
//!
//! Each voxel's centre is taken back to the nominal anatomy and asked which part it is in: no
//! partial volumes, no scanner's blur. Training adds blur. Slices are independent, with noise of
//! their own seed, so any number of cores gives the same bytes.

use std::fs;
use std::path::Path;

use nalgebra::Point3;
use rayon::prelude::*;

use hal::random::SplitMix64;

use super::anatomy::{torso_distance, torso_reach};
use super::patient::Patient;
use crate::grid::Grid;
use crate::nifti::{DataType, LabelVolume, NiftiError, Writer};
use crate::number::{floor_to, real, rounded_i16};

/// VISTA3D's (MAISI's) number of the body.
const BODY: u8 = 200;

/// What the scan sees along x, y and z, mm.
///
/// The same for all patients and sizes; the torso is cut off at both ends.
const FIELD_MM: [f64; 3] = [450.0, 450.0, 540.0];

/// Slices that are made at a time, which is what is held in memory.
const BATCH: usize = 16;

/// Deviation of the CT's noise, HU.
const NOISE_HU: f64 = 12.0;

/// Voxels along the axes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Size(pub [usize; 3]);

impl Size {
    /// The voxels of a scan with a spacing as near to `spacing_mm` as whole numbers of voxels
    /// allow.
    #[must_use]
    pub fn of_spacing(spacing_mm: f64) -> Self {
        Self(FIELD_MM.map(|side| floor_to((side / spacing_mm).round(), 4096).max(1)))
    }

    /// The voxel size, mm.
    #[must_use]
    pub fn spacing_mm(self) -> [f64; 3] {
        [0, 1, 2].map(|axis| FIELD_MM[axis] / real(self.0[axis]))
    }
}

/// A part of the patient and how much of it there is.
#[derive(Clone, Debug, serde::Serialize)]
pub struct PartVolume {
    /// Its name.
    pub name: String,
    /// Its label.
    pub label: u8,
    /// Its voxels.
    pub voxels: u64,
    /// Its volume, mm³.
    pub volume_mm3: f64,
}

/// What was written.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Phantom {
    /// The seed.
    pub seed: u64,
    /// Voxels along the axes.
    pub size: [usize; 3],
    /// Voxel size, mm.
    pub spacing_mm: [f64; 3],
    /// See [`Patient::scale`].
    pub scale: [f64; 3],
    /// See [`Patient::fat`].
    pub fat: f64,
    /// See [`Patient::variation`].
    pub variation: f64,
    /// Voxels in two parts that must not overlap; 0.
    pub overlapping_voxels: u64,
    /// The parts, the body last.
    pub parts: Vec<PartVolume>,
}

/// A patient's CT with its labels.
#[derive(Clone, Debug)]
pub struct Scan {
    /// The CT's values, HU, in the order of the labels.
    pub hounsfield: Vec<i16>,
    /// VISTA3D's numbers.
    pub labels: LabelVolume,
    /// What there is of each part.
    pub phantom: Phantom,
}

/// Mean density on the CT by label, HU: soft tissue in the portal venous phase.
const fn hounsfield(label: u8) -> f64 {
    match label {
        0 => -1000.0,
        BODY => -95.0,
        57 | 135 | 136 => -820.0,
        1 => 110.0,
        3 => 120.0,
        4 => 95.0,
        5 | 14 => 180.0,
        10 | 15 => 10.0,
        11 | 12 | 13 | 19 | 62 => 40.0,
        6 | 7 | 17 | 58..=61 => 165.0,
        115 => 140.0,
        104..=107 => 60.0,
        _ => 420.0,
    }
}

/// Labels of a slice, with what they add to the tally.
struct Slice {
    /// The first axis fastest.
    labels: Vec<u8>,
    /// By part, the body last.
    voxels: Vec<u64>,
    /// Voxels in parts that must not overlap.
    overlapping: u64,
}

/// The lattice of a scan of `size` voxels.
pub(super) fn grid(size: Size) -> Grid {
    Grid::centred(size.0, size.spacing_mm())
}

/// Parts and points that are out of reach are left out by boxes, widened by the deformation.
fn paint(patient: &Patient, grid: &Grid, z: usize) -> Slice {
    let mut slice = Slice {
        labels: Vec::with_capacity(grid.slice_len()),
        voxels: vec![0; patient.parts.len() + 1],
        overlapping: 0,
    };
    let bend = patient.bend_mm();
    let height = grid.world(&Point3::new(0.0, 0.0, real(z))).z;
    let [low, high] = [height - bend, height + bend].map(|z| z / patient.scale[2]);
    let near: Vec<usize> = (0..patient.parts.len())
        .filter(|&part| patient.parts[part].reaches(2, low, high))
        .collect();
    let [wide, deep] = torso_reach(patient.fat);
    let reach = [
        wide * patient.scale[0] + bend,
        deep * patient.scale[1] + bend,
    ];
    for y in 0..grid.dims[1] {
        for x in 0..grid.dims[0] {
            let p = grid.world(&Point3::new(real(x), real(y), real(z)));
            let outside = p.x.abs() > reach[0] || p.y.abs() > reach[1];
            let label = if outside {
                0
            } else {
                slice.label(patient, &near, &p)
            };
            slice.labels.push(label);
        }
    }
    slice
}

impl Slice {
    /// The label at `p` of the world, counted.
    fn label(&mut self, patient: &Patient, near: &[usize], p: &Point3<f64>) -> u8 {
        let nominal = patient.nominal(p);
        if torso_distance(&nominal, patient.fat) >= 0.0 {
            return 0;
        }
        let (part, overlap) = patient.part_at(&nominal, near);
        self.overlapping += u64::from(overlap);
        self.voxels[part.unwrap_or(patient.parts.len())] += 1;
        part.map_or(BODY, |part| patient.parts[part].part.label)
    }

    /// The CT's values, HU; noise is of the seed and the slice.
    fn hounsfield(&self, seed: u64, z: usize) -> Vec<i16> {
        let mut random = SplitMix64::named("noise", seed.wrapping_mul(8191).wrapping_add(z as u64));
        let value = |label: &u8| {
            rounded_i16((hounsfield(*label) + NOISE_HU * random.normal()).max(-1024.0))
        };
        self.labels.iter().map(value).collect()
    }
}

/// What a scan of `size` sees of `patient`, in memory: the CT's values, HU, and the labels in
/// VISTA3D's numbers, with what there is of each part.
///
/// For training, which needs no files. Holds labels and values, three bytes a voxel, twice for a
/// moment.
#[must_use]
pub fn scan(patient: &Patient, size: Size) -> Scan {
    let grid = grid(size);
    let slices: Vec<(Slice, Vec<i16>)> = (0..size.0[2])
        .into_par_iter()
        .map(|z| {
            let slice = paint(patient, &grid, z);
            let values = slice.hounsfield(patient.seed, z);
            (slice, values)
        })
        .collect();
    let mut tally = Tally::new(patient);
    slices.iter().for_each(|(slice, _)| tally.add(slice));
    let phantom = tally.result(patient, &grid);
    let (slices, values): (Vec<Slice>, Vec<Vec<i16>>) = slices.into_iter().unzip();
    let voxels = slices.into_iter().flat_map(|slice| slice.labels).collect();
    Scan {
        hounsfield: values.concat(),
        labels: LabelVolume { grid, voxels },
        phantom,
    }
}

/// Sums over slices.
///
/// In the order of the patient's parts, the body last.
struct Tally {
    voxels: Vec<u64>,
    overlapping: u64,
}

impl Tally {
    fn new(patient: &Patient) -> Self {
        Self {
            voxels: vec![0; patient.parts.len() + 1],
            overlapping: 0,
        }
    }

    fn add(&mut self, slice: &Slice) {
        for (sum, voxels) in self.voxels.iter_mut().zip(&slice.voxels) {
            *sum += voxels;
        }
        self.overlapping += slice.overlapping;
    }

    fn result(self, patient: &Patient, grid: &Grid) -> Phantom {
        let parts = patient
            .parts
            .iter()
            .map(|part| (part.part.name.as_str(), part.part.label));
        let named = parts.chain([("body", BODY)]).zip(self.voxels);
        #[expect(clippy::cast_precision_loss, reason = "voxels stay far below 2^53")]
        let volume = |((name, label), voxels): ((&str, u8), u64)| PartVolume {
            name: name.to_owned(),
            label,
            voxels,
            volume_mm3: voxels as f64 * grid.voxel_mm3(),
        };
        Phantom {
            seed: patient.seed,
            size: grid.dims,
            spacing_mm: grid.spacing(),
            scale: patient.scale,
            fat: patient.fat,
            variation: patient.variation,
            overlapping_voxels: self.overlapping,
            parts: named.map(volume).collect(),
        }
    }
}

/// Writes `ct.nii.gz` (HU, 16 bits) and `labels.nii.gz` (VISTA3D's numbers, 8 bits) of `patient`
/// into `folder`, which is made; `done` is told after each batch how many of how many slices there
/// are.
///
/// The same seed and size give the same files. Memory is that of 16 slices.
///
/// # Errors
/// [`NiftiError::Unwritable`].
pub fn write(
    patient: &Patient,
    size: Size,
    folder: &Path,
    mut done: impl FnMut(usize, usize),
) -> Result<Phantom, NiftiError> {
    fs::create_dir_all(folder).map_err(|source| NiftiError::Unwritable {
        path: folder.display().to_string(),
        source,
    })?;
    let grid = grid(size);
    let mut labels = Writer::create(&folder.join("labels.nii.gz"), &grid, DataType::U8)?;
    let mut ct = Writer::create(&folder.join("ct.nii.gz"), &grid, DataType::I16)?;
    let mut tally = Tally::new(patient);
    for first in (0..size.0[2]).step_by(BATCH) {
        let last = (first + BATCH).min(size.0[2]);
        let slices: Vec<(Slice, Vec<u8>)> = (first..last)
            .into_par_iter()
            .map(|z| {
                let slice = paint(patient, &grid, z);
                let values = slice.hounsfield(patient.seed, z);
                let values = values.into_iter().flat_map(i16::to_le_bytes).collect();
                (slice, values)
            })
            .collect();
        let (reported, scanned) = rayon::join(
            || {
                slices
                    .iter()
                    .try_for_each(|(slice, _)| labels.slice(&slice.labels))
            },
            || slices.iter().try_for_each(|(_, values)| ct.slice(values)),
        );
        reported.and(scanned)?;
        slices.iter().for_each(|(slice, _)| tally.add(slice));
        done(last, size.0[2]);
    }
    labels.finish()?;
    ct.finish()?;
    Ok(tally.result(patient, &grid))
}
