//! Any LeRobot dataset of v2.0, v2.1 or v3.0, whatever its features are: columns by name, texts,
//! and frames of its cameras.
//!
//! [`Dataset`](super::Dataset) reads datasets with this robot's vectors; this reader is for the
//! import by a mapping, which says which columns mean what. One data file is open at a time, with
//! the columns that were asked for kept as `f64` or text until another file is needed: episodes are
//! read in their order.

use std::{
    collections::BTreeMap,
    io::Cursor,
    path::{Path, PathBuf},
};

use image::{ImageReader, Limits, RgbImage};

use super::{
    CameraSpec, DatasetError,
    error::mismatch,
    layout,
    listed::Listed,
    meta::{self, CHUNK_SIZE},
    png::SIDE_MAX,
    rows::check_episode,
    schema::{EPISODE_INDEX, Feature, IMAGE_PREFIX, Info, VERSION},
    segments::VideoFrames,
    spec::camera_spec,
    table::Table,
};

/// The type that `info.json` gives cameras that are kept as video.
const VIDEO: &str = "video";
/// The column that numbers an episode's tasks.
const TASK_INDEX: &str = "task_index";

/// A dataset that is open for reading.
#[derive(Debug)]
pub(crate) struct Foreign {
    /// `meta/info.json`, for messages.
    info_path: PathBuf,
    info: Info,
    /// The dataset's tasks by `task_index`.
    tasks: BTreeMap<i64, String>,
    /// The episodes that `info.json` counts, in order.
    listed: Vec<Listed>,
    /// The first row of each episode within its file.
    first_rows: Vec<usize>,
    /// The requested cameras: their features and sizes.
    cameras: Vec<CameraSpec>,
    /// The cameras' features, in the order of `cameras`.
    features: Vec<String>,
    /// Frames of those that are kept as video.
    videos: VideoFrames,
    /// None before the first number, text or PNG is read.
    file: Option<OpenFile>,
}

/// The data file that was read last: its columns as far as they were read.
#[derive(Debug)]
struct OpenFile {
    table: Table,
    /// Width and values of each column, over all rows of the file.
    numbers: BTreeMap<String, (usize, Vec<f64>)>,
    /// One text a row.
    texts: BTreeMap<String, Vec<String>>,
}

impl Foreign {
    /// What the folder `dir` says of its features, by name: before any episode is looked at.
    pub(crate) fn features(dir: &Path) -> Result<Vec<String>, DatasetError> {
        let info = meta::read_info(dir)?;
        Ok(info.features.into_iter().map(|(name, _)| name).collect())
    }

    /// Opens the dataset in the folder `dir`; `features` are those of the cameras that will be
    /// read. Reads the tables of `meta` and the frame times of every video; no data file yet.
    pub(crate) fn open(dir: &Path, features: &[String]) -> Result<Self, DatasetError> {
        let info = meta::read_info(dir)?;
        let info_path = meta::info_path(dir);
        check_info(&info_path, &info)?;
        let mut cameras = Vec::new();
        for name in features {
            let found = feature(&info_path, &info, name)?;
            let camera = name.strip_prefix(IMAGE_PREFIX).unwrap_or(name);
            cameras.push(camera_spec(&info_path, camera, found)?);
        }
        let video_features = video_features(&info, features);
        let listed = read_listed(dir, &info, &video_features)?;
        Ok(Self {
            tasks: layout::read_tasks(dir, &info)?,
            videos: VideoFrames::open(features, &video_features, &listed, info.fps)?,
            first_rows: first_rows(&listed),
            features: features.to_vec(),
            info_path,
            info,
            listed,
            cameras,
            file: None,
        })
    }

    pub(crate) const fn fps(&self) -> u32 {
        self.info.fps
    }

    /// The robot's name, if the dataset says it.
    pub(crate) fn robot_type(&self) -> Option<&str> {
        self.info.robot_type.as_deref()
    }

    pub(crate) fn info_path(&self) -> &Path {
        &self.info_path
    }

    pub(crate) const fn episodes(&self) -> usize {
        self.listed.len()
    }

    /// Frames of an episode.
    pub(crate) fn episode_len(&self, episode: usize) -> usize {
        self.listed[episode].len
    }

    /// The file with the rows of an episode.
    pub(crate) fn data_path(&self, episode: usize) -> &Path {
        &self.listed[episode].data
    }

    /// The ranges of episodes that `info.json` calls `name`, as text; see [`Self::is_in_split`].
    /// None if there is no such split.
    pub(crate) fn split(&self, name: &str) -> Option<&str> {
        self.info.splits.get(name).map(String::as_str)
    }

    /// Names of the splits.
    pub(crate) fn split_names(&self) -> Vec<String> {
        self.info.splits.keys().cloned().collect()
    }

