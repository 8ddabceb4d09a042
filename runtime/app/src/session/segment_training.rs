//! A segmenter of our own, trained on procedural patients.

use std::path::{Path, PathBuf};

use serde::Serialize;

use trocar_anatomy::groups::Groups;
use trocar_anatomy::overlap::dice;
use trocar_anatomy::phantom::{self, Patient, Size};
use trocar_nets::dimension::dimension;
use trocar_nets::segmenter::{
    Image, Segmenter, SegmenterSettings, UNetConfig, Weighting, save_segmenter,
};
use trocar_train::{LabelledScan, SegmenterTraining};

use super::segment::{Classes, mean};
use super::{SessionError, outputs};

/// Seeds of patients to train on begin here: those below, which one makes oneself, are not seen in
/// training.
const TRAINING_SEEDS: u64 = 1_000_000;

/// CT values that the network sees, and soft tissue among them, HU.
const WINDOW_HU: [f64; 2] = [-1000.0, 1000.0];
const SOFT_TISSUE_HU: [f64; 2] = [-160.0, 240.0];

/// The table of our own classes.
const TABLE: &str = "groups";

/// What to train, and how.
#[derive(Clone, Debug)]
pub struct SegmentTraining {
    /// The file.
    pub out: PathBuf,
    /// Voxel size, mm; a little more or less if a scan would not have whole voxels.
    pub spacing_mm: f64,
    /// Voxels along each side of a window.
    pub patch: usize,
    /// Channels of the network by level.
    pub widths: Vec<i64>,
    /// Patients to train on.
    pub patients: u64,
    /// Patients to judge it by.
    pub validate: u64,
    /// How it is trained.
    pub training: SegmenterTraining,
}

/// How well a group of unseen patients is found.
#[derive(Clone, Debug, Serialize)]
pub struct GroupScore {
    /// Its name.
    pub name: String,
    /// Dice of each patient; none if it has not the group and none is found.
    pub dice: Vec<Option<f64>>,
    /// Their mean.
    pub mean: Option<f64>,
}

/// What came of it.
#[derive(Clone, Debug, Serialize)]
pub struct SegmenterTrained {
    /// What it wants to be shown.
    pub settings: SegmenterSettings,
    /// Steps taken.
    pub steps: u64,
    /// The mean loss of the last steps.
    pub loss: f64,
    /// Bytes of the file.
    pub bytes: u64,
    /// Dice on unseen patients, by group.
    pub groups: Vec<GroupScore>,
    /// The mean over groups of their means.
    pub mean_dice: Option<f64>,
}

/// What is going on.
#[derive(Clone, Copy, Debug)]
pub enum SegmenterProgress {
    /// A patient was made.
    Patient(u64),
    /// Steps taken with the mean loss of the last ones.
    Step(u64, f64),
    /// An unseen patient was judged.
    Judged(u64),
}

/// A patient as the network is to see it.
fn scan(seed: u64, size: Size, groups: &Groups) -> LabelledScan {
    let scan = phantom::scan(&Patient::new(seed), size);
    let group = |label: &u8| groups.group_of(u16::from(*label)).unwrap_or(0);
    LabelledScan {
        dims: scan.labels.grid.dims,
        classes: scan.labels.voxels.iter().map(group).collect(),
        hounsfield: scan.hounsfield,
    }
}

/// The size of the scans, the settings and the network.
fn plan(options: &SegmentTraining, groups: &Groups) -> (Size, SegmenterSettings, UNetConfig) {
    let size = Size::of_spacing(options.spacing_mm);
    let classes = u16::try_from(groups.groups.len()).unwrap_or(u16::MAX);
    let settings = SegmenterSettings {
        patch: [options.patch; 3],
        spacing_mm: size.spacing_mm(),
        orientation: "RAS".to_owned(),
        window_hu: WINDOW_HU,
        range: [0.0, 1.0],
        overlap: 0.5,
        weighting: Weighting::Gaussian,
        table: TABLE.to_owned(),
        classes: (0..=classes).collect(),
    };
    let share = |hu: f64| (hu - WINDOW_HU[0]) / (WINDOW_HU[1] - WINDOW_HU[0]);
    let config = UNetConfig {
        widths: options.widths.clone(),
        classes: dimension(settings.classes.len()),
        narrow: SOFT_TISSUE_HU.map(share),
    };
    (size, settings, config)
}

