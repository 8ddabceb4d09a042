//! Labels of a CT by a network.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use serde::Serialize;
use tch::Device;

use hal::config::Source;
use trocar_anatomy::ct::Ct;
use trocar_anatomy::grid::Grid;
use trocar_anatomy::groups::Groups;
use trocar_anatomy::nifti::{read_labels, write_labels};
use trocar_anatomy::overlap::dice;
use trocar_nets::segmenter::{BACKGROUND, Image, Segmenter, SegmenterSettings, Weighting};

use super::{SessionError, outputs};
use crate::rt::MonotonicClock;
use hal::TimeNs;

/// Settings of models that are built in: name, path in the repository, text.
const SETTINGS: [(&str, &str, &str); 1] = [(
    "vista3d",
    "config/anatomy/models/vista3d.toml",
    include_str!("../../../../config/anatomy/models/vista3d.toml"),
)];

/// How far voxels of two volumes of one scan may lie apart, mm.
const SAME_PLACE_MM: f64 = 0.01;

/// What to segment, and how.
#[derive(Clone, Debug)]
pub struct Segmentation {
    /// The CT: NIfTI, or a folder with a DICOM series.
    pub ct: PathBuf,
    /// A segmenter of ours (`.safetensors`), or a TorchScript model.
    pub model: PathBuf,
    /// The settings of a TorchScript model: a built-in name, or a file.
    pub settings: Option<String>,
    /// The label volume to write.
    pub out: PathBuf,
    /// Instead of the model's own.
    pub overlap: Option<f64>,
    /// Instead of the model's own.
    pub weighting: Option<Weighting>,
    /// Bound of the sums' memory, bytes.
    pub memory_bytes: u64,
    /// Where the network computes.
    pub device: Device,
    /// Threads on the CPU.
    pub threads: usize,
    /// Labels to compare with, and their table.
    pub against: Option<(PathBuf, String)>,
}

/// A group of the result.
#[derive(Clone, Debug, Serialize)]
pub struct SegmentedGroup {
    /// Its name.
    pub name: String,
    /// Its voxels.
    pub voxels: u64,
    /// Its volume, ml.
    pub volume_ml: f64,
    /// Twice what it has in common with the labels compared with, by what both have; none without
    /// such labels, or if neither has it.
    pub dice: Option<f64>,
}

/// What was found.
#[derive(Clone, Debug, Serialize)]
pub struct Segmented {
    /// The table whose labels were written.
    pub table: String,
    /// Voxels along the axes of the CT's file.
    pub size: [usize; 3],
    /// Its voxel size, mm.
    pub spacing_mm: [f64; 3],
    /// Where its axes lead.
    pub orientation: String,
    /// All groups of the table that the model has classes of.
    pub groups: Vec<SegmentedGroup>,
    /// The mean of the groups' Dice.
    pub mean_dice: Option<f64>,
    /// How long the network took, s.
    pub seconds: f64,
}

/// The settings `name`, of which a file beside `model` is the default.
fn settings(model: &Path, name: Option<&str>) -> Result<SegmenterSettings, SessionError> {
    let beside = model.with_extension("toml");
    let built_in = SETTINGS
        .iter()
        .find(|(built_in, ..)| Some(*built_in) == name);
    let source = match (built_in, name) {
        (Some((_, path, text)), _) => Source::embedded(path, text),
        (None, Some(path)) => Source::read(path)?,
        (None, None) if beside.is_file() => Source::read(&beside.display().to_string())?,
        (None, None) => {
            return Err(SessionError::BadArgument(format!(
                "--model {}: a TorchScript model needs --settings, or {} beside it",
                model.display(),
                beside.display()
            )));
        }
    };
    let settings: SegmenterSettings = source.parse()?;
    match settings.defect() {
        None => Ok(settings),
        Some(defect) => Err(source
            .out_of_range(defect.key, &defect.value, defect.allowed)
            .into()),
    }
}

/// The model of `options`.
fn load(options: &Segmentation) -> Result<Segmenter, SessionError> {
    let own = options
        .model
        .extension()
        .is_some_and(|it| it == "safetensors");
    if own && options.settings.is_some() {
        let text = "--settings are for TorchScript models; a .safetensors has its own";
        return Err(SessionError::BadArgument(text.to_owned()));
    }
    let segmenter = if own {
        Segmenter::own(&options.model, options.device)?
    } else {
        let settings = settings(&options.model, options.settings.as_deref())?;
        Segmenter::script(&options.model, settings, options.device)?
    };
    let found = segmenter.settings();
    let overlap = options.overlap.unwrap_or(found.overlap);
    let weighting = options.weighting.unwrap_or(found.weighting);
    Ok(segmenter.with_windows(overlap, weighting))
}

/// The model's classes as labels and as groups, by class; the last is the background.
pub(super) struct Classes {
    labels: Vec<u16>,
    groups: Vec<u8>,
}

impl Classes {
    pub(super) fn new(settings: &SegmenterSettings, groups: &Groups) -> Result<Self, SessionError> {
        assert!(
            settings.classes.len() <= usize::from(BACKGROUND),
            "classes beyond the background's number"
        );
        let mut classes = Self {
            labels: vec![0; 256],
            groups: vec![0; 256],
        };
        for (index, &label) in settings.classes.iter().enumerate() {
            let group = groups.group_of(label).ok_or_else(|| {
                let table = &groups.table;
                SessionError::BadArgument(format!(
                    "class {index} of the model is label {label}, which {table} does not have"
                ))
            })?;
            classes.labels[index] = label;
            classes.groups[index] = group;
        }
        Ok(classes)
    }

