//! Going on with a recording that was cut off, or that shall get more episodes.

use std::{fs, path::Path};

use hal::Intrinsics;

use super::{DatasetWriter, IMAGE_STATS_STRIDE, check, file_of};
use crate::dataset::{
    ArmFrame, CameraSpec, Dataset, DatasetError, DatasetSpec, Notes, Totals, VideoCodec,
    episode::Pending,
    error::mismatch,
    layout,
    listed::{Listed, VideoPlace},
    meta::{self, CHUNK_SIZE, EpisodeRow},
    schema::{self, Feature, IMAGE_PREFIX, Info, VERSION},
    spec::{read_spec, video_features},
    store::io_error,
};

impl DatasetWriter {
    /// Goes on with the recording in `dir`, behind its last finished episode; what a cut episode
    /// left is dropped.
    ///
    /// The result is the same, byte for byte, as if there had been no break, but for the statistics
    /// of cameras that are kept as video: those of the frames that were there before are counted
    /// from what the video shows of them, which is close to what was recorded and not the same.
    /// Every tenth image is decoded for them, which takes its time in a large dataset.
    ///
    /// # Errors
    /// [`DatasetError::NoRecording`] if there is none; [`DatasetError::Differs`] if it was recorded
    /// to another specification or with another codec, naming the first part that differs;
    /// [`DatasetError::Busy`] while another writer is at it; those of [`Dataset::open`] and
    /// [`Dataset::image_rgb`] if what is there is damaged; [`DatasetError::Mismatch`] if its files
    /// lie otherwise than this writer lays them. Nothing is changed then.
    pub fn resume(
        dir: &Path,
        spec: &DatasetSpec,
        video: Option<VideoCodec>,
    ) -> Result<Self, DatasetError> {
        check(spec, video)?;
        if !meta::info_path(dir).is_file() {
            return Err(DatasetError::NoRecording {
                path: dir.to_owned(),
            });
        }
        let mut writer = Self::empty(dir, spec, video)?;
        let info = meta::read_info(dir)?;
        check_same(dir, &info, spec, video)?;
        let listed = listed(dir, &info)?;
        let dataset = Dataset::open(dir)?;
        for (index, episode) in listed.iter().enumerate() {
            let (chunk, file) = file_of(index);
            let row = EpisodeRow {
                index,
                start: episode.start,
                len: episode.len,
                chunk,
                file,
            };
            writer.take_over(&dataset, row)?;
        }
        let Totals { frames, .. } = writer.totals();
        if frames != info.total_frames {
            let path = meta::info_path(dir);
            return Err(mismatch(path, "total_frames", info.total_frames, frames));
        }
        writer.notes = Notes::read(dir)?;
        drop_leftovers(dir, listed.len())?;
        writer.commit()?;
        Ok(writer)
    }

    /// Counts a finished episode of `dataset`.
    fn take_over(&mut self, dataset: &Dataset, row: EpisodeRow) -> Result<(), DatasetError> {
        let mut pending = Pending::new(&self.spec);
        let episode = dataset.episodes()[row.index];
        let interventions = match self.spec.intervention {
            true => dataset.interventions(episode)?,
            false => vec![false; row.len],
        };
        for (frame, &intervention) in interventions.iter().enumerate() {
            let place = row.start + frame;
            if frame.is_multiple_of(IMAGE_STATS_STRIDE) {
                for (camera, stats) in pending.image_stats.iter_mut().enumerate() {
                    stats.add(dataset.image_rgb(place, camera)?.as_raw());
                }
            }
            let arms = (0..self.spec.arms).map(|arm| arm_frame(dataset, place, arm));
            pending.push(&arms.collect::<Vec<_>>(), intervention);
        }
        for ((camera, _), columns) in self.spec.depth_cameras().zip(&mut pending.depth) {
            columns.camera_in_scene = dataset.camera_poses(episode, &camera.name)?;
        }
        self.episodes.push(row);
        self.frame_count += row.len;
        self.add_stats(&row, &pending);
        Ok(())
    }
}

fn arm_frame(dataset: &Dataset, place: usize, arm: usize) -> ArmFrame {
    ArmFrame {
        state: dataset.state(place, arm),
        tip_pose: dataset.tip_pose(place, arm),
        action: dataset.action(place, arm),
    }
}

/// The finished episodes of the dataset in `dir`, each of which must have its files where this
/// writer puts them.
fn listed(dir: &Path, info: &Info) -> Result<Vec<Listed>, DatasetError> {
    let videos = video_features(info);
    let mut listed = layout::read_episodes(dir, info, &videos)?;
    listed.truncate(info.total_episodes);
    for (index, episode) in listed.iter().enumerate() {
        let (chunk, file) = file_of(index);
        let is_video = |(feature, place): (&String, &VideoPlace)| {
            place.path == meta::video_path(dir, feature, chunk, file) && place.from_s == 0.0
        };
        let data = meta::data_path(dir, chunk, file);
        if episode.index != index
            || episode.data != data
            || !videos.iter().zip(&episode.videos).all(is_video)
        {
            let what = format!("episode {}", episode.index);
            let found = format!("in {}", episode.data.display());
            let expected = "in files of its own, numbered as it is";
            return Err(mismatch(meta::info_path(dir), &what, found, expected));
        }
    }
    Ok(listed)
}