/// Trains a segmenter, writes it, and judges what was written by patients that it has not seen;
/// `watch` says whether to go on.
///
/// # Errors
/// [`SessionError`]: options that are impossible, a loss that is not finite, a file that can't be written.
pub fn train(
    options: &SegmentTraining,
    watch: &mut dyn FnMut(SegmenterProgress) -> bool,
) -> Result<SegmenterTrained, SessionError> {
    outputs::check(&[("--out", Some(options.out.as_path()))], &[])?;
    if options
        .out
        .extension()
        .is_none_or(|extension| extension != "safetensors")
    {
        let text = format!("--out {}: a .safetensors", options.out.display());
        return Err(SessionError::BadArgument(text));
    }
    let vista = Groups::load("vista3d")?;
    let (size, settings, config) = plan(options, &vista);
    let defect = config.defect().or_else(|| options.training.defect());
    let defect = defect.or_else(|| settings.defect().map(|defect| defect.to_string()));
    if let Some(defect) = defect {
        return Err(SessionError::BadArgument(defect));
    }
    if size.0.iter().any(|side| *side < options.patch) {
        let (patch, sides) = (options.patch, size.0);
        let text = format!("--patch {patch}: at --spacing-mm a scan has {sides:?} voxels");
        return Err(SessionError::BadArgument(text));
    }
    if !options.patch.is_multiple_of(config.multiple()) {
        let (patch, multiple) = (options.patch, config.multiple());
        let text = format!(
            "--patch {patch}: a multiple of {multiple} for a network of {} levels",
            config.widths.len()
        );
        return Err(SessionError::BadArgument(text));
    }
    let mut scans = Vec::new();
    for index in 0..options.patients {
        scans.push(scan(TRAINING_SEEDS + index, size, &vista));
        if !watch(SegmenterProgress::Patient(index + 1)) {
            return Err(SessionError::Interrupted);
        }
    }
    let (mut steps, mut last) = (0, f64::NAN);
    let network = options
        .training
        .run(&config, &settings, &scans, &mut |step, loss| {
            (steps, last) = (step, loss);
            watch(SegmenterProgress::Step(step, loss))
        })?;
    drop(scans);
    save_segmenter(&options.out, &network, &settings)?;
    let groups = judge(options, &vista, size, watch)?;
    let means: Vec<f64> = groups.iter().filter_map(|group| group.mean).collect();
    Ok(SegmenterTrained {
        settings,
        steps,
        loss: last,
        bytes: bytes(&options.out)?,
        mean_dice: mean(&means),
        groups,
    })
}

fn bytes(file: &Path) -> Result<u64, SessionError> {
    let found = std::fs::metadata(file);
    found
        .map(|found| found.len())
        .map_err(|error| SessionError::output(file, error))
}

fn classify(segmenter: &Segmenter, scan: &LabelledScan) -> Result<Vec<u8>, SessionError> {
    let values = scan.hounsfield.iter().map(|value| f32::from(*value));
    let values: Vec<f32> = values.collect();
    let image = Image {
        dims: scan.dims,
        spacing_mm: segmenter.settings().spacing_mm,
        values: &values,
    };
    Ok(segmenter.classify(&image, u64::MAX, &mut |_, _| ())?)
}

/// Dice of the segmenter that was written, by group, on patients that it has not seen, at its own
/// spacing.
fn judge(
    options: &SegmentTraining,
    vista: &Groups,
    size: Size,
    watch: &mut dyn FnMut(SegmenterProgress) -> bool,
) -> Result<Vec<GroupScore>, SessionError> {
    let segmenter = Segmenter::own(&options.out, options.training.device)?;
    let classes = Classes::new(segmenter.settings(), &Groups::load(TABLE)?)?;
    let mut scores = Vec::new();
    for seed in 0..options.validate {
        let scan = scan(seed, size, vista);
        let found = classes.groups_of(&classify(&segmenter, &scan)?);
        scores.push(dice(&found, &scan.classes, vista.groups.len()));
        if !watch(SegmenterProgress::Judged(seed + 1)) {
            break;
        }
    }
    let groups = vista.groups.iter().enumerate();
    let groups = groups.map(|(index, group)| {
        let patients = scores.iter().map(|patient| patient[index]);
        group_score(&group.name, patients.collect())
    });
    Ok(groups.collect())
}

fn group_score(name: &str, dice: Vec<Option<f64>>) -> GroupScore {
    let known: Vec<f64> = dice.iter().flatten().copied().collect();
    GroupScore {
        name: name.to_owned(),
        mean: mean(&known),
        dice,
    }
}
