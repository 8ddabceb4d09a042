//! A dataset as point clouds: every frame's cloud made once and kept, by the function that policies
//! use at run time.
//!
//! Clouds of a whole dataset fit into memory (12 bytes a point); depth images would not. So a step
//! makes no cloud, and picks from those that are there.

use hal::FrameRef;
use tch::{Device, TchError, Tensor};

use super::steps::Split;
use super::trained::Prepared;
use super::training_set::{ChunkRow, chunk_of, episode_split, statistics};
use super::{Progress, TrainError, TrainOptions, TrainingObserver};
use trocar_data::dataset::{Dataset, Episode};
use trocar_data::perception::{CloudRecipe, Point, shows_nothing};
use trocar_data::relative_action::RELATIVE_ACTION_DIM;
use trocar_nets::checkpoint::CloudStatistics;
use trocar_nets::dimension::dimension;

/// Greatest share of frames in which nothing wanted is in view. More is no occlusion: the recipe
/// does not fit the cameras.
const UNSEEN_SHARE_MAX: f64 = 0.2;

/// Frames that a thread converts between two reports of progress.
const BLOCK_FRAMES: usize = 128;

/// All frames as clouds, states and chunks of relative actions, in SI units.
#[derive(Debug)]
pub(super) struct CloudSet {
    /// By frame.
    pub(super) clouds: Vec<Vec<Point>>,
    /// States and chunks, by frame.
    pub(super) rows: Vec<ChunkRow>,
    /// Statistics of the trained frames.
    pub(super) statistics: CloudStatistics,
    /// Frames that are trained on.
    pub(super) trained: Vec<usize>,
    /// Frames of the held-out episodes.
    pub(super) held_out: Vec<usize>,
    /// First frame of each frame's episode.
    pub(super) episode_start: Vec<usize>,
}

impl CloudSet {
    /// Reads `dataset`; chunks have `steps` steps, the first of them `before` steps before its
    /// frame. The last episodes, the options' share of them, take no part in the statistics.
    pub(super) fn new(
        dataset: &Dataset,
        cloud: &CloudRecipe,
        [before, steps]: [usize; 2],
        options: &TrainOptions,
        watch: &mut dyn TrainingObserver,
    ) -> Result<Self, TrainError> {
        check_depth(dataset)?;
        let episodes = dataset.episodes();
        let (trained, held_out) = episode_split(episodes, options.validation_share)?;
        let rows: Vec<ChunkRow> = episodes
            .iter()
            .flat_map(|episode| {
                let frames = episode.frames();
                let range = frames.clone();
                frames.map(move |frame| chunk_of(dataset, &range, frame, before, steps))
            })
            .collect();
        let features = statistics(dataset, &trained, &rows).ok_or(TrainError::Empty)?;
        let width = RELATIVE_ACTION_DIM * dataset.arms();
        let defect = features.state.defect(width);
        if let Some(defect) = defect.or_else(|| features.action.defect(width)) {
            return Err(TrainError::Dataset(defect));
        }
        let clouds = clouds(dataset, cloud, options.threads, &mut |frames| {
            let of = dataset.len();
            watch.progress(&Progress::Read { frames, of });
        })?;
        let (unseen, of) = (check_seen(dataset, &clouds)?, clouds.len());
        if unseen > 0 {
            watch.progress(&Progress::Unseen { frames: unseen, of });
        }
        // A cloud that shows nothing lies at the origin, which may be far from all that there is to
        // see.
        let seen = trained.iter().map(|&frame| &clouds[frame]);
        let seen = seen.filter(|cloud| !shows_nothing(cloud));
        let points = limits(seen.flatten());
        if !points.as_flattened().iter().all(|limit| limit.is_finite()) {
            let defect = "nothing wanted is in view in the episodes that are trained on";
            return Err(TrainError::Dataset(defect.to_owned()));
        }
        Ok(Self {
            statistics: CloudStatistics {
                state: features.state,
                action: features.action,
                points,
            },
            clouds,
            rows,
            trained,
            held_out,
            episode_start: episodes
                .iter()
                .flat_map(|episode: &Episode| vec![episode.start; episode.len])
                .collect(),
        })
    }

    /// The set as a training draws from it; `cloud` made its clouds. The recipe goes into the run's
    /// description: a run can't be resumed with other clouds.
    pub(super) fn prepared<'a>(&'a self, cloud: &'a CloudRecipe) -> Prepared<'a, CloudStatistics> {
        Prepared {
            split: Split {
                trained: &self.trained,
                held_out: &self.held_out,
            },
            cloud: Some(cloud),
            features: [&self.statistics.state, &self.statistics.action],
            statistics: &self.statistics,
        }
    }

