//! The verbs `anatomy segment` and `anatomy train-segmenter`.

use std::path::{Path, PathBuf};

use clap::{Args, ValueEnum};

use trocar::session::run::write_json;
use trocar::session::segment::{self, Segmentation, SegmentedGroup};
use trocar::session::segment_training::{self, SegmentTraining, SegmenterProgress};
use trocar::session::{SessionError, outputs};
use trocar_nets::segmenter::Weighting;
use trocar_train::SegmenterTraining;

use crate::args::{ComputeDevice, between, threads};
use crate::commands::{Done, device};
use crate::console;

/// Options of `anatomy segment`.
#[derive(Args, Debug)]
pub(crate) struct SegmentArgs {
    /// The CT: NIfTI (.nii or .nii.gz), or a folder with one DICOM series.
    #[arg(value_name = "CT")]
    ct: PathBuf,
    /// The model: a .safetensors of `train-segmenter`, or a TorchScript file.
    #[arg(long, value_name = "FILE")]
    model: PathBuf,
    /// What a TorchScript model wants to be shown and what its classes are: vista3d, or a file;
    /// MODEL with .toml at its end if not given.
    #[arg(long, value_name = "NAME|FILE")]
    settings: Option<String>,
    /// The label volume, .nii or .nii.gz; parent folders are made.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Share of a window that the next one covers again, 0 to 0.9; the model's own if not given.
    #[arg(long, value_name = "SHARE", value_parser = overlap)]
    overlap: Option<f64>,
    /// How overlapping windows are weighted; the model's own if not given.
    #[arg(long, value_enum)]
    weighting: Option<WindowWeighting>,
    /// Bound of the memory for scores, GB, 0.001 to 1000: what exceeds it is done in strips. The
    /// network's own memory for a window is not counted.
    #[arg(long, value_name = "GB", default_value_t = 4.0, value_parser = memory_gb)]
    memory_gb: f64,
    /// Where the network computes.
    #[arg(long, value_enum, default_value = "cpu")]
    device: ComputeDevice,
    /// Threads on the CPU.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = threads())]
    threads: usize,
    /// Compare with these labels of the same scan: Dice a group.
    #[arg(long, value_name = "LABELS")]
    against: Option<PathBuf>,
    /// Which of their labels is which tissue group: vista3d, totalsegmentator, groups, or a file.
    #[arg(
        long,
        value_name = "NAME|FILE",
        default_value = "vista3d",
        requires = "against"
    )]
    against_groups: String,
    /// Write what was found as JSON, to standard output if it is `-`; parent folders are made.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
}

/// How overlapping windows are weighted.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
enum WindowWeighting {
    /// The middle of a window more than its rim.
    Gaussian,
    /// All voxels of a window alike.
    Constant,
}

/// Options of `anatomy train-segmenter`.
#[derive(Args, Debug)]
pub(crate) struct TrainSegmenterArgs {
    /// The file, .safetensors; parent folders are made.
    #[arg(long, value_name = "FILE")]
    out: PathBuf,
    /// Voxel size that the network sees, mm, 1 to 12.
    #[arg(long, value_name = "MM", default_value_t = 3.0, value_parser = spacing_mm)]
    spacing_mm: f64,
    /// Voxels along each side of a window, a multiple of 2 for each level.
    #[arg(long, value_name = "N", default_value_t = 96, value_parser = clap::value_parser!(u64).range(8..=256))]
    patch: u64,
    /// Channels of the network's levels, multiples of 8, with commas between them.
    #[arg(long, value_name = "CHANNELS", value_delimiter = ',', default_values_t = [32, 64, 128, 128])]
    widths: Vec<i64>,
    /// Procedural patients to train on, 1 to 10000.
    #[arg(long, value_name = "N", default_value_t = 200, value_parser = clap::value_parser!(u64).range(1..=10_000))]
    patients: u64,
    /// Patients that it has not seen to judge it by, 0 to 1000: those of the seeds from 0.
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u64).range(0..=1000))]
    validate: u64,
    /// Steps of the optimiser.
    #[arg(long, value_name = "N", default_value_t = 8000, value_parser = clap::value_parser!(u64).range(1..))]
    steps: u64,
    /// Windows in a step, 1 to 64.
    #[arg(long, value_name = "N", default_value_t = 2, value_parser = clap::value_parser!(u64).range(1..=64))]
    batch: u64,
    /// Greatest learning rate.
    #[arg(long, value_name = "RATE", default_value_t = 2e-3)]
    lr: f64,
    /// Random seed: on the CPU with the same threads the same seed gives the same file.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Where the network computes.
    #[arg(long, value_enum, default_value = "cpu")]
    device: ComputeDevice,
    /// Threads on the CPU.
    #[arg(long, value_name = "N", default_value_t = 1, value_parser = threads())]
    threads: usize,
    /// Write what came of it as JSON, to standard output if it is `-`; parent folders are made.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
}

fn overlap(text: &str) -> Result<f64, String> {
    between(text, 0.0, 0.9)
}