    /// Whether the split `name`, ranges `a:b` of episodes with commas between them, has the
    /// episode. An unknown split has no episode.
    ///
    /// # Errors
    /// [`DatasetError::Mismatch`] for a split that is none.
    pub(crate) fn is_in_split(&self, name: &str, episode: usize) -> Result<bool, DatasetError> {
        let Some(text) = self.split(name) else {
            return Ok(false);
        };
        let within = |range: &str| {
            let (from, to) = range.trim().split_once(':')?;
            let (from, to): (usize, usize) = (from.parse().ok()?, to.parse().ok()?);
            Some((from..to).contains(&episode))
        };
        let ranges: Option<Vec<bool>> = text.split(',').map(within).collect();
        let ranges = ranges.ok_or_else(|| {
            let what = format!("splits.{name}");
            mismatch(
                self.info_path.clone(),
                &what,
                text,
                "ranges FROM:TO of episodes",
            )
        })?;
        Ok(ranges.contains(&true))
    }

    /// The names of the numbers in a feature; empty if the dataset names none.
    ///
    /// Nested lists and objects are flattened in their order; an object's keys are sorted by the
    /// parser.
    pub(crate) fn element_names(&self, name: &str) -> Result<Vec<String>, DatasetError> {
        let feature = feature(&self.info_path, &self.info, name)?;
        let mut names = Vec::new();
        collect_names(&feature.names, &mut names);
        Ok(names)
    }

    /// Has the dataset such a feature?
    pub(crate) fn has(&self, name: &str) -> bool {
        self.info.features.iter().any(|(other, _)| other == name)
    }

    /// The numbers of a feature in an episode, row after row, and how many a row has. The whole
    /// column of the file is read once and kept; the episode's part is copied.
    ///
    /// # Errors
    /// [`DatasetError::Missing`] or [`DatasetError::Mismatch`] for a column that is not there, is
    /// no number, has a null, rows of different width, or ends before the episode.
    pub(crate) fn numbers(
        &mut self,
        episode: usize,
        name: &str,
    ) -> Result<(usize, Vec<f64>), DatasetError> {
        let rows = self.rows(episode);
        let file = self.file_of(episode)?;
        let (width, values) = match file.numbers.get(name) {
            Some(known) => known,
            None => {
                let column = file.table.numbers(name)?;
                file.numbers.entry(name.to_owned()).or_insert(column)
            }
        };
        let part = values.get(rows.start * width..rows.end * width);
        let part = part.map(<[f64]>::to_vec);
        let found = values.len() / (*width).max(1);
        part.map(|part| (*width, part))
            .ok_or_else(|| short(&file.table, name, found, rows.end))
    }

    /// The text of each frame of an episode.
    pub(crate) fn texts(
        &mut self,
        episode: usize,
        name: &str,
    ) -> Result<Vec<String>, DatasetError> {
        let rows = self.rows(episode);
        let file = self.file_of(episode)?;
        let values = match file.texts.get(name) {
            Some(known) => known,
            None => {
                let column = file.table.strings(name)?;
                file.texts.entry(name.to_owned()).or_insert(column)
            }
        };
        let found = values.len();
        let part = values.get(rows.clone()).map(<[String]>::to_vec);
        part.ok_or_else(|| short(&file.table, name, found, rows.end))
    }

    /// The dataset's own `task` of each frame of an episode. A number that the table of tasks lacks
    /// is an error, not an empty text.
    pub(crate) fn tasks(&mut self, episode: usize) -> Result<Vec<String>, DatasetError> {
        let (width, numbers) = self.numbers(episode, TASK_INDEX)?;
        let text = |row: &[f64]| {
            #[expect(clippy::cast_possible_truncation, reason = "the column is int64")]
            let number = row.first().map(|&number| number as i64);
            let known = number.and_then(|number| self.tasks.get(&number));
            known.cloned().ok_or_else(|| {
                let path = self.listed[episode].data.clone();
                let found = number.unwrap_or_default();
                mismatch(path, TASK_INDEX, found, "a number of the dataset's tasks")
            })
        };
        numbers.chunks_exact(width.max(1)).map(text).collect()
    }

    /// Width and height of a camera, an index into the features that the dataset was opened with.
    pub(crate) fn camera_size(&self, camera: usize) -> (u32, u32) {
        (self.cameras[camera].width, self.cameras[camera].height)
    }

    /// A frame of an episode by a camera.
    pub(crate) fn rgb(
        &mut self,
        episode: usize,
        frame: usize,
        camera: usize,
    ) -> Result<RgbImage, DatasetError> {
        let (width, height) = self.camera_size(camera);
        let place = [episode, frame];
        if let Some(image) = self.videos.image(camera, place, [width, height])? {
            return Ok(image);
        }
        let row = self.first_rows[episode] + frame;
        let name = self.features[camera].clone();
        let file = self.file_of(episode)?;
        let bytes = file.table.image(&name, row)?;
        let what = format!("{name} in row {row} of {}", file.table.path().display());
        let image = decode(&bytes).map_err(|source| DatasetError::Image { what, source })?;
        if image.dimensions() != (width, height) {
            let found = format!("{} x {}", image.width(), image.height());
            let what = format!("{name} in row {row}");
            let expected = format!("{width} x {height}");
            return Err(file.table.mismatch(&what, found, expected));
        }
        Ok(image)
    }

    /// The rows of an episode within its data file.
    fn rows(&self, episode: usize) -> std::ops::Range<usize> {
        let first = self.first_rows[episode];
        first..first + self.listed[episode].len
    }

