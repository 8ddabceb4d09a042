//! Reading: numbers are loaded at once, images one by one on request.
//!
//! About 176 bytes an arm and frame stay in memory, which is what makes shuffled access to actions
//! free. Images stay in their files, since a dataset of pictures rarely fits. A frame is numbered
//! over the whole dataset, episode after episode; reading one at or beyond [`Dataset::len`] panics,
//! as with slices.

use std::path::Path;

use image::RgbImage;

use super::{
    ACTION_WIDTH, CameraSpec, DatasetError, DatasetSpec, Episode, STATE_WIDTH, TIP_POSE_WIDTH,
    depth::{self, RecordedDepth},
    error::mismatch,
    joined::Part,
    layout,
    listed::Listed,
    meta,
    png::decode_rgb,
    rows::{FileRows, Place, Rows, check_episode},
    schema::{CAMERA_POSE_PREFIX, INTERVENTION, image_feature},
    segments::VideoFrames,
    spec::{read_spec, video_features},
    table::Table,
};

/// A dataset that is open for reading; several threads may share it.
#[derive(Debug)]
pub struct Dataset {
    /// As its `info.json` describes it, reduced to the cameras that were asked for.
    pub(super) spec: DatasetSpec,
    /// The simulator's task, if its recording says so.
    simulated: Option<String>,
    /// The datasets that this one is of; at least one.
    pub(super) parts: Vec<Part>,
    /// Names of `spec.cameras`, without the prefix of their features.
    camera_names: Vec<String>,
    /// In order; `start` counts over all parts.
    pub(super) episodes: Vec<Episode>,
    /// The numbers of all frames.
    pub(super) rows: Rows,
    /// The data files, one entry each; footers only.
    pub(super) tables: Vec<Table>,
    /// Frames of the cameras that are kept as video.
    pub(super) videos: VideoFrames,
}

impl Dataset {
    /// Opens the dataset in the folder `dir` and loads its numbers.
    ///
    /// Every row is checked against the table of episodes, every number for being finite, every
    /// video for having the frames; images are not decoded.
    ///
    /// # Errors
    /// A [`DatasetError`] that names the file: one that is missing, damaged, cut off, of another
    /// version of the format, without a column of the right width, or with a number that is not
    /// finite.
    pub fn open(dir: &Path) -> Result<Self, DatasetError> {
        Self::open_first(dir, None)
    }

    /// Opens the first `episodes` episodes only, or all.
    ///
    /// # Errors
    /// Those of [`Dataset::open`]; and [`DatasetError::Mismatch`] if there are fewer.
    pub fn open_first(dir: &Path, episodes: Option<usize>) -> Result<Self, DatasetError> {
        Self::open_part(dir, episodes, None)
    }

    /// The same with some `cameras` alone, in their order, or all.
    ///
    /// # Errors
    /// Those of [`Dataset::open_first`]; and [`DatasetError::Mismatch`] if there is no such camera.
    pub fn open_part(
        dir: &Path,
        episodes: Option<usize>,
        cameras: Option<&[String]>,
    ) -> Result<Self, DatasetError> {
        let info = meta::read_info(dir)?;
        let mut spec = read_spec(dir, &info)?;
        if let Some(cameras) = cameras {
            spec.cameras = chosen(&spec.cameras, cameras).map_err(|name| {
                let what = "a camera";
                mismatch(
                    meta::info_path(dir),
                    what,
                    names(&spec.cameras).join(", "),
                    name,
                )
            })?;
        }
        let videos = video_features(&info);
        let mut listed = layout::read_episodes(dir, &info, &videos)?;
        let wanted = episodes.unwrap_or(info.total_episodes);
        let available = info.total_episodes.min(listed.len());
        if wanted > available || info.total_episodes > listed.len() {
            let what = "the number of episodes";
            return Err(mismatch(
                meta::info_path(dir),
                what,
                available,
                wanted.max(info.total_episodes),
            ));
        }
        // What is listed beyond the total was being written when the recording was cut off.
        listed.truncate(wanted);
        let camera_names = names(&spec.cameras);
        let features: Vec<String> = camera_names.iter().map(|it| image_feature(it)).collect();
        let noted = info.trocar.as_ref().and_then(|note| note["task"].as_str());
        let simulated = noted.map(str::to_owned);
        let mut dataset = Self {
            videos: VideoFrames::open(&features, &videos, &listed, spec.fps)?,
            camera_names,
            spec,
            simulated,
            parts: Vec::new(),
            episodes: Vec::new(),
            rows: Rows::default(),
            tables: Vec::new(),
        };
        dataset.load(&listed)?;
        dataset.parts.push(Part {
            dir: dir.to_owned(),
            task: dataset.task().to_owned(),
            episodes: dataset.episodes.len(),
            frames: dataset.len(),
        });
        Ok(dataset)
    }