    /// The group of each voxel.
    pub(super) fn groups_of(&self, classes: &[u8]) -> Vec<u8> {
        classes
            .iter()
            .map(|class| self.groups[usize::from(*class)])
            .collect()
    }
}

/// Whether two volumes have the same voxels at the same places.
fn same_place(one: &Grid, other: &Grid) -> bool {
    #[expect(clippy::cast_precision_loss, reason = "sides of a volume")]
    let corners = [0, 1, 2].map(|axis| one.dims[axis] as f64);
    let steps = (0..3)
        .map(|axis| (one.steps.column(axis) - other.steps.column(axis)).norm() * corners[axis]);
    one.dims == other.dims
        && steps.fold((one.origin - other.origin).norm(), f64::max) < SAME_PLACE_MM
}

/// Writes the labels of a CT; calls `done` with the windows that are classified and all.
///
/// # Errors
/// [`SessionError`]: the CT, the model, its settings or the labels compared with can't be used, or the result can't be written.
pub fn segment(
    options: &Segmentation,
    done: &mut dyn FnMut(usize, usize),
) -> Result<Segmented, SessionError> {
    let sources = [
        ("the CT", Some(options.ct.as_path())),
        ("--model", Some(options.model.as_path())),
        (
            "--against",
            options.against.as_ref().map(|(path, _)| path.as_path()),
        ),
        ("--settings", options.settings.as_deref().map(Path::new)),
    ];
    outputs::check(&[("--out", Some(options.out.as_path()))], &sources)?;
    tch::set_num_threads(i32::try_from(options.threads).unwrap_or(i32::MAX));
    let segmenter = load(options)?;
    let settings = segmenter.settings();
    let groups = Groups::load(&settings.table)?;
    let classes = Classes::new(settings, &groups)?;
    let Ct { grid, hounsfield } = Ct::read(&options.ct)?;
    let wanted = compared(options, &grid)?;
    let turn = grid.turn_to(&settings.orientation).ok_or_else(|| {
        SessionError::BadArgument(format!(
            "orientation = {} is not three directions",
            settings.orientation
        ))
    })?;
    let turned = turn.turned(&hounsfield);
    drop(hounsfield);
    let image = Image {
        dims: turn.of(grid.dims),
        spacing_mm: turn.of(grid.spacing()),
        values: &turned,
    };
    let clock = MonotonicClock::new();
    let start = clock.now();
    let found = turn.back(&segmenter.classify(&image, options.memory_bytes, done)?);
    let seconds = TimeNs(clock.now().since(start)).seconds();
    write_labels(&options.out, &grid, &found, &classes.labels)?;
    let found = classes.groups_of(&found);
    let groups = report(&groups, &classes, &grid, &found, wanted.as_deref());
    let scores: Vec<f64> = groups.iter().filter_map(|group| group.dice).collect();
    Ok(Segmented {
        table: settings.table.clone(),
        size: grid.dims,
        spacing_mm: grid.spacing(),
        orientation: grid.orientation(),
        mean_dice: mean(&scores),
        groups,
        seconds,
    })
}

/// The groups of the labels to compare with.
fn compared(options: &Segmentation, grid: &Grid) -> Result<Option<Vec<u8>>, SessionError> {
    let Some((path, table)) = &options.against else {
        return Ok(None);
    };
    let labels = read_labels(path, &Groups::load(table)?)?;
    if same_place(&labels.grid, grid) {
        return Ok(Some(labels.voxels));
    }
    let text = format!(
        "--against {}: its voxels are not where the CT's are",
        path.display()
    );
    Err(SessionError::BadArgument(text))
}

/// How many voxels each group has.
fn count(found: &[u8]) -> BTreeMap<u8, u64> {
    let mut counts = BTreeMap::new();
    for group in found {
        *counts.entry(*group).or_insert(0) += 1;
    }
    counts
}

#[expect(clippy::cast_precision_loss, reason = "voxels stay far below 2^53")]
fn report(
    groups: &Groups,
    classes: &Classes,
    grid: &Grid,
    found: &[u8],
    wanted: Option<&[u8]>,
) -> Vec<SegmentedGroup> {
    let counts = count(found);
    let scores = wanted.map(|wanted| dice(found, wanted, groups.groups.len()));
    let named = (1..).zip(&groups.groups);
    let named = named.filter(|(number, _)| classes.groups.contains(number));
    named
        .map(|(number, group)| {
            let voxels = counts.get(&number).copied().unwrap_or(0);
            SegmentedGroup {
                name: group.name.clone(),
                voxels,
                volume_ml: voxels as f64 * grid.voxel_mm3() * 1e-3,
                dice: scores
                    .as_ref()
                    .and_then(|scores| scores[usize::from(number) - 1]),
            }
        })
        .collect()
}

/// The mean; none of nothing.
#[expect(clippy::cast_precision_loss, reason = "a handful of groups")]
pub(super) fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}
