//! Slices in order, and where they lie.
//!
//! The affine of the image plane (PS3.3, C.7.6.2.1.1): column `i`, row `j` and slice `k` lie at
//! `position + i * along[0] * spacing[0] + j * along[1] * spacing[1] + k * step`, in LPS, mm.
//! `step` is from the first to the last slice over their number less one, so rounding of single
//! places averages out. Slice numbers and file names are not looked at, since many exporters
//! renumber.

use std::path::Path;

use nalgebra::{Matrix3, Vector3};

use super::DicomError;
use super::attributes::Slice;
use crate::grid::Grid;
use crate::nifti::{SIDE_MAX, VOXELS_MAX};
use crate::number::real;

/// Most that two slices may differ: the sum over both axes of the distance of the unit directions
/// and of the difference of spacings, mm.
const TOLERANCE: f64 = 1e-3;
/// How far a gap between slices may be from the usual one, and a slice from its place, in steps.
const STEP_TOLERANCE: f64 = 0.05;

/// Puts `slices` in order, and says where they lie.
///
/// Sorts by the height along the normal of the first slice, so the third axis runs along
/// `along[0] x along[1]` and the lattice is right-handed in LPS and in RAS.
///
/// # Errors
/// No slice, slices of several series or of different shape, too few or too many, a gap, two at one
/// place, one out of line, and voxels or places out of range.
pub(super) fn arrange(folder: &Path, slices: &mut [Slice]) -> Result<Grid, DicomError> {
    let wrong = |reason: String| DicomError::Series {
        folder: folder.display().to_string(),
        reason,
    };
    let Some(first) = slices.first().cloned() else {
        let text = "no DICOM file is in it; a CT is a .nii, a .nii.gz or a folder with a series";
        return Err(wrong(text.to_owned()));
    };
    if let Some(reason) = mixture(&first, slices) {
        return Err(wrong(reason));
    }
    let count = slices.len();
    if !(2..=SIDE_MAX).contains(&count) || count * first.columns * first.rows > VOXELS_MAX {
        let (columns, rows) = (first.columns, first.rows);
        return Err(wrong(format!(
            "{count} slices of {columns} x {rows}; allowed are 2 to {SIDE_MAX}, and 2^30 voxels"
        )));
    }
    let normal = first.along[0].cross(&first.along[1]);
    slices.sort_by(|one, other| one.height(&normal).total_cmp(&other.height(&normal)));
    if let Some(reason) = unevenness(&normal, slices) {
        return Err(wrong(reason));
    }
    if let Some(slice) = out_of_line(slices) {
        let path = slice.path.display();
        return Err(wrong(format!("{path} is not in line with the others")));
    }
    let grid = grid(slices);
    let spacing = grid.spacing();
    let placed = grid.origin.iter().all(|mm| mm.abs() < 1e6);
    if placed && spacing.iter().all(|mm| (0.01..=100.0).contains(mm)) {
        return Ok(grid);
    }
    let allowed = "allowed is 0.01 to 100 mm, within 1 km";
    Err(wrong(format!("voxels of {spacing:?} mm; {allowed}")))
}

impl Slice {
    /// How far along `normal` it is, mm.
    fn height(&self, normal: &Vector3<f64>) -> f64 {
        self.position.dot(normal)
    }

    /// Whether its pixels are as another's.
    fn is_like(&self, other: &Self) -> bool {
        let apart = |k: usize| {
            (self.along[k] - other.along[k]).norm() + (self.spacing[k] - other.spacing[k]).abs()
        };
        let same_size = [self.columns, self.rows] == [other.columns, other.rows];
        same_size && apart(0) + apart(1) < TOLERANCE
    }
}

/// The names of two files.
fn names(one: &Slice, other: &Slice) -> String {
    format!("{} and {}", one.path.display(), other.path.display())
}

/// Why `slices` are not of one series, if they are not.
fn mixture(first: &Slice, slices: &[Slice]) -> Option<String> {
    if let Some(other) = slices.iter().find(|slice| slice.series != first.series) {
        let of = |series: &str| slices.iter().filter(|slice| slice.series == series).count();
        let [one, other] = [&first.series, &other.series].map(|series| (series, of(series)));
        return Some(format!(
            "several series: {} with {} files, {} with {}; put one into a folder of its own",
            one.0, one.1, other.0, other.1
        ));
    }
    let other = slices.iter().find(|slice| !slice.is_like(first))?;
    let both = names(first, other);
    Some(format!(
        "{both} differ in size, pixel spacing or orientation"
    ))
}

/// Which of `slices`, in order, are not as far apart as the others, if any are not.
///
/// Compared with the median gap.
fn unevenness(normal: &Vector3<f64>, slices: &[Slice]) -> Option<String> {
    let gap = |pair: &[Slice]| pair[1].height(normal) - pair[0].height(normal);
    let mut gaps: Vec<f64> = slices.windows(2).map(gap).collect();
    gaps.sort_by(f64::total_cmp);
    let usual = gaps[gaps.len() / 2];
    slices.windows(2).find_map(|pair| {
        let (gap, both) = (gap(pair), names(&pair[0], &pair[1]));
        if gap < 1e-3 {
            return Some(format!("{both} are at the same place"));
        }
        let even = (gap - usual).abs() <= STEP_TOLERANCE * usual;
        (!even).then(|| {
            format!("{both} are {gap:.3} mm apart and others {usual:.3} mm: slices are missing")
        })
    })
}

/// A slice that is off its place on the line from the first to the last, if one is; places are
/// often rounded to 0.1 mm.
fn out_of_line(slices: &[Slice]) -> Option<&Slice> {
    let (first, last) = (&slices[0], &slices[slices.len() - 1]);
    let step = (last.position - first.position) / real(slices.len() - 1);
    let most = (STEP_TOLERANCE * step.norm()).max(0.1);
    let mut placed = slices.iter().enumerate();
    let off =
        placed.find(|(k, slice)| (slice.position - first.position - step * real(*k)).norm() > most);
    off.map(|(_, slice)| slice)
}

/// Where slices in order lie. A tilted gantry makes steps that are not at a right angle to the
/// slices.
///
/// `steps` is sheared then; nothing is resampled.
fn grid(slices: &[Slice]) -> Grid {
    // LPS to RAS.
    let ras = Vector3::new(-1.0, -1.0, 1.0);
    let (first, last) = (&slices[0], &slices[slices.len() - 1]);
    let step = (last.position - first.position) / real(slices.len() - 1);
    let columns = [
        first.along[0] * first.spacing[0],
        first.along[1] * first.spacing[1],
        step,
    ];
    Grid {
        dims: [first.columns, first.rows, slices.len()],
        steps: Matrix3::from_columns(&columns.map(|column| column.component_mul(&ras))),
        origin: first.position.component_mul(&ras),
    }
}