    /// Names of the cameras of the dataset in the folder `dir`: first the one that its task gives
    /// policies of a single camera.
    ///
    /// # Errors
    /// A [`DatasetError`] if its description can't be read.
    pub fn cameras_in(dir: &Path) -> Result<Vec<String>, DatasetError> {
        let info = meta::read_info(dir)?;
        Ok(names(&read_spec(dir, &info)?.cameras))
    }

    /// What the dataset is of.
    #[must_use]
    pub const fn spec(&self) -> &DatasetSpec {
        &self.spec
    }

    /// The name of the simulator's task, if its recording notes one beside an instruction in words;
    /// else what LeRobot's `task` says.
    #[must_use]
    pub fn task(&self) -> &str {
        self.simulated.as_deref().unwrap_or(&self.spec.task)
    }

    /// The datasets that it was [joined](Self::open_joined) from, in their order; itself alone if
    /// it was not.
    #[must_use]
    pub fn parts(&self) -> &[Part] {
        &self.parts
    }

    /// Frames a second.
    #[must_use]
    pub const fn fps(&self) -> u32 {
        self.spec.fps
    }

    /// The episodes in order.
    #[must_use]
    pub fn episodes(&self) -> &[Episode] {
        &self.episodes
    }

    /// Frames in all episodes.
    #[must_use]
    pub const fn len(&self) -> usize {
        self.rows.place.len()
    }

    /// Is there no frame?
    #[must_use]
    pub const fn is_empty(&self) -> bool {
        self.rows.place.is_empty()
    }

    /// Names of the cameras; elsewhere a camera is an index into these.
    #[must_use]
    pub fn camera_names(&self) -> &[String] {
        &self.camera_names
    }

    /// How many arms each frame has; elsewhere an arm is a number below it.
    #[must_use]
    pub const fn arms(&self) -> usize {
        self.spec.arms
    }

