//! Recording: frames are kept in memory until their episode ends, then the episode is made durable
//! at once.

mod resume;

use std::{
    fs::{self, File, TryLockError},
    path::{Path, PathBuf},
    sync::Arc,
};

use arrow_array::RecordBatch;
use arrow_schema::Schema;
use parquet::errors::ParquetError;
use serde_json::{Map, Value};

use super::{
    CameraSpec, DatasetError, DatasetSpec, FrameRecord, VideoCodec,
    check::{check_arms, check_spec, check_video, input},
    depth,
    encoder::Encoder,
    episode::{Pending, columns, index_value, timestamp_s},
    meta::{self, CHUNK_SIZE, EpisodeRow},
    notes::Notes,
    pages::data_properties,
    png::encode_rgb,
    schema::{
        self, ACTION, CAMERA_POSE_PREFIX, INTERVENTION, STATE, TIMESTAMP, TIP_POSE, image_feature,
    },
    stats::{ColumnStats, ImageStats},
    store::{io_error, parquet_error, write_json, write_parquet},
};

/// Every how many frames of an episode an image counts for the statistics.
const IMAGE_STATS_STRIDE: usize = 10;

/// Rows that are handed to the parquet writer together; keeps image offsets far below 2 GiB.
const BATCH_ROWS: usize = 64;

/// How much a recording holds.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Totals {
    /// Finished episodes.
    pub episodes: usize,
    /// Frames in them.
    pub frames: usize,
}

impl Totals {
    /// Of the dataset in the folder `dir`, as its description says.
    ///
    /// # Errors
    /// A [`DatasetError`] if that can't be read.
    pub fn read(dir: &Path) -> Result<Self, DatasetError> {
        let info = meta::read_info(dir)?;
        Ok(Self {
            episodes: info.total_episodes,
            frames: info.total_frames,
        })
    }
}

/// Records a dataset, an episode at a time.
///
/// After each [`end_episode`](Self::end_episode) the folder is a whole dataset; dropping the writer
/// loses no more than the frames pushed since.
#[derive(Debug)]
pub struct DatasetWriter {
    dir: PathBuf,
    spec: DatasetSpec,
    video: Option<VideoCodec>,
    schema: Arc<Schema>,
    episodes: Vec<EpisodeRow>,
    frame_count: usize,
    column_stats: Vec<(String, ColumnStats)>,
    image_stats: Vec<ImageStats>,
    pending: Pending,
    notes: Notes,
    /// The videos of the episode in progress, by camera.
    encoders: Vec<Encoder>,
    /// Keeps other recordings out of the folder; none where the file system has no locks.
    _lock: Option<FolderLock>,
}

impl DatasetWriter {
    /// Starts a recording in `dir`, which must not exist or be an empty folder.
    ///
    /// # Errors
    /// [`DatasetError::Exists`], [`DatasetError::Input`] for a specification that can't be stored,
    /// or [`DatasetError::Io`].
    pub fn create(dir: &Path, spec: &DatasetSpec) -> Result<Self, DatasetError> {
        Self::create_with(dir, spec, None)
    }

    /// As [`Self::create`]; the cameras' colour is kept as video if a codec is given, through the
    /// system's ffmpeg, which is looked for with the first frame. Depth and instance ids are
    /// lossless all the same.
    ///
    /// # Errors
    /// Those of [`Self::create`]; [`DatasetError::Input`] for sides that are odd, which the codecs
    /// can't do.
    pub fn create_with(
        dir: &Path,
        spec: &DatasetSpec,
        video: Option<VideoCodec>,
    ) -> Result<Self, DatasetError> {
        check(spec, video)?;
        fs::create_dir_all(dir).map_err(io_error(dir))?;
        if fs::read_dir(dir).map_err(io_error(dir))?.next().is_some() {
            return Err(DatasetError::Exists {
                path: dir.to_owned(),
            });
        }
        let writer = Self::empty(dir, spec, video)?;
        meta::write_task(dir, &spec.task)?;
        writer.commit()?;
        Ok(writer)
    }

