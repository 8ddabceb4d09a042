//! What a segmenter wants to be shown, and what its classes are.

use serde::{Deserialize, Serialize};

/// Most classes: with the background they fit 8 bits.
const CLASSES_MAX: usize = 254;
/// Most voxels along an axis of a window.
const PATCH_MAX: usize = 512;

/// How much the voxels of a window count where windows overlap.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Weighting {
    /// The middle more than the rim: a Gaussian with a deviation of an eighth of the window, as MONAI's.
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
    /// The label of each channel of the output. Without a label 0, a voxel is background where no score is above zero, which is a
    /// probability of one half.
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

impl std::fmt::Display for SettingsDefect {
    fn fmt(&self, out: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
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
        let within = |value: &f64, low: f64, high: f64| (low..=high).contains(value);
        let rising = |[low, high]: [f64; 2], most: f64| {
            low < high && within(&low, -most, most) && within(&high, -most, most)
        };
        let mut sorted = self.classes.clone();
        sorted.sort_unstable();
        let once = sorted.windows(2).all(|pair| pair[0] != pair[1]);
        let checks = [
            (
                "patch",
                format!("{:?}", self.patch),
                "[8, 512] voxels",
                self.patch.iter().all(|side| (8..=PATCH_MAX).contains(side)),
            ),
            (
                "spacing_mm",
                format!("{:?}", self.spacing_mm),
                "[0.1, 20] mm",
                self.spacing_mm.iter().all(|s| within(s, 0.1, 20.0)),
            ),
            (
                "orientation",
                self.orientation.clone(),
                "three of R or L, A or P, S or I",
                is_orientation(&self.orientation),
            ),
            (
                "window_hu",
                format!("{:?}", self.window_hu),
                "two rising numbers in [-1e5, 1e5]",
                rising(self.window_hu, 1e5),
            ),
            (
                "range",
                format!("{:?}", self.range),
                "two rising numbers in [-1e5, 1e5]",
                rising(self.range, 1e5),
            ),
            (
                "overlap",
                self.overlap.to_string(),
                "[0, 0.9]",
                within(&self.overlap, 0.0, 0.9),
            ),
            (
                "classes",
                format!("{:?}", self.classes),
                "1 to 254 labels, each once",
                (1..=CLASSES_MAX).contains(&self.classes.len()) && once,
            ),
        ];
        let wrong = checks.into_iter().find(|(.., good)| !good);
        wrong.map(|(key, value, allowed, _)| SettingsDefect {
            key,
            value,
            allowed,
        })
    }
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
