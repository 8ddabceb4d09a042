//! The import: all episodes are looked at, then each is written.

use serde::Serialize;

use super::arms::{Arms, robot_type};
use super::file::Recording;
use super::names::Names;
use super::pictures::{CameraFrames, Form};
use super::source::{EpisodeAt, cameras, episodes};
use super::{ImportError, ImportOptions, Layout};
use crate::dataset::{CameraSpec, DatasetSpec, DatasetWriter, FrameRecord};

/// What was imported.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ImportSummary {
    /// Arms of the robot.
    pub arms: usize,
    /// The cameras, in the dataset's order.
    pub cameras: Vec<String>,
    /// Episodes in the dataset.
    pub episodes: usize,
    /// Frames in them.
    pub frames: usize,
}

impl ImportOptions {
    /// Channels are swapped for ACT's layout alone, and there only in JPEG.
    fn form(&self) -> Form {
        Form {
            swapped: self.layout == Layout::Act,
            resized: self.size,
        }
    }
}

/// What every episode must be like: arms and cameras.
#[derive(PartialEq)]
struct Shape {
    arms: usize,
    cameras: Vec<CameraSpec>,
}

impl Shape {
    fn described(&self) -> String {
        let cameras: Vec<String> = self.cameras.iter().map(described).collect();
        format!("has {} arms and cameras {}", self.arms, cameras.join(", "))
    }
}

fn described(camera: &CameraSpec) -> String {
    format!("{} ({} x {})", camera.name, camera.width, camera.height)
}

/// Writes all episodes of `options.source` as the dataset `options.out`. After each `done` gets the
/// number of episodes so far and of all.
///
/// # Errors
/// An [`ImportError`] that names the file, the dataset in it, the step and what would do. What an
/// episode's tables and the sizes of its frames can show is found before anything is written; after
/// a frame that can't be read the episodes before it stay.
pub fn import(
    options: &ImportOptions,
    done: &mut dyn FnMut(usize, usize),
) -> Result<ImportSummary, ImportError> {
    let names = Names::of(options)?;
    let episodes = episodes(options)?;
    let shape = survey(options, &names, &episodes)?;
    let spec = DatasetSpec {
        fps: options.fps,
        robot_type: robot_type(shape.arms).to_owned(),
        arms: shape.arms,
        task: options.task.clone(),
        cameras: shape.cameras,
        intervention: false,
    };
    let mut writer = DatasetWriter::create_with(&options.out, &spec, options.video)?;
    for (index, episode) in episodes.iter().enumerate() {
        let recording = episode.open()?;
        copy(&recording, options, &names, &spec, &mut writer)?;
        done(index + 1, episodes.len());
    }
    let totals = writer.finish()?;
    Ok(ImportSummary {
        arms: spec.arms,
        cameras: spec.cameras.into_iter().map(|camera| camera.name).collect(),
        episodes: totals.episodes,
        frames: totals.frames,
    })
}

/// Looks at all that can be judged without reading every frame.
fn survey(
    options: &ImportOptions,
    names: &Names,
    episodes: &[EpisodeAt],
) -> Result<Shape, ImportError> {
    let mut first: Option<Shape> = None;
    for episode in episodes {
        let recording = episode.open()?;
        let arms = Arms::read(&recording, names, &options.chain)?;
        let shape = Shape {
            arms: arms.count,
            cameras: camera_specs(&recording, options, arms.steps)?,
        };
        match &first {
            None => first = Some(shape),
            Some(first) if *first == shape => {}
            Some(first) => {
                let expected = format!("what the first episode {}", first.described());
                return Err(recording.mismatch("the episode", shape.described(), expected));
            }
        }
    }
    first.ok_or_else(|| ImportError::Options("there is no episode".to_owned()))
}

/// The cameras of a recording with their sizes; each must have an image a step.
fn camera_specs(
    recording: &Recording,
    options: &ImportOptions,
    steps: usize,
) -> Result<Vec<CameraSpec>, ImportError> {
    let mut found = Vec::new();
    for (name, path) in cameras(recording, options)? {
        let mut pictures = CameraFrames::open(recording, &path, steps, options.form())?;
        let (width, height) = pictures.size()?;
        found.push(CameraSpec {
            name,
            width,
            height,
            depth: None,
        });
    }
    Ok(found)
}

/// Writes one episode. Its numbers are read a second time: keeping those of all episodes would take
/// more memory than reading costs time.
fn copy(
    recording: &Recording,
    options: &ImportOptions,
    names: &Names,
    spec: &DatasetSpec,
    writer: &mut DatasetWriter,
) -> Result<(), ImportError> {
    let arms = Arms::read(recording, names, &options.chain)?;
    let paths = cameras(recording, options)?;
    let mut pictures = Vec::new();
    for (_, path) in &paths {
        let opened = CameraFrames::open(recording, path, arms.steps, options.form())?;
        pictures.push(opened);
    }
    for (step, arms) in arms.by_step().enumerate() {
        let images = pictures.iter_mut().zip(&spec.cameras);
        let images = images.map(|(pictures, it)| pictures.rgb(step, (it.width, it.height)));
        let images: Result<Vec<&[u8]>, ImportError> = images.collect();
        writer.push_frame(&FrameRecord {
            arms,
            images: &images?,
            depth: &[],
        })?;
    }
    Ok(writer.end_episode()?)
}