    /// Without an episode; locks the folder, in which it writes nothing yet.
    fn empty(
        dir: &Path,
        spec: &DatasetSpec,
        video: Option<VideoCodec>,
    ) -> Result<Self, DatasetError> {
        let lock = lock(dir)?;
        Ok(Self {
            dir: dir.to_owned(),
            spec: spec.clone(),
            video,
            schema: Arc::new(schema::data_schema(spec, video)),
            episodes: Vec::new(),
            frame_count: 0,
            column_stats: column_stats(spec, video),
            image_stats: vec![ImageStats::new(); spec.cameras.len()],
            pending: Pending::new(spec),
            notes: Notes::default(),
            encoders: Vec::new(),
            _lock: lock,
        })
    }

    /// Says in `info.json` how the whole recording came about.
    ///
    /// # Errors
    /// What the file system says.
    pub fn describe(&mut self, recording: Value) -> Result<(), DatasetError> {
        self.notes.recording = Some(recording);
        self.commit()
    }

    /// Keeps the recording's options, all that one which goes on with it must have too, in a file
    /// that LeRobot does not look at.
    ///
    /// # Errors
    /// What the file system says.
    pub fn keep_options(&mut self, options: Value) -> Result<(), DatasetError> {
        self.notes.options = Some(options);
        self.notes.write_options(&self.dir)
    }

    /// Adds a frame to the episode in progress; encodes its images.
    ///
    /// # Errors
    /// [`DatasetError::Input`] for a number that is not finite, another number of arms, or images
    /// that don't fit the cameras. The frame is then not added. [`DatasetError::Video`] if ffmpeg
    /// fails; the episode in progress is then lost.
    pub fn push_frame(&mut self, frame: &FrameRecord<'_>) -> Result<(), DatasetError> {
        self.push_frame_of(frame, false)
    }

    /// Adds the images of the coming frame to the statistics, if it is one of those that count.
    fn count_colours(&mut self, images: &[&[u8]]) {
        if self.pending_frames().is_multiple_of(IMAGE_STATS_STRIDE) {
            for (stats, rgb) in self.pending.image_stats.iter_mut().zip(images) {
                stats.add(rgb);
            }
        }
    }

    /// As [`Self::push_frame`], saying whether an operator drove; kept if
    /// [`DatasetSpec::intervention`] says so.
    ///
    /// # Errors
    /// Those of [`Self::push_frame`].
    pub fn push_frame_of(
        &mut self,
        frame: &FrameRecord<'_>,
        intervention: bool,
    ) -> Result<(), DatasetError> {
        check_arms(&self.spec, frame.arms)?;
        self.check_images(frame.images)?;
        let depth = depth::encode(&self.spec, frame.depth)?;
        let pngs = match self.video {
            None => self.encode(frame.images)?,
            Some(codec) => {
                if let Err(error) = self.film(frame.images, codec) {
                    self.discard_episode();
                    return Err(error);
                }
                Vec::new()
            }
        };
        self.count_colours(frame.images);
        self.pending.push(frame.arms, intervention);
        self.pending.push_images(pngs, depth);
        Ok(())
    }

    /// Frames pushed since the last episode ended.
    #[must_use]
    pub const fn pending_frames(&self) -> usize {
        self.pending.frame_count()
    }

    /// What is finished.
    #[must_use]
    pub const fn totals(&self) -> Totals {
        Totals {
            episodes: self.episodes.len(),
            frames: self.frame_count,
        }
    }

    /// Finishes the episode in progress: once this returns, it survives a power cut.
    ///
    /// # Errors
    /// [`DatasetError::Input`] without a frame; otherwise what the file system says, and the
    /// episode is lost.
    pub fn end_episode(&mut self) -> Result<(), DatasetError> {
        let len = self.pending_frames();
        if len == 0 {
            return Err(input("the episode", "without frames", "at least one"));
        }
        let pending = std::mem::replace(&mut self.pending, Pending::new(&self.spec));
        let index = self.episodes.len();
        let (chunk, file) = file_of(index);
        let row = EpisodeRow {
            index,
            start: self.frame_count,
            len,
            chunk,
            file,
        };
        for encoder in std::mem::take(&mut self.encoders) {
            encoder.finish()?;
        }
        self.write_data(&row, &pending)?;
        self.episodes.push(row);
        self.frame_count += len;
        self.add_stats(&row, &pending);
        self.commit()
    }