fn memory_gb(text: &str) -> Result<f64, String> {
    between(text, 0.001, 1000.0)
}

fn spacing_mm(text: &str) -> Result<f64, String> {
    between(text, 1.0, 12.0)
}

/// `trocar anatomy segment`. The table at the end has the volume of each tissue group and, with
/// `--against`, its Dice coefficient.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "between 0.001 and 1000 GB"
)]
pub(crate) fn segment(args: &SegmentArgs) -> Done {
    let written = [
        ("--json", args.json.as_deref()),
        ("--out", Some(args.out.as_path())),
    ];
    let read = [
        ("the CT", Some(args.ct.as_path())),
        ("--model", Some(args.model.as_path())),
        ("--against", args.against.as_deref()),
        ("--settings", args.settings.as_deref().map(Path::new)),
    ];
    outputs::check(&written, &read)?;
    if !args
        .out
        .to_str()
        .is_some_and(|name| name.ends_with(".nii") || name.ends_with(".nii.gz"))
    {
        let text = format!("--out {}: a .nii or a .nii.gz", args.out.display());
        return Err(SessionError::BadArgument(text));
    }
    let options = Segmentation {
        ct: args.ct.clone(),
        model: args.model.clone(),
        settings: args.settings.clone(),
        out: args.out.clone(),
        overlap: args.overlap,
        weighting: args.weighting.map(|weighting| match weighting {
            WindowWeighting::Gaussian => Weighting::Gaussian,
            WindowWeighting::Constant => Weighting::Constant,
        }),
        memory_bytes: (args.memory_gb * 1e9) as u64,
        device: device(args.device)?,
        threads: args.threads,
        against: args
            .against
            .clone()
            .map(|path| (path, args.against_groups.clone())),
    };
    let bar = console::progress(0, "windows");
    let found = segment::segment(&options, &mut |done, all| {
        bar.set_length(all as u64);
        bar.set_position(done as u64);
    })?;
    bar.finish_and_clear();
    console::result("group         volume ml  Dice");
    for group in &found.groups {
        console::result(&line(group));
    }
    if let Some(dice) = found.mean_dice {
        console::result(&format!("mean Dice {dice:.3}"));
    }
    console::result(&format!(
        "{:.1} s; next: trocar anatomy build {} --groups {} --out DIR",
        found.seconds,
        args.out.display(),
        found.table
    ));
    if let Some(path) = &args.json {
        write_json(path, &found)?;
    }
    Ok(true)
}

/// A row of that table; Dice is empty where it was not measured.
fn line(group: &SegmentedGroup) -> String {
    let dice = group
        .dice
        .map_or_else(String::new, |dice| format!("{dice:.3}"));
    format!("{:<12} {:>10.1}  {dice}", group.name, group.volume_ml)
}

/// `trocar anatomy train-segmenter`: patients are made first, then the network is trained, then
/// judged on patients of other seeds.
pub(crate) fn train(args: &TrainSegmenterArgs) -> Done {
    let written = [
        ("--json", args.json.as_deref()),
        ("--out", Some(args.out.as_path())),
    ];
    outputs::check(&written, &[])?;
    let count = |number: u64| usize::try_from(number).unwrap_or(usize::MAX);
    let options = SegmentTraining {
        out: args.out.clone(),
        spacing_mm: args.spacing_mm,
        patch: count(args.patch),
        widths: args.widths.clone(),
        patients: args.patients,
        validate: args.validate,
        training: SegmenterTraining {
            steps: args.steps,
            batch: count(args.batch),
            lr: args.lr,
            seed: args.seed,
            threads: args.threads,
            device: device(args.device)?,
        },
    };
    let bar = console::progress(args.patients, "patients");
    let trained = segment_training::train(&options, &mut |news| {
        match news {
            SegmenterProgress::Patient(made) => bar.set_position(made),
            SegmenterProgress::Step(step, loss) => {
                bar.set_length(args.steps);
                bar.set_position(step);
                bar.set_message(format!("steps, loss {loss:.3}"));
                if bar.is_hidden() && step.is_multiple_of(200) {
                    console::note(&format!("step {step}: loss {loss:.4}"));
                }
            }
            SegmenterProgress::Judged(patients) => {
                bar.set_length(args.validate);
                bar.set_message("judged");
                bar.set_position(patients);
            }
        }
        true
    })?;
    bar.finish_and_clear();
    for group in &trained.groups {
        let mean = group
            .mean
            .map_or_else(|| "-".to_owned(), |mean| format!("{mean:.3}"));
        console::result(&format!("{:<12} {mean}", group.name));
    }
    if let Some(dice) = trained.mean_dice {
        console::result(&format!(
            "mean Dice {dice:.3} of {} unseen patients",
            args.validate
        ));
    }
    let (steps, loss, bytes) = (trained.steps, trained.loss, trained.bytes);
    console::result(&format!(
        "{}: {bytes} bytes; loss {loss:.3} after {steps} steps",
        args.out.display()
    ));
    if let Some(path) = &args.json {
        write_json(path, &trained)?;
    }
    Ok(true)
}
