//! Any LeRobot dataset, or a dVRK's raw recordings, by a table of names: into a dataset of this
//! robot.
//!
//! A [`Mapping`] says which numbers give each arm's pose, jaw and command, in which units and which
//! frame. Joints that the source lacks are computed from the poses by the arm's inverse kinematics,
//! so that a pose that the arm can't take is found. All numbers of all episodes are looked at
//! before the first is written.
//!
//! Two passes: the survey reads the numbers, words and label of every episode that is wanted and
//! checks them; then they are read again, with the pictures, and written. So a bad number in the
//! last episode does not leave half a dataset; a bad picture may.

mod arms;
mod csv;
mod lerobot;
mod mapping;
mod raw;
mod recordings;
#[cfg(test)]
mod tests;

use std::path::PathBuf;

use image::RgbImage;
use image::imageops::{self, FilterType};
use serde::Serialize;
use serde_json::json;

use self::arms::{arms_of, read_arms};
use self::lerobot::LerobotRecordings;
use self::mapping::CameraMapping;
use self::raw::RawRecordings;
use self::recordings::{Label, Recordings};
use super::ImportError;
use super::arms::robot_type;
use crate::dataset::{CameraSpec, DatasetSpec, DatasetWriter, FrameRecord, VideoCodec};

pub use self::mapping::{
    AngleUnit, ArmMapping, CameraMapping as MappedCamera, Columns, Format, Frame, LengthUnit,
    Mapping, QuaternionOrder,
};

/// Instructions that a message lists.
const LISTED_MAX: usize = 8;

/// What to import, by which table, to where.
#[derive(Clone, Debug)]
pub struct ImportRequest {
    /// The table of names.
    pub mapping: Mapping,
    /// The folder.
    pub source: PathBuf,
    /// The dataset's folder; a new or an empty one.
    pub out: PathBuf,
    /// What the demonstrations show in words; the source's instruction if not given, which must
    /// then be one.
    pub task: Option<String>,
    /// Only the episodes of this split; all but those of `failure` if not given.
    pub split: Option<String>,
    /// Frames a second of raw recordings; by their timestamps if not given.
    pub fps: Option<u32>,
    /// Width and height that frames are brought to, pixels, each 1 to
    /// [`SIDE_MAX`](crate::dataset::SIDE_MAX).
    pub size: Option<(u32, u32)>,
    /// Keep colour as video.
    pub video: Option<VideoCodec>,
}

/// What was imported.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct MappedSummary {
    /// Arms of the robot.
    pub arms: usize,
    /// The cameras, in the dataset's order.
    pub cameras: Vec<String>,
    /// Frames a second.
    pub fps: u32,
    /// Episodes in the dataset.
    pub episodes: usize,
    /// Frames in them.
    pub frames: usize,
    /// Episodes among them that show a recovery.
    pub recoveries: usize,
    /// Episodes of the source that were left out, by the split.
    pub left_out: usize,
    /// The source's instructions.
    pub instructions: Vec<String>,
}

/// Writes the episodes of `request.source` as the dataset `request.out`. After each `done` gets the
/// number of episodes so far and of all.
///
/// # Errors
/// An [`ImportError`] that names the file, the episode, the mapping's key, the step and what would
/// do. Every number is looked at before anything is written; after a frame that can't be read the
/// episodes before it stay.
pub fn import_mapped(
    request: &ImportRequest,
    done: &mut dyn FnMut(usize, usize),
) -> Result<MappedSummary, ImportError> {
    let (mut recordings, cameras) = open(request)?;
    let survey = Survey::of(request, recordings.as_mut())?;
    let spec = survey.spec(request, recordings.as_mut(), &cameras)?;
    let mut writer = DatasetWriter::create_with(&request.out, &spec, request.video)?;
    writer.describe(json!({
        "trocar": env!("CARGO_PKG_VERSION"),
        "imported_robot_type": recordings.robot_type(),
    }))?;
    for (index, &episode) in survey.episodes.iter().enumerate() {
        copy(
            request,
            &survey,
            recordings.as_mut(),
            episode,
            &spec,
            &mut writer,
        )?;
        let (words, label) = (recordings.words(episode)?, recordings.label(episode)?);
        writer.end_episode_with(json!({
            "source_episode": episode,
            "instruction": words.join(" / "),
            "recovery": label == Label::Recovery,
            "failure": label == Label::Failure,
        }))?;
        done(index + 1, survey.episodes.len());
    }
    let totals = writer.finish()?;
    Ok(MappedSummary {
        arms: spec.arms,
        cameras: spec.cameras.into_iter().map(|camera| camera.name).collect(),
        fps: spec.fps,
        episodes: totals.episodes,
        frames: totals.frames,
        recoveries: survey.recoveries,
        left_out: recordings.episodes() - totals.episodes,
        instructions: survey.instructions,
    })
}