/// What a recording was made to must be what it goes on to.
fn check_same(
    dir: &Path,
    info: &Info,
    spec: &DatasetSpec,
    video: Option<VideoCodec>,
) -> Result<(), DatasetError> {
    let same = |what: &str, recorded: String, asked: String| {
        if recorded == asked {
            return Ok(());
        }
        Err(DatasetError::Differs {
            path: dir.to_owned(),
            what: what.to_owned(),
            recorded,
            asked,
        })
    };
    // The first: another format describes the rest elsewhere.
    let format = info.codebase_version.clone();
    same("codebase_version", format, VERSION.to_owned())?;
    let recorded = read_spec(dir, info)?;
    same("fps", recorded.fps.to_string(), spec.fps.to_string())?;
    let robots = [&recorded, spec].map(|spec| format!("{:?}", spec.robot_type));
    let [robot, asked] = robots;
    same("robot_type", robot, asked)?;
    same("arms:", recorded.arms.to_string(), spec.arms.to_string())?;
    let [task, asked] = [&recorded, spec].map(|spec| format!("{:?}", spec.task));
    same("task", task, asked)?;
    let [cameras, asked] = [&recorded, spec].map(names);
    same("cameras", cameras, asked)?;
    for (recorded, asked) in recorded.cameras.iter().zip(&spec.cameras) {
        let name = &asked.name;
        let size = |camera: &CameraSpec| format!("{} x {}", camera.width, camera.height);
        same(&format!("camera {name} of"), size(recorded), size(asked))?;
        let [lens, asked] = [recorded, asked].map(|camera| depth(camera.depth.as_ref()));
        same(&format!("camera {name}'s depth"), lens, asked)?;
    }
    let features = schema::features(spec, video);
    for ((name, recorded), (_, asked)) in info.features.iter().zip(&features) {
        if let Some(camera) = name.strip_prefix(IMAGE_PREFIX) {
            let what = format!("camera {camera}'s colour as");
            same(&what, colour(recorded), colour(asked))?;
        }
    }
    if info.features == features {
        return Ok(());
    }
    let [recorded, asked] = [&info.features, &features].map(|all| format!("{all:?}"));
    same("features", recorded, asked)
}

fn names(spec: &DatasetSpec) -> String {
    let names: Vec<&str> = spec.cameras.iter().map(|it| it.name.as_str()).collect();
    match names[..] {
        [] => "none".to_owned(),
        _ => names.join(", "),
    }
}

/// A lens; its numbers are told so that they are the same only if they are the same to the bit.
fn depth(lens: Option<&Intrinsics>) -> String {
    let described = |it: &Intrinsics| {
        let Intrinsics { fx, fy, cx, cy, .. } = it;
        let bent = if it.distortion.is_none() {
            String::new()
        } else {
            format!(", distortion {:?}", it.distortion.coefficients())
        };
        format!("through fx {fx}, fy {fy}, cx {cx}, cy {cy}{bent}")
    };
    lens.map_or_else(|| "left out".to_owned(), described)
}

/// How a camera's colour is kept.
fn colour(feature: &Feature) -> String {
    let codec = feature.info.as_ref().map(|info| &info["video.codec"]);
    match codec.and_then(|codec| codec.as_str()) {
        Some(codec) => codec.to_owned(),
        None if feature.dtype == "image" => "PNG".to_owned(),
        None => feature.dtype.clone(),
    }
}

/// Takes away the files of episodes that are not among the first `episodes`, and files that were
/// never whole.
fn drop_leftovers(dir: &Path, episodes: usize) -> Result<(), DatasetError> {
    let is_partial = |path: &Path| path.extension().is_some_and(|it| it == "partial");
    let is_beyond = |path: &Path| number(path).is_some_and(|number| number >= episodes);
    sweep(&dir.join("meta"), &is_partial)?;
    for folder in ["data", "videos"] {
        let folder = dir.join(folder);
        if folder.is_dir() {
            sweep(&folder, &|path| is_partial(path) || is_beyond(path))?;
        }
    }
    Ok(())
}

/// Takes away the files below `folder` that `is_left` names.
fn sweep(folder: &Path, is_left: &dyn Fn(&Path) -> bool) -> Result<(), DatasetError> {
    for entry in fs::read_dir(folder).map_err(io_error(folder))? {
        let entry = entry.map_err(io_error(folder))?;
        let path = entry.path();
        let kind = entry.file_type().map_err(io_error(&path))?;
        if kind.is_dir() {
            sweep(&path, is_left)?;
        } else if is_left(&path) {
            fs::remove_file(&path).map_err(io_error(&path))?;
        }
    }
    Ok(())
}

/// The number of the episode that a file `chunk-000/file-000.*` is of.
fn number(path: &Path) -> Option<usize> {
    let counted = |name: &std::ffi::OsStr, prefix: &str| -> Option<usize> {
        name.to_str()?.strip_prefix(prefix)?.parse().ok()
    };
    let chunk = counted(path.parent()?.file_name()?, "chunk-")?;
    let file = counted(path.file_stem()?, "file-")?;
    chunk.checked_mul(CHUNK_SIZE)?.checked_add(file)
}
