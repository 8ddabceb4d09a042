//! The episode in progress: its frames in memory, and as columns of a data file.
//!
//! Everything but video stays in memory until the episode ends: numbers as they are, images as PNG.

use std::{ops::Range, sync::Arc};

use arrow_array::{
    ArrayRef, BinaryArray, BooleanArray, FixedSizeListArray, Float32Array, Float64Array,
    Int64Array, StringArray, StructArray,
};
use arrow_schema::DataType;

use super::{
    ACTION_WIDTH, ArmFrame, DatasetSpec, STATE_WIDTH, TIP_POSE_WIDTH,
    depth::{DepthColumns, DepthRow},
    meta::EpisodeRow,
    schema::{self, INDICES},
    stats::ImageStats,
};

/// The episode in progress. The numbers of a frame are as many rows as there are arms: those of
/// frame `f` are `arms * f..arms * (f + 1)`, psm1 first.
#[derive(Debug)]
pub(super) struct Pending {
    /// Arms of each frame; at least 1.
    arms: usize,
    /// Frames so far. Not the length of `state`, which has a row for each arm.
    frames: usize,
    /// Joint positions (rad, insertion m) and jaw (rad).
    pub(super) state: Vec<[f32; STATE_WIDTH]>,
    /// Measured tip pose in the arm's RCM frame.
    pub(super) tip_pose: Vec<[f64; TIP_POSE_WIDTH]>,
    /// Commanded tip pose and jaw, already rounded to what is stored, so that statistics are of the
    /// stored numbers.
    pub(super) action: Vec<[f32; ACTION_WIDTH]>,
    /// Whether an operator drove, if the dataset says so.
    pub(super) intervention: Option<Vec<bool>>,
    /// PNG bytes by camera, then frame.
    pub(super) images: Vec<Vec<Vec<u8>>>,
    /// What depth the frames have, by camera that keeps it.
    pub(super) depth: Vec<DepthColumns>,
    /// Of every tenth frame, by camera; merged into the dataset's when the episode ends.
    pub(super) image_stats: Vec<ImageStats>,
}

impl Pending {
    pub(super) fn new(spec: &DatasetSpec) -> Self {
        let camera_count = spec.cameras.len();
        Self {
            arms: spec.arms,
            frames: 0,
            state: Vec::new(),
            tip_pose: Vec::new(),
            action: Vec::new(),
            intervention: spec.intervention.then(Vec::new),
            images: vec![Vec::new(); camera_count],
            depth: vec![DepthColumns::default(); spec.depth_cameras().count()],
            image_stats: vec![ImageStats::new(); camera_count],
        }
    }

    /// Frames pushed since the last episode ended.
    pub(super) const fn frame_count(&self) -> usize {
        self.frames
    }

    /// Adds a frame's images, a PNG of each camera that is kept so, and its depth.
    ///
    /// Called right after [`Self::push`] of the same frame, so the lists of all columns stay
    /// equally long.
    pub(super) fn push_images(&mut self, pngs: Vec<Vec<u8>>, depth: Vec<DepthRow>) {
        for (images, png) in self.images.iter_mut().zip(pngs) {
            images.push(png);
        }
        for (columns, row) in self.depth.iter_mut().zip(depth) {
            columns.push(row);
        }
    }

    /// Adds the numbers of a frame.
    pub(super) fn push(&mut self, arms: &[ArmFrame], intervention: bool) {
        self.frames += 1;
        if let Some(interventions) = &mut self.intervention {
            interventions.push(intervention);
        }
        for arm in arms {
            #[expect(
                clippy::cast_possible_truncation,
                reason = "documented: actions are stored as f32"
            )]
            let action = arm.action.map(|value| value as f32);
            self.state.push(arm.state);
            self.tip_pose.push(arm.tip_pose);
            self.action.push(action);
        }
    }

    /// The values of each frame in one of the vectors, all arms' one after another.
    pub(super) fn frame_rows<T: Copy + Into<f64>, const N: usize>(
        &self,
        rows: &[[T; N]],
    ) -> impl Iterator<Item = impl Iterator<Item = f64>> {
        let frames = rows.chunks_exact(self.arms.max(1));
        frames.map(|frame| frame.as_flattened().iter().map(|&value| value.into()))
    }
}