    /// All episodes whose data are in the file of `table` must be where the list says.
    fn check_episodes(&self, table: &Table) -> Result<(), DatasetError> {
        let indices = table.integers(EPISODE_INDEX)?;
        for (episode, first) in self.listed.iter().zip(&self.first_rows) {
            if episode.data == table.path() {
                let rows = *first..first.saturating_add(episode.len);
                check_episode(table, episode, episode.start, (&indices, rows))?;
            }
        }
        Ok(())
    }

    /// The file of an episode, opened if it is another one than before; the episode must be in it.
    fn file_of(&mut self, episode: usize) -> Result<&mut OpenFile, DatasetError> {
        let listed = &self.listed[episode];
        if self
            .file
            .as_ref()
            .is_none_or(|file| file.table.path() != listed.data)
        {
            let table = Table::open(&listed.data)?;
            let (numbers, texts) = (BTreeMap::new(), BTreeMap::new());
            let file = OpenFile {
                table,
                numbers,
                texts,
            };
            self.check_episodes(&file.table)?;
            self.file = Some(file);
        }
        // It was opened just now, if it was not before.
        self.file.as_mut().ok_or_else(|| DatasetError::Missing {
            path: self.info_path.clone(),
            name: format!("episode {episode}"),
        })
    }
}

/// Only what the readers take for granted.
///
/// Before v3.0 the path of an episode follows from its number and the size of a chunk; this program
/// builds it with 1000, LeRobot's constant.
fn check_info(path: &Path, info: &Info) -> Result<(), DatasetError> {
    if info.fps == 0 {
        return Err(mismatch(path.to_owned(), "fps", 0, "at least 1"));
    }
    if info.codebase_version != VERSION && info.chunks_size != CHUNK_SIZE {
        let found = info.chunks_size;
        return Err(mismatch(path.to_owned(), "chunks_size", found, CHUNK_SIZE));
    }
    Ok(())
}

/// The description of a feature that must be there.
fn feature<'a>(path: &Path, info: &'a Info, name: &str) -> Result<&'a Feature, DatasetError> {
    let found = info.features.iter().find(|(other, _)| other == name);
    found
        .map(|(_, feature)| feature)
        .ok_or_else(|| DatasetError::Missing {
            path: path.to_owned(),
            name: format!("feature {name}"),
        })
}

/// Names as LeRobot's datasets have them: a list, a list in a list, or lists by what they are of
/// (`motors`, `axes`).
fn collect_names(value: &serde_json::Value, names: &mut Vec<String>) {
    if let Some(text) = value.as_str() {
        names.push(text.to_owned());
    } else if let Some(list) = value.as_array() {
        list.iter().for_each(|part| collect_names(part, names));
    } else if let Some(object) = value.as_object() {
        object.values().for_each(|part| collect_names(part, names));
    }
}

/// Where each episode's rows begin in its file.
fn first_rows(listed: &[Listed]) -> Vec<usize> {
    let mut ends: BTreeMap<&Path, usize> = BTreeMap::new();
    let mut first_rows = Vec::with_capacity(listed.len());
    // In the order of `listed`, which is that of the files' rows.
    for episode in listed {
        let end = ends.entry(episode.data.as_path()).or_insert(0);
        first_rows.push(*end);
        *end = end.saturating_add(episode.len);
    }
    first_rows
}

/// A column that ends before the episode does.
fn short(table: &Table, name: &str, found: usize, expected: usize) -> DatasetError {
    let expected = format!("at least {expected}");
    table.mismatch(name, format!("{found} rows long"), expected)
}

/// Decodes PNG or JPEG whose header may lie.
///
/// The first bytes give the format. Sides beyond [`SIDE_MAX`] are refused before anything is
/// allocated for them.
pub(crate) fn decode(bytes: &[u8]) -> Result<RgbImage, image::ImageError> {
    let mut limits = Limits::default();
    limits.max_image_width = Some(SIDE_MAX);
    limits.max_image_height = Some(SIDE_MAX);
    let mut reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format()?;
    reader.limits(limits);
    Ok(reader.decode()?.into_rgb8())
}

/// Those of `features` that are kept as video.
fn video_features(info: &Info, features: &[String]) -> Vec<String> {
    let of_video = |name: &&String| {
        let found = info.features.iter().find(|(other, _)| other == *name);
        found.is_some_and(|(_, feature)| feature.dtype == VIDEO)
    };
    features.iter().filter(of_video).cloned().collect()
}

/// The episodes that `info` counts, in order.
///
/// More may be listed than counted: those were being written when a recording was cut off. Fewer is
/// an error.
fn read_listed(dir: &Path, info: &Info, videos: &[String]) -> Result<Vec<Listed>, DatasetError> {
    let mut listed = layout::read_episodes(dir, info, videos)?;
    if listed.len() < info.total_episodes {
        let (path, what) = (meta::info_path(dir), "the number of episodes");
        return Err(mismatch(path, what, listed.len(), info.total_episodes));
    }
    listed.truncate(info.total_episodes);
    Ok(listed)
}
