//! Patients of scans: the pipeline of `trocar_anatomy` with the times and the memory of its stages.

use std::path::{Path, PathBuf};

use serde::Serialize;

use hal::TimeNs;
use trocar_anatomy::build::{self, Options, Report, Stage};
use trocar_anatomy::groups::Groups;
use trocar_anatomy::phantom::{self, Phantom, Size};

use super::{SessionError, outputs};
use crate::rt::{MonotonicClock, peak_memory};

/// What a stage took.
#[derive(Clone, Debug, Serialize)]
pub struct StageTime {
    /// The stage.
    pub stage: Stage,
    /// How long it took, s.
    pub seconds: f64,
    /// The most memory that this process has had up to its end, MiB.
    pub peak_mib: f64,
}

/// A patient, and what making it took.
#[derive(Clone, Debug, Serialize)]
pub struct Built {
    /// What was made, and how well.
    #[serde(flatten)]
    pub report: Report,
    /// The stages in order.
    pub stages: Vec<StageTime>,
}

/// Times of stages while they pass.
struct Stopwatch {
    clock: MonotonicClock,
    now: Option<(Stage, TimeNs)>,
    done: Vec<StageTime>,
}

impl Stopwatch {
    fn new() -> Self {
        Self {
            clock: MonotonicClock::new(),
            now: None,
            done: Vec::new(),
        }
    }

    /// Ends the stage that goes on, and begins `next`.
    fn pass(&mut self, next: Option<Stage>) {
        let now = self.clock.now();
        if let Some((stage, since)) = self.now {
            self.done.push(StageTime {
                stage,
                seconds: TimeNs(now.since(since)).seconds(),
                peak_mib: peak_mib(),
            });
        }
        self.now = next.map(|next| (next, now));
    }
}

/// The most memory that this process has had, MiB; 0 where the system does not say.
#[expect(clippy::cast_precision_loss, reason = "memory of a process")]
fn peak_mib() -> f64 {
    peak_memory(std::process::id()).unwrap_or(0) as f64 / f64::from(1 << 20)
}

/// Files of a folder that a verb is about to write, with the option that names it.
fn check_outputs(folder: &Path, names: &[&str], source: Option<&Path>) -> Result<(), SessionError> {
    let files: Vec<PathBuf> = names.iter().map(|name| folder.join(name)).collect();
    let written: Vec<(&str, Option<&Path>)> = files
        .iter()
        .map(|file| ("--out", Some(file.as_path())))
        .collect();
    outputs::check(&written, &[("the labels", source)])
}

/// The files of a patient.
const PATIENT_FILES: [&str; 7] = [
    "patient.glb",
    "patient.usda",
    "patient.usdz",
    "patient-textured.glb",
    "patient-textured.usdz",
    "patient.json",
    "tetrahedra.usda",
];

/// Makes a patient of the labels in `source` by the table of labels `table`, and writes it into
/// `out`; calls `watch` with each stage as it begins.
///
/// # Errors
/// [`SessionError::Anatomy`] if the volume is refused, [`SessionError::Config`] if the table is,
/// [`SessionError::BadArgument`] if `out` can't be written.
pub fn build(
    source: &Path,
    table: &str,
    out: &Path,
    options: &Options,
    watch: &mut dyn FnMut(Stage),
) -> Result<Built, SessionError> {
    let groups = Groups::load(table)?;
    check_outputs(out, &PATIENT_FILES, Some(source))?;
    let mut stopwatch = Stopwatch::new();
    let patient = build::build(source, &groups, options, &mut |stage| {
        stopwatch.pass(Some(stage));
        watch(stage);
    })?;
    stopwatch.pass(Some(Stage::Write));
    watch(Stage::Write);
    build::write(&patient, &groups, out)?;
    stopwatch.pass(None);
    Ok(Built {
        report: patient.report,
        stages: stopwatch.done,
    })
}

/// Writes the CT and the labels of the procedural patient of `seed` into `out`; calls `done` with
/// the slices that are written and all.
///
/// # Errors
/// [`SessionError::BadArgument`] or [`SessionError::Anatomy`] if `out` can't be written.
pub fn phantom(
    seed: u64,
    size: [usize; 3],
    out: &Path,
    done: impl FnMut(usize, usize),
) -> Result<Phantom, SessionError> {
    check_outputs(out, &["ct.nii.gz", "labels.nii.gz"], None)?;
    let patient = phantom::Patient::new(seed);
    Ok(phantom::write(&patient, Size(size), out, done)?)
}