/// The source by its format, and those of the mapping's cameras that it has, which index its
/// frames.
fn open(request: &ImportRequest) -> Result<(Box<dyn Recordings>, Vec<CameraMapping>), ImportError> {
    match request.mapping.format {
        Format::Lerobot if request.fps.is_some() => Err(ImportError::Options(
            "--fps: a LeRobot dataset says its own".to_owned(),
        )),
        Format::Lerobot => {
            let (recordings, cameras) = LerobotRecordings::open(request)?;
            Ok((Box::new(recordings), cameras))
        }
        Format::DvrkRaw => {
            let (recordings, cameras) = RawRecordings::open(request)?;
            Ok((Box::new(recordings), cameras))
        }
    }
}

/// What all episodes are like, found before the first is written.
struct Survey {
    /// Those that are wanted.
    episodes: Vec<usize>,
    /// Those of the first wanted episode; all others must have as many.
    arms: Vec<ArmMapping>,
    recoveries: usize,
    /// Each once, in the order in which they first occur.
    instructions: Vec<String>,
}

impl Survey {
    fn of(request: &ImportRequest, recordings: &mut dyn Recordings) -> Result<Self, ImportError> {
        let mut survey = Self {
            episodes: Vec::new(),
            arms: Vec::new(),
            recoveries: 0,
            instructions: Vec::new(),
        };
        for episode in 0..recordings.episodes() {
            let label = recordings.label(episode)?;
            if is_wanted(request, recordings, episode, label)? {
                survey.recoveries += usize::from(label == Label::Recovery);
                survey.add(request, recordings, episode)?;
            }
        }
        if survey.episodes.is_empty() {
            return Err(ImportError::Empty {
                path: request.source.clone(),
                expected: "episode that is wanted",
            });
        }
        Ok(survey)
    }

    fn add(
        &mut self,
        request: &ImportRequest,
        recordings: &mut dyn Recordings,
        episode: usize,
    ) -> Result<(), ImportError> {
        let arms = arms_of(recordings, episode, &request.mapping)?;
        if self.episodes.is_empty() {
            self.arms = arms;
        } else if self.arms.len() != arms.len() {
            return Err(ImportError::Mismatch {
                place: recordings.place(episode),
                name: "the episode".to_owned(),
                found: format!("has {} arms", arms.len()),
                expected: format!("{}, as the first", self.arms.len()),
            });
        }
        read_arms(recordings, episode, &request.mapping, &self.arms)?;
        for words in recordings.words(episode)? {
            if !self.instructions.contains(&words) {
                self.instructions.push(words);
            }
        }
        self.episodes.push(episode);
        Ok(())
    }

    /// What the dataset will be of.
    fn spec(
        &self,
        request: &ImportRequest,
        recordings: &mut dyn Recordings,
        cameras: &[CameraMapping],
    ) -> Result<DatasetSpec, ImportError> {
        let arms = self.arms.len();
        let mut specs = Vec::new();
        for (index, camera) in cameras.iter().enumerate() {
            let size = match request.size {
                Some(size) => size,
                None => recordings.camera_size(index)?,
            };
            specs.push(camera_spec(camera, arms, size));
        }
        Ok(DatasetSpec {
            fps: recordings.fps(),
            robot_type: robot_type(arms).to_owned(),
            arms,
            task: self.task(request)?,
            cameras: specs,
            intervention: false,
        })
    }