    /// [`Self::end_episode`], saying how the episode came about: `note`, an object.
    ///
    /// # Errors
    /// Those of [`Self::end_episode`].
    pub fn end_episode_with(&mut self, note: Value) -> Result<(), DatasetError> {
        let index = self.episodes.len();
        self.notes.add(index, note);
        let ended = self.end_episode();
        if self.episodes.len() == index {
            self.notes.episodes.pop();
        }
        ended
    }

    /// Forgets the episode in progress.
    pub fn discard_episode(&mut self) {
        self.encoders.clear();
        self.pending = Pending::new(&self.spec);
    }

    /// Ends the recording.
    ///
    /// # Errors
    /// [`DatasetError::Input`] while an episode is in progress: end or discard it first.
    pub fn finish(self) -> Result<Totals, DatasetError> {
        match self.pending_frames() {
            0 => Ok(self.totals()),
            count => Err(input(
                "the episode in progress",
                &format!("{count} frames long"),
                "ended or discarded",
            )),
        }
    }

    fn check_images(&self, images: &[&[u8]]) -> Result<(), DatasetError> {
        let cameras = &self.spec.cameras;
        if images.len() != cameras.len() {
            let found = format!("{} images", images.len());
            return Err(input(
                "the frame",
                &found,
                &format!("{}, one a camera", cameras.len()),
            ));
        }
        for (camera, rgb) in cameras.iter().zip(images) {
            let what = format!("the image of {}", camera.name);
            if rgb.len() != camera.image_size_bytes() {
                let expected = format!(
                    "{} for {} x {} RGB",
                    camera.image_size_bytes(),
                    camera.width,
                    camera.height
                );
                return Err(input(&what, &format!("{} bytes", rgb.len()), &expected));
            }
        }
        Ok(())
    }

    fn encode(&self, images: &[&[u8]]) -> Result<Vec<Vec<u8>>, DatasetError> {
        let encode = |(camera, rgb): (&CameraSpec, &&[u8])| {
            encode_rgb(rgb, camera.width, camera.height).map_err(|source| {
                let what = format!("the image of {}", camera.name);
                DatasetError::Image { what, source }
            })
        };
        self.spec.cameras.iter().zip(images).map(encode).collect()
    }

    /// Adds a frame to the videos, which begin with the episode.
    fn film(&mut self, images: &[&[u8]], codec: VideoCodec) -> Result<(), DatasetError> {
        if self.encoders.is_empty() {
            let (chunk, file) = file_of(self.episodes.len());
            for camera in &self.spec.cameras {
                let feature = image_feature(&camera.name);
                let path = meta::video_path(&self.dir, &feature, chunk, file);
                let encoder = Encoder::start(&path, camera, self.spec.fps, codec)?;
                self.encoders.push(encoder);
            }
        }
        for (encoder, rgb) in self.encoders.iter_mut().zip(images) {
            encoder.push(rgb)?;
        }
        Ok(())
    }

    fn write_data(&self, row: &EpisodeRow, pending: &Pending) -> Result<(), DatasetError> {
        let path = meta::data_path(&self.dir, row.chunk, row.file);
        let batch = |first: usize| {
            let frames = first..(first + BATCH_ROWS).min(row.len);
            RecordBatch::try_new(
                Arc::clone(&self.schema),
                columns(row, pending, frames, self.spec.fps),
            )
            .map_err(ParquetError::from)
            .map_err(parquet_error(&path))
        };
        let batches = (0..row.len).step_by(BATCH_ROWS).map(batch);
        write_parquet(&path, &self.schema, data_properties(&self.spec), batches)
    }