    /// Measured joint positions (rad, insertion m) and jaw (rad) of an arm in a frame below
    /// [`len`](Self::len).
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "the column is f32")]
    pub fn state(&self, frame: usize, arm: usize) -> [f32; STATE_WIDTH] {
        self.rows.state[self.row(frame, arm)].map(|value| value as f32)
    }

    /// Measured tip pose of an arm in its RCM frame: x, y, z (m), quaternion x, y, z, w.
    #[must_use]
    pub fn tip_pose(&self, frame: usize, arm: usize) -> [f64; TIP_POSE_WIDTH] {
        self.rows.tip_pose[self.row(frame, arm)]
    }

    /// Commanded tip pose of an arm in its RCM frame and jaw (rad), with the precision of `f32`.
    #[must_use]
    pub fn action(&self, frame: usize, arm: usize) -> [f64; ACTION_WIDTH] {
        self.rows.action[self.row(frame, arm)]
    }

    /// Place of an arm's vectors in `rows`. Asserts the arm: with two arms, a wrong one would be
    /// another frame's.
    const fn row(&self, frame: usize, arm: usize) -> usize {
        assert!(arm < self.spec.arms, "no such arm");
        frame * self.spec.arms + arm
    }

    /// The PNG bytes of a frame, read from its data file.
    fn image_png(&self, frame: usize, camera: usize) -> Result<Vec<u8>, DatasetError> {
        let Place { table, row } = self.rows.place[frame];
        self.tables[table].image(&image_feature(&self.camera_names[camera]), row)
    }

    /// The episode of a frame, and which of its frames it is, both from 0. A binary search over the
    /// episodes.
    #[must_use]
    pub fn place(&self, frame: usize) -> [usize; 2] {
        let episode = self.episodes.partition_point(|it| it.start <= frame) - 1;
        [episode, frame - self.episodes[episode].start]
    }

    /// The image of a frame; read from disk and decoded now. Of video some frames around it are
    /// decoded too and kept for the next call.
    ///
    /// # Errors
    /// [`DatasetError::Io`], [`DatasetError::Parquet`] or [`DatasetError::Mismatch`] if the data
    /// file is damaged or the image is of another size; [`DatasetError::Image`] for what is no PNG,
    /// [`DatasetError::Video`] for what is no video.
    pub fn image_rgb(&self, frame: usize, camera: usize) -> Result<RgbImage, DatasetError> {
        let CameraSpec {
            name,
            width,
            height,
            ..
        } = &self.spec.cameras[camera];
        let place = self.place(frame);
        if let Some(image) = self.videos.image(camera, place, [*width, *height])? {
            return Ok(image);
        }
        let png = self.image_png(frame, camera)?;
        let path = self.tables[self.rows.place[frame].table].path();
        let what = format!("{name} of frame {frame}");
        let image = decode_rgb(&png).map_err(|source| DatasetError::Image {
            what: format!("{what} in {}", path.display()),
            source,
        })?;
        if image.dimensions() != (*width, *height) {
            let found = format!("{} x {}", image.width(), image.height());
            return Err(mismatch(
                path.to_owned(),
                &what,
                found,
                format!("{width} x {height}"),
            ));
        }
        Ok(image)
    }

    /// Depth, ids and pose of a camera in a frame; read from disk and decoded now.
    ///
    /// # Errors
    /// [`DatasetError::Missing`] if the camera keeps no depth; else those of
    /// [`Dataset::image_rgb`].
    pub fn depth(&self, frame: usize, camera: usize) -> Result<RecordedDepth, DatasetError> {
        let Place { table, row } = self.rows.place[frame];
        depth::read(&self.tables[table], &self.spec.cameras[camera], row)
    }

    /// Whether an operator drove in each frame of an episode, in a dataset that says so:
    /// [`DatasetSpec::intervention`].
    ///
    /// # Errors
    /// [`DatasetError::Missing`] if it does not; those of a damaged file.
    pub fn interventions(&self, episode: Episode) -> Result<Vec<bool>, DatasetError> {
        let Place { table, row } = self.rows.place[episode.start];
        let table = &self.tables[table];
        let all = table.flags(INTERVENTION)?;
        let rows = all.get(row..row + episode.len).unwrap_or_default();
        table.check_rows(INTERVENTION, rows.len(), episode.len)?;
        Ok(rows.to_vec())
    }

    /// Where a camera that keeps depth was in each frame of an episode, in a dataset with a file an
    /// episode.
    pub(super) fn camera_poses(
        &self,
        episode: Episode,
        camera: &str,
    ) -> Result<Vec<[f64; TIP_POSE_WIDTH]>, DatasetError> {
        let name = format!("{CAMERA_POSE_PREFIX}{camera}");
        let table = &self.tables[self.rows.place[episode.start].table];
        let poses = table.vectors(&name, 1)?;
        table.check_rows(&name, poses.len(), episode.len)?;
        Ok(poses)
    }

    /// Loads the rows of `listed`, which are in order and begin with the first row of each file.
    fn load(&mut self, listed: &[Listed]) -> Result<(), DatasetError> {
        let mut next = 0;
        for episodes in listed.chunk_by(|a, b| a.data == b.data) {
            let Some(first) = episodes.first() else {
                continue;
            };
            let table = Table::open(&first.data)?;
            for (camera, name) in self.camera_names.iter().enumerate() {
                if !self.videos.has(camera, self.episodes.len()) {
                    table.require(&image_feature(name))?;
                }
            }
            depth::require(&table, &self.spec)?;
            next = self.load_file(&table, episodes, next)?;
            self.tables.push(table);
        }
        Ok(())
    }

    /// Loads the rows of the `episodes` in the file of `table`, of which the first begins with
    /// frame `next` of the dataset; the frame after them.
    fn load_file(
        &mut self,
        table: &Table,
        episodes: &[Listed],
        mut next: usize,
    ) -> Result<usize, DatasetError> {
        let file = FileRows::read(table, self.spec.arms)?;
        let mut row = 0_usize;
        for listed in episodes {
            let rows = row..row.saturating_add(listed.len);
            check_episode(table, listed, next, (&file.episode_index, rows.clone()))?;
            row = rows.end;
            file.append(&mut self.rows, (self.tables.len(), table), rows)?;
            self.episodes.push(Episode {
                index: listed.index,
                start: next,
                len: listed.len,
            });
            next += listed.len;
        }
        Ok(next)
    }
}

/// The cameras' names in their order.
fn names(cameras: &[CameraSpec]) -> Vec<String> {
    cameras.iter().map(|camera| camera.name.clone()).collect()
}

/// Those of `all` cameras that `wanted` names; the error is a name that none has.
fn chosen(all: &[CameraSpec], wanted: &[String]) -> Result<Vec<CameraSpec>, String> {
    let find = |name: &String| {
        let found = all.iter().find(|camera| camera.name == *name);
        found.cloned().ok_or_else(|| name.clone())
    };
    wanted.iter().map(find).collect()
}
