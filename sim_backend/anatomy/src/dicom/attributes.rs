//! What a file says of its slice, checked.
//!
//! Each attribute has one range that is allowed, or a default where the standard makes it optional.
//! Messages have the keyword of PS3.6, such as `PixelSpacing`, the value and what is allowed.

use std::path::{Path, PathBuf};

use dicom_dictionary_std::tags;
use dicom_object::{InMemDicomObject, Tag};
use nalgebra::Vector3;

use super::DicomError;
use crate::nifti::SIDE_MAX;
use crate::number::real;

/// The elements that say it.
pub(super) const READ: [Tag; 15] = [
    tags::MODALITY,
    tags::SERIES_INSTANCE_UID,
    tags::IMAGE_POSITION_PATIENT,
    tags::IMAGE_ORIENTATION_PATIENT,
    tags::SAMPLES_PER_PIXEL,
    tags::NUMBER_OF_FRAMES,
    tags::ROWS,
    tags::COLUMNS,
    tags::PIXEL_SPACING,
    tags::BITS_ALLOCATED,
    tags::BITS_STORED,
    tags::HIGH_BIT,
    tags::PIXEL_REPRESENTATION,
    tags::RESCALE_INTERCEPT,
    tags::RESCALE_SLOPE,
];

/// What a file says of its slice.
#[derive(Clone, Debug)]
pub(super) struct Slice {
    /// The file, read again for its pixels.
    pub(super) path: PathBuf,
    /// `SeriesInstanceUID`; empty if the file has none.
    pub(super) series: String,
    /// Pixels of a row.
    pub(super) columns: usize,
    /// Pixels of a column.
    pub(super) rows: usize,
    /// Between columns and between rows, mm: `PixelSpacing` has them the other way round.
    pub(super) spacing: [f64; 2],
    /// Unit vectors along a row (the way columns count) and along a column (the way rows count), in
    /// the patient, LPS.
    pub(super) along: [Vector3<f64>; 2],
    /// Centre of the first pixel, LPS, mm: `ImagePositionPatient`.
    pub(super) position: Vector3<f64>,
    /// `RescaleSlope`, 1 if it is missing.
    pub(super) slope: f64,
    /// `RescaleIntercept`, 0 if it is missing.
    pub(super) intercept: f64,
    /// 1 to 16, the low ones of 16; what is in the others is cut off.
    pub(super) bits_stored: u32,
    /// Whether stored numbers are two's complement.
    pub(super) signed: bool,
}

/// The attributes of a file, with the file's name for messages.
pub(super) struct Attributes<'a> {
    pub(super) path: &'a Path,
    pub(super) object: &'a InMemDicomObject,
}

impl Attributes<'_> {
    /// The error that names this file.
    fn wrong(&self, reason: impl Into<String>) -> DicomError {
        DicomError::File {
            path: self.path.display().to_string(),
            reason: reason.into(),
        }
    }

    /// The text of an attribute; none if it is not there.
    fn text(&self, tag: Tag, name: &str) -> Result<Option<String>, DicomError> {
        let Ok(element) = self.object.element(tag) else {
            return Ok(None);
        };
        let text = element.to_str();
        let text = text.map_err(|error| self.wrong(format!("{name} is no text: {error}")))?;
        Ok(Some(text.trim_matches(['\0', ' ']).to_owned()))
    }

    /// `N` numbers of an attribute; none if it is not there.
    fn maybe<const N: usize>(&self, tag: Tag, name: &str) -> Result<Option<[f64; N]>, DicomError> {
        let Ok(element) = self.object.element(tag) else {
            return Ok(None);
        };
        let wrong = |what: &str| self.wrong(format!("{name} is {what}, allowed are {N} numbers"));
        let numbers = element
            .to_multi_float64()
            .map_err(|_| wrong("no list of numbers"))?;
        match <[f64; N]>::try_from(numbers.as_slice()) {
            Ok(numbers) if numbers.iter().all(|number| number.is_finite()) => Ok(Some(numbers)),
            _ => Err(wrong(&format!("{numbers:?}"))),
        }
    }

    /// `N` finite numbers that must be there.
    fn numbers<const N: usize>(&self, tag: Tag, name: &str) -> Result<[f64; N], DicomError> {
        let missing = || self.wrong(format!("{name} is missing"));
        self.maybe(tag, name)?.ok_or_else(missing)
    }

    /// A whole number within a range.
    fn count(&self, tag: Tag, name: &str, [low, high]: [usize; 2]) -> Result<usize, DicomError> {
        let [value] = self.numbers(tag, name)?;
        let found = (low..=high).find(|count| (real(*count) - value).abs() <= 0.0);
        found.ok_or_else(|| self.wrong(format!("{name} is {value}, allowed is {low} to {high}")))
    }

    /// What the file says of its slice.
    pub(super) fn slice(&self) -> Result<Slice, DicomError> {
        let modality = self.text(tags::MODALITY, "Modality")?.unwrap_or_default();
        if modality != "CT" {
            return Err(self.wrong(format!("Modality is {modality:?}, allowed is CT")));
        }
        let several = self.maybe::<1>(tags::NUMBER_OF_FRAMES, "NumberOfFrames")?;
        if several.is_some_and(|[frames]| frames > 1.0) {
            return Err(self.wrong("several slices in one file (enhanced CT) are not read"));
        }
        self.count(tags::SAMPLES_PER_PIXEL, "SamplesPerPixel", [1, 1])?;
        self.count(tags::BITS_ALLOCATED, "BitsAllocated", [16, 16])?;
        let stored = self.count(tags::BITS_STORED, "BitsStored", [1, 16])?;
        self.count(tags::HIGH_BIT, "HighBit", [stored - 1, stored - 1])?;
        let signed = self.count(tags::PIXEL_REPRESENTATION, "PixelRepresentation", [0, 1])? == 1;
        let [row_spacing, column_spacing] = self.numbers(tags::PIXEL_SPACING, "PixelSpacing")?;
        let along =
            self.numbers::<6>(tags::IMAGE_ORIENTATION_PATIENT, "ImageOrientationPatient")?;
        let along = [
            Vector3::from_column_slice(&along[..3]),
            Vector3::from_column_slice(&along[3..]),
        ];
        let skew = along[0].dot(&along[1]).abs()
            + along.iter().map(|d| (d.norm() - 1.0).abs()).sum::<f64>();
        if skew > 0.01 {
            return Err(
                self.wrong("ImageOrientationPatient is not two directions at a right angle")
            );
        }
        let one = |tag, name, default| {
            Ok::<_, DicomError>(self.maybe::<1>(tag, name)?.map_or(default, |[value]| value))
        };
        Ok(Slice {
            path: self.path.to_owned(),
            series: self
                .text(tags::SERIES_INSTANCE_UID, "SeriesInstanceUID")?
                .unwrap_or_default(),
            columns: self.count(tags::COLUMNS, "Columns", [1, SIDE_MAX])?,
            rows: self.count(tags::ROWS, "Rows", [1, SIDE_MAX])?,
            spacing: [column_spacing, row_spacing],
            along,
            position: Vector3::from(
                self.numbers::<3>(tags::IMAGE_POSITION_PATIENT, "ImagePositionPatient")?,
            ),
            slope: one(tags::RESCALE_SLOPE, "RescaleSlope", 1.0)?,
            intercept: one(tags::RESCALE_INTERCEPT, "RescaleIntercept", 0.0)?,
            bits_stored: u32::try_from(stored).unwrap_or(16),
            signed,
        })
    }
}