    /// All clouds, `(frames, points, 3)`.
    pub(super) fn points(&self, device: Device) -> Result<Tensor, TchError> {
        let numbers: Vec<f32> = self
            .clouds
            .iter()
            .flat_map(|cloud| cloud.as_flattened())
            .copied()
            .collect();
        let frames = dimension(self.clouds.len());
        Tensor::f_from_slice(&numbers)?
            .f_view([frames, -1, 3])?
            .f_to_device(device)
    }
}

/// Every camera must have kept depth.
fn check_depth(dataset: &Dataset) -> Result<(), TrainError> {
    let cameras = &dataset.spec().cameras;
    if cameras.is_empty() {
        let defect = "it has no camera, and point clouds need depth";
        return Err(TrainError::Dataset(defect.to_owned()));
    }
    match cameras.iter().find(|camera| camera.depth.is_none()) {
        None => Ok(()),
        Some(camera) => Err(TrainError::Dataset(format!(
            "it has no observation.depth.{}, and point clouds need depth: record with --depth",
            camera.name
        ))),
    }
}

/// Counts the frames in which nothing wanted is in view; more than a few are refused.
#[expect(clippy::cast_precision_loss, reason = "frames are few")]
fn check_seen(dataset: &Dataset, clouds: &[Vec<Point>]) -> Result<usize, TrainError> {
    let is_unseen = |cloud: &Vec<Point>| shows_nothing(cloud);
    let unseen = clouds.iter().filter(|cloud| is_unseen(cloud)).count();
    if unseen as f64 <= UNSEEN_SHARE_MAX * clouds.len() as f64 {
        return Ok(unseen);
    }
    let first = clouds.iter().position(is_unseen).unwrap_or(0);
    Err(TrainError::Dataset(format!(
        "in {unseen} of its {} frames (the first is frame {first}) {} show nothing that the cloud wants: other cameras, \
         a wider box or other instances are needed",
        clouds.len(),
        dataset.camera_names().join(" and ")
    )))
}

/// The least and the greatest of each coordinate, m.
fn limits<'a>(points: impl Iterator<Item = &'a Point>) -> [Point; 2] {
    let (mut min, mut max) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for point in points {
        for axis in 0..3 {
            min[axis] = min[axis].min(point[axis]);
            max[axis] = max[axis].max(point[axis]);
        }
    }
    [min, max]
}

/// The cloud of every frame, `threads` at a time; the order is that of the frames whatever the
/// threads do. `on_read` hears how many are done.
fn clouds(
    dataset: &Dataset,
    cloud: &CloudRecipe,
    threads: usize,
    on_read: &mut dyn FnMut(usize),
) -> Result<Vec<Vec<Point>>, TrainError> {
    let mut clouds = vec![Vec::new(); dataset.len()];
    let block = BLOCK_FRAMES * threads.max(1);
    let mut start = 0;
    for part in clouds.chunks_mut(block) {
        std::thread::scope(|scope| {
            let share = part.len().div_ceil(threads.max(1)).max(1);
            let workers: Vec<_> = part
                .chunks_mut(share)
                .enumerate()
                .map(|(worker, part)| {
                    let first = start + worker * share;
                    scope.spawn(move || {
                        for (index, made) in part.iter_mut().enumerate() {
                            *made = cloud_of(dataset, cloud, first + index)?;
                        }
                        Ok::<(), TrainError>(())
                    })
                })
                .collect();
            for worker in workers {
                worker
                    .join()
                    .map_err(|_| TrainError::Dataset("a decoding thread failed".to_owned()))??;
            }
            Ok::<(), TrainError>(())
        })?;
        start += part.len();
        on_read(start);
    }
    Ok(clouds)
}

/// The point cloud that all cameras show in one frame.
fn cloud_of(
    dataset: &Dataset,
    cloud: &CloudRecipe,
    frame: usize,
) -> Result<Vec<Point>, TrainError> {
    let mut frames = Vec::new();
    for camera in 0..dataset.camera_names().len() {
        frames.push(dataset.depth(frame, camera)?.into_frame());
    }
    let frames: Vec<FrameRef<'_>> = frames.iter().map(hal::CameraFrame::as_frame).collect();
    cloud
        .cloud(&frames)
        .map_err(|error| TrainError::Dataset(format!("frame {frame}: {error}")))
}