/// Columns of the data file in the order of its schema, for some frames of an episode.
///
/// `frames` counts from the episode's beginning. The order is that of `schema::data_schema`, which
/// arrow compares when the batch is made.
pub(super) fn columns(
    row: &EpisodeRow,
    pending: &Pending,
    frames: Range<usize>,
    fps: u32,
) -> Vec<ArrayRef> {
    let arms = pending.arms;
    let rows = arms * frames.start..arms * frames.end;
    let state = pending.state[rows.clone()].as_flattened().to_vec();
    let tip_pose = pending.tip_pose[rows.clone()].as_flattened().to_vec();
    let action = pending.action[rows].as_flattened().to_vec();
    let mut columns = vec![
        vectors(
            DataType::Float32,
            arms * STATE_WIDTH,
            Arc::new(Float32Array::from(state)),
        ),
        vectors(
            DataType::Float64,
            arms * TIP_POSE_WIDTH,
            Arc::new(Float64Array::from(tip_pose)),
        ),
        vectors(
            DataType::Float32,
            arms * ACTION_WIDTH,
            Arc::new(Float32Array::from(action)),
        ),
    ];
    // Of cameras that are kept as video there are none here.
    for images in pending.images.iter().filter(|it| !it.is_empty()) {
        columns.push(pngs(&images[frames.clone()], frames.start));
    }
    for depth in &pending.depth {
        columns.push(pngs(&depth.depth[frames.clone()], frames.start));
        columns.push(pngs(&depth.instance[frames.clone()], frames.start));
        let poses = depth.camera_in_scene[frames.clone()].as_flattened();
        columns.push(vectors(
            DataType::Float64,
            TIP_POSE_WIDTH,
            Arc::new(Float64Array::from(poses.to_vec())),
        ));
    }
    if let Some(interventions) = &pending.intervention {
        let values = interventions[frames.clone()].to_vec();
        columns.push(Arc::new(BooleanArray::from(values)));
    }
    let timestamps = frames.clone().map(|frame| timestamp_s(frame, fps));
    columns.push(Arc::new(Float32Array::from_iter_values(timestamps)));
    for name in INDICES {
        let values = frames.clone().map(|frame| index_value(name, row, frame));
        columns.push(Arc::new(Int64Array::from_iter_values(values)));
    }
    columns
}

/// An image column, its first frame the episode's frame `first`.
fn pngs(images: &[Vec<u8>], first: usize) -> ArrayRef {
    let bytes = BinaryArray::from_iter_values(images);
    let frames = first..first + images.len();
    let path = StringArray::from_iter_values(frames.map(|frame| format!("frame-{frame:06}.png")));
    let parts = vec![Arc::new(bytes) as ArrayRef, Arc::new(path)];
    Arc::new(StructArray::new(schema::image_fields(), parts, None))
}

/// A column of lists of `width` numbers out of the flat, row-major `values`.
fn vectors(data_type: DataType, width: usize, values: ArrayRef) -> ArrayRef {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        reason = "widths have two digits at most"
    )]
    let width = width as i32;
    Arc::new(FixedSizeListArray::new(
        schema::item(data_type),
        width,
        values,
        None,
    ))
}

/// Value of one of the integer columns. `frame_index` counts within the episode, `index` over the
/// whole dataset.
pub(super) fn index_value(name: &str, row: &EpisodeRow, frame: usize) -> i64 {
    let value = match name {
        "frame_index" => frame,
        schema::EPISODE_INDEX => row.index,
        "index" => row.start + frame,
        // Every dataset of this writer has a single task.
        _ => 0,
    };
    value as i64
}

/// Time of a frame since its episode began; LeRobot's readers expect exactly this rounding.
#[expect(
    clippy::cast_precision_loss,
    reason = "frame counts stay far below 2^53"
)]
#[expect(clippy::cast_possible_truncation, reason = "the column is f32")]
pub(super) fn timestamp_s(frame: usize, fps: u32) -> f32 {
    (frame as f64 / f64::from(fps)) as f32
}
