//! Where demonstrations go: those that succeeded into the dataset, those that failed, if they are
//! wanted, into one of their own.

use std::path::{Path, PathBuf};

use serde_json::Value;
use trocar_data::dataset::{DatasetError, DatasetSpec, DatasetWriter, DepthFrame, FrameRecord};
use trocar_tasks::task::Outcome;

use super::notes::{failures_note, value};
use super::resume::{Found, begin};
use super::{Demonstration, RecordOptions, unwritten};
use crate::session::{Plan, SessionError, outputs};

/// The datasets of a recording.
pub(super) struct Datasets {
    kept: DatasetWriter,
    failures: Option<Failures>,
}

struct Failures {
    dir: PathBuf,
    writer: DatasetWriter,
}

/// Checks that failures can be kept, and makes their folder.
///
/// # Errors
/// [`SessionError::BadArgument`] if the recording is one that goes on, or the folder is not empty.
pub(super) fn check(options: &RecordOptions) -> Result<(), SessionError> {
    match &options.failures {
        Some(_) if options.resume => Err(SessionError::BadArgument(
            "--failures: not with --resume, which would record those behind the last success once more"
                .to_owned(),
        )),
        Some(dir) => {
            let (out, failures) = (outputs::identity(&options.out), outputs::identity(dir));
            if out.starts_with(&failures) || failures.starts_with(&out) {
                return Err(SessionError::BadArgument(format!(
                    "--failures {}: neither may be in the other, nor the same as --out",
                    dir.display()
                )));
            }
            outputs::new_folder("--failures", dir)
        }
        None => Ok(()),
    }
}

impl Datasets {
    /// Creates the dataset, or opens the one to go on with, behind what was `found` there; creates
    /// that of the failures.
    ///
    /// # Errors
    /// Those of [`begin`].
    pub(super) fn begin(
        plan: &Plan,
        options: &RecordOptions,
        found: &Found,
        spec: &DatasetSpec,
    ) -> Result<Self, SessionError> {
        let kept = begin(plan, options, found, spec)?;
        let failures = match &options.failures {
            Some(dir) => {
                let mut writer = DatasetWriter::create_with(dir, spec, options.video)?;
                writer.describe(failures_note(plan, options)?)?;
                let dir = dir.clone();
                Some(Failures { dir, writer })
            }
            None => None,
        };
        Ok(Self { kept, failures })
    }

    /// Writes a demonstration that succeeded, and one that failed with its reason if those are
    /// kept.
    ///
    /// # Errors
    /// [`SessionError::Output`] if a file can't be written.
    pub(super) fn keep(
        &mut self,
        options: &RecordOptions,
        demo: &Demonstration,
    ) -> Result<(), SessionError> {
        let mut note = value(options, &demo.note)?;
        if demo.succeeded() {
            let written = write(&mut self.kept, demo, note);
            return written.map_err(|error| unwritten(options, error));
        }
        // Of the simulation's own faults nobody learns anything.
        let says_nothing = matches!(demo.outcome, Outcome::Invalid(_)) || demo.frames.is_empty();
        let Some(failures) = self.failures.as_mut().filter(|_| !says_nothing) else {
            return Ok(());
        };
        note["failure"] = Value::from(demo.reason.clone());
        let written = write(&mut failures.writer, demo, note);
        written.map_err(|error| failure_unwritten(&failures.dir, error))
    }

    /// Ends the recording. How many failures were kept, if they were to be.
    ///
    /// # Errors
    /// Those of [`DatasetWriter::finish`].
    pub(super) fn finish(self) -> Result<Option<usize>, SessionError> {
        self.kept.finish()?;
        let failures = self.failures.map(|failures| failures.writer.finish());
        Ok(failures.transpose()?.map(|totals| totals.episodes))
    }
}

fn failure_unwritten(dir: &Path, error: DatasetError) -> SessionError {
    if let DatasetError::Io { path, source } = &error {
        SessionError::output(path, source)
    } else if let DatasetError::Parquet { path, source } = &error {
        SessionError::output(path, source)
    } else if let DatasetError::Video { .. } = error {
        SessionError::output(dir, error)
    } else {
        error.into()
    }
}

fn write(
    writer: &mut DatasetWriter,
    demo: &Demonstration,
    note: Value,
) -> Result<(), DatasetError> {
    for frame in &demo.frames {
        let images: Vec<&[u8]> = frame.images.iter().map(Vec::as_slice).collect();
        let depth: Vec<DepthFrame<'_>> = frame
            .depth
            .iter()
            .map(|depth| DepthFrame {
                units: &depth.units,
                instance: &depth.instance,
                camera_in_scene: depth.camera_in_scene,
            })
            .collect();
        let record = FrameRecord {
            arms: &frame.arms,
            images: &images,
            depth: &depth,
        };
        writer.push_frame_of(&record, frame.by_hand)?;
    }
    writer.end_episode_with(note)
}
