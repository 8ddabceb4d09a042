//! What a segmenter wants to be shown, and what its classes are.

use std::fmt::{self, Debug, Display, Formatter};

use serde::{Deserialize, Serialize};

/// Most classes: with the background they fit 8 bits.
const CLASSES_MAX: usize = 254;
/// Most voxels along an axis of a window.
const PATCH_MAX: usize = 512;

/// How much the voxels of a window count where windows overlap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Weighting {
    /// The middle more than the rim: a Gaussian with a deviation of an eighth of the window, as
    /// MONAI's.
    #[default]
    Gaussian,
    /// All alike.
    Constant,
}

/// What a segmenter wants to be shown, and what its classes are.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SegmenterSettings {
    /// Voxels of a window along the tensor's axes.
    pub patch: [usize; 3],
    /// Voxel size that the CT is resampled to, along the tensor's axes, mm.
    pub spacing_mm: [f64; 3],
    /// Where the tensor's axes lead in the patient, such as `RAS`: right, anterior, superior.
    pub orientation: String,
    /// CT values, HU, that become `range`; what is below or above is cut off.
    pub window_hu: [f64; 2],
    /// What the network sees for the ends of `window_hu`.
    pub range: [f64; 2],
    /// Share of a window that the next one covers again.
    pub overlap: f64,
    /// How overlapping windows are weighted.
    #[serde(default)]
    pub weighting: Weighting,
    /// The table of labels that `classes` are from.
    pub table: String,
    /// The label of each channel of the output. Without a label 0, a voxel is background where no
    /// score is above zero, which is a probability of one half.
    pub classes: Vec<u16>,
}

/// A setting that is not allowed.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct SettingsDefect {
    /// Its key.
    pub key: &'static str,
    /// Its value.
    pub value: String,
    /// What may stand there.
    pub allowed: &'static str,
}

impl Display for SettingsDefect {
    fn fmt(&self, out: &mut Formatter<'_>) -> fmt::Result {
        let Self {
            key,
            value,
            allowed,
        } = self;
        write!(out, "{key} = {value} is outside {allowed}")
    }
}

impl SegmenterSettings {
    /// The first setting that is not allowed.
    #[must_use]
    pub fn defect(&self) -> Option<SettingsDefect> {
        let Self {
            patch,
            spacing_mm,
            orientation,
            window_hu,
            range,
            overlap,
            classes,
            ..
        } = self;
        let shown = |value: &dyn Debug| format!("{value:?}");
        let sides = patch.iter().all(|side| (8..=PATCH_MAX).contains(side));
        let spacings = spacing_mm.iter().all(|s| (0.1..=20.0).contains(s));
        let overlaps = (0.0..=0.9).contains(overlap);
        let (oriented, labels) = (is_orientation(orientation), are_classes(classes));
        let (windows, ranges) = (is_rising(*window_hu), is_rising(*range));
        // Keys, values, what is allowed, and whether the value is.
        let checks = [
            ("patch", shown(patch), "[8, 512] voxels", sides),
            ("spacing_mm", shown(spacing_mm), "[0.1, 20] mm", spacings),
            ("orientation", orientation.clone(), AXES, oriented),
            ("window_hu", shown(window_hu), RISING, windows),
            ("range", shown(range), RISING, ranges),
            ("overlap", overlap.to_string(), "[0, 0.9]", overlaps),
            ("classes", shown(classes), LABELS, labels),
        ];
        let wrong = checks.into_iter().find(|(.., good)| !good);
        wrong.map(|(key, value, allowed, _)| SettingsDefect {
            key,
            value,
            allowed,
        })
    }
}

/// What messages allow.
const AXES: &str = "three of R or L, A or P, S or I";
const RISING: &str = "two rising numbers in [-1e5, 1e5]";
const LABELS: &str = "1 to 254 labels, each once";

fn is_rising([low, high]: [f64; 2]) -> bool {
    let allowed = -1e5..=1e5;
    low < high && allowed.contains(&low) && allowed.contains(&high)
}

fn are_classes(labels: &[u16]) -> bool {
    let mut sorted = labels.to_vec();
    sorted.sort_unstable();
    let once = sorted.windows(2).all(|pair| pair[0] != pair[1]);
    (1..=CLASSES_MAX).contains(&labels.len()) && once
}

fn is_orientation(text: &str) -> bool {
    let mut axes: Vec<usize> = text
        .chars()
        .filter_map(|letter| {
            ["RL", "AP", "SI"]
                .iter()
                .position(|pair| pair.contains(letter))
        })
        .collect();
    axes.sort_unstable();
    text.len() == 3 && axes == [0, 1, 2]
}