    /// The one text for all episodes.
    fn task(&self, request: &ImportRequest) -> Result<String, ImportError> {
        if let Some(task) = &request.task {
            return Ok(task.clone());
        }
        if let [only] = &self.instructions[..] {
            return Ok(only.clone());
        }
        let listed = self.instructions.iter().take(LISTED_MAX);
        let listed: Vec<String> = listed.map(|words| format!("{words:?}")).collect();
        let more = self.instructions.len().saturating_sub(LISTED_MAX);
        let more = if more > 0 {
            format!(" and {more} more")
        } else {
            String::new()
        };
        Err(ImportError::Options(format!(
            "--task: {} has {} instructions ({}{more}); a dataset here has one",
            request.source.display(),
            self.instructions.len(),
            listed.join(", ")
        )))
    }
}

/// Whether an episode with this label is in the split that is requested; without one, all but
/// failures are.
fn is_wanted(
    request: &ImportRequest,
    recordings: &mut dyn Recordings,
    episode: usize,
    label: Label,
) -> Result<bool, ImportError> {
    let Some(split) = &request.split else {
        return Ok(label != Label::Failure);
    };
    let failed = label == Label::Failure && split != "failure";
    Ok(recordings.is_in_split(split, episode)? && !failed)
}

/// A camera of `width` by `height` pixels in a dataset of so many arms.
fn camera_spec(camera: &CameraMapping, arms: usize, (width, height): (u32, u32)) -> CameraSpec {
    let alone = camera.name_of_one_arm.as_ref().filter(|_| arms == 1);
    CameraSpec {
        name: alone.unwrap_or(&camera.name).clone(),
        width,
        height,
        depth: None,
    }
}

/// The images of all cameras in one step of an episode, as RGB bytes of the sizes that `spec` says.
fn images_of(
    recordings: &mut dyn Recordings,
    [episode, step]: [usize; 2],
    size: Option<(u32, u32)>,
    spec: &DatasetSpec,
) -> Result<Vec<Vec<u8>>, ImportError> {
    let mut images = Vec::with_capacity(spec.cameras.len());
    for (index, camera) in spec.cameras.iter().enumerate() {
        let image = sized(recordings.rgb(episode, step, index)?, size);
        if image.dimensions() != (camera.width, camera.height) {
            return Err(ImportError::Mismatch {
                place: recordings.place(episode),
                name: format!("{} in step {step}", camera.name),
                found: format!("is {} x {}", image.width(), image.height()),
                expected: format!("{} x {} as before", camera.width, camera.height),
            });
        }
        images.push(image.into_raw());
    }
    Ok(images)
}

/// Pushes all steps of an episode; the caller ends it with its note.
fn copy(
    request: &ImportRequest,
    survey: &Survey,
    recordings: &mut dyn Recordings,
    episode: usize,
    spec: &DatasetSpec,
    writer: &mut DatasetWriter,
) -> Result<(), ImportError> {
    let frames = read_arms(recordings, episode, &request.mapping, &survey.arms)?;
    for (step, arms) in frames.iter().enumerate() {
        let images = images_of(recordings, [episode, step], request.size, spec)?;
        let images: Vec<&[u8]> = images.iter().map(Vec::as_slice).collect();
        writer.push_frame(&FrameRecord {
            arms,
            images: &images,
            depth: &[],
        })?;
    }
    Ok(())
}

/// `image`, brought to a size if one is wanted.
///
/// Bilinear over the area that shrinks into a pixel, without regard to the ratio of the sides.
fn sized(image: RgbImage, size: Option<(u32, u32)>) -> RgbImage {
    match size.filter(|&size| size != image.dimensions()) {
        Some((width, height)) => imageops::resize(&image, width, height, FilterType::Triangle),
        None => image,
    }
}