    fn add_stats(&mut self, row: &EpisodeRow, pending: &Pending) {
        for (name, stats) in &mut self.column_stats {
            match name.as_str() {
                STATE => stats.extend(pending.frame_rows(&pending.state)),
                TIP_POSE => stats.extend(pending.frame_rows(&pending.tip_pose)),
                ACTION => stats.extend(pending.frame_rows(&pending.action)),
                INTERVENTION => {
                    let rows = pending.intervention.iter().flatten();
                    stats.extend(rows.map(|&by_hand| [f64::from(u8::from(by_hand))]));
                }
                TIMESTAMP => stats.extend(
                    (0..row.len).map(|frame| [f64::from(timestamp_s(frame, self.spec.fps))]),
                ),
                name if name.starts_with(CAMERA_POSE_PREFIX) => {
                    let camera = &name[CAMERA_POSE_PREFIX.len()..];
                    let mut cameras = self.spec.depth_cameras().zip(&pending.depth);
                    if let Some((_, columns)) = cameras.find(|((other, _), _)| other.name == camera)
                    {
                        stats.extend(columns.camera_in_scene.iter().copied());
                    }
                }
                #[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
                name => {
                    stats.extend((0..row.len).map(|frame| [index_value(name, row, frame) as f64]))
                }
            }
        }
        for (total, episode) in self.image_stats.iter_mut().zip(&pending.image_stats) {
            total.merge(episode);
        }
    }

    /// Writes what describes the finished episodes; `info.json` last, since its total says how many
    /// count.
    fn commit(&self) -> Result<(), DatasetError> {
        let mut stats = Map::new();
        let columns = self
            .column_stats
            .iter()
            .map(|(name, stats)| (name.clone(), stats.to_json()));
        let images = self.spec.cameras.iter().zip(&self.image_stats);
        let images = images.map(|(camera, stats)| (image_feature(&camera.name), stats.to_json()));
        stats.extend(
            columns
                .chain(images)
                .filter_map(|(name, value)| Some((name, value?))),
        );
        write_json(&meta::stats_path(&self.dir), &Value::Object(stats))?;
        let cameras = self.spec.cameras.iter().filter(|_| self.video.is_some());
        let videos: Vec<String> = cameras.map(|camera| image_feature(&camera.name)).collect();
        let (task, fps) = (&self.spec.task, self.spec.fps);
        meta::write_episodes(&self.dir, task, fps, &videos, &self.episodes)?;
        let (episodes, frames) = (self.episodes.len(), self.frame_count);
        self.notes.write_episodes(&self.dir)?;
        let recording = self.notes.recording.clone();
        let info = meta::info(&self.spec, self.video, episodes, frames, recording);
        meta::write_info(&self.dir, &info)
    }
}

/// Only what can be stored.
fn check(spec: &DatasetSpec, video: Option<VideoCodec>) -> Result<(), DatasetError> {
    check_spec(spec)?;
    match video {
        Some(_) => check_video(spec),
        None => Ok(()),
    }
}

/// A locked folder. A process that another thread starts meanwhile holds a copy of the file for a
/// moment, so that closing ours alone would not end the lock.
#[derive(Debug)]
struct FolderLock(File);

impl Drop for FolderLock {
    fn drop(&mut self) {
        let _unlocked = self.0.unlock();
    }
}

/// Locks `dir` by its folder `meta`, which is made.
fn lock(dir: &Path) -> Result<Option<FolderLock>, DatasetError> {
    let path = dir.join("meta");
    fs::create_dir_all(&path).map_err(io_error(&path))?;
    let folder = File::open(&path).map_err(io_error(&path))?;
    match folder.try_lock() {
        Ok(()) => Ok(Some(FolderLock(folder))),
        Err(TryLockError::WouldBlock) => Err(DatasetError::Busy {
            path: dir.to_owned(),
        }),
        // Some network file systems have no locks of folders.
        Err(TryLockError::Error(_)) => Ok(None),
    }
}

/// Folder and file of an episode, which has files of its own.
const fn file_of(index: usize) -> (usize, usize) {
    (index / CHUNK_SIZE, index % CHUNK_SIZE)
}

/// Empty statistics of each column of numbers.
fn column_stats(spec: &DatasetSpec, video: Option<VideoCodec>) -> Vec<(String, ColumnStats)> {
    schema::features(spec, video)
        .into_iter()
        .filter(|(_, feature)| feature.dtype != "image" && feature.dtype != "video")
        .map(|(name, feature)| (name, ColumnStats::new(feature.shape[0])))
        .collect()
}
