//! The episode in progress: its frames in memory, and as columns of a data file.

use std::{ops::Range, sync::Arc};

use arrow_array::{
    ArrayRef, BinaryArray, FixedSizeListArray, Float32Array, Float64Array, Int64Array, StringArray,
    StructArray,
};
use arrow_schema::DataType;

use super::{
    ACTION_WIDTH, STATE_WIDTH, TIP_POSE_WIDTH,
    meta::EpisodeRow,
    schema::{self, INDICES},
    stats::ImageStats,
};

/// The episode in progress.
#[derive(Debug)]
pub(super) struct Pending {
    pub(super) state: Vec<[f32; STATE_WIDTH]>,
    pub(super) tip_pose: Vec<[f64; TIP_POSE_WIDTH]>,
    pub(super) action: Vec<[f32; ACTION_WIDTH]>,
    /// PNG bytes by camera, then frame.
    pub(super) images: Vec<Vec<Vec<u8>>>,
    pub(super) image_stats: Vec<ImageStats>,
}

impl Pending {
    pub(super) fn new(camera_count: usize) -> Self {
        Self {
            state: Vec::new(),
            tip_pose: Vec::new(),
            action: Vec::new(),
            images: vec![Vec::new(); camera_count],
            image_stats: vec![ImageStats::new(); camera_count],
        }
    }
}

/// Columns of the data file in the order of its schema, for some frames of an episode.
pub(super) fn columns(
    row: &EpisodeRow,
    pending: &Pending,
    frames: Range<usize>,
    fps: u32,
) -> Vec<ArrayRef> {
    let state = pending.state[frames.clone()].as_flattened().to_vec();
    let tip_pose = pending.tip_pose[frames.clone()].as_flattened().to_vec();
    let action = pending.action[frames.clone()].as_flattened().to_vec();
    let mut columns = vec![
        vectors(
            DataType::Float32,
            STATE_WIDTH,
            Arc::new(Float32Array::from(state)),
        ),
        vectors(
            DataType::Float64,
            TIP_POSE_WIDTH,
            Arc::new(Float64Array::from(tip_pose)),
        ),
        vectors(
            DataType::Float32,
            ACTION_WIDTH,
            Arc::new(Float32Array::from(action)),
        ),
    ];
    for images in &pending.images {
        let bytes = BinaryArray::from_iter_values(&images[frames.clone()]);
        let path = StringArray::from_iter_values(
            frames.clone().map(|frame| format!("frame-{frame:06}.png")),
        );
        columns.push(Arc::new(StructArray::new(
            schema::image_fields(),
            vec![Arc::new(bytes) as ArrayRef, Arc::new(path)],
            None,
        )));
    }
    let timestamps = frames.clone().map(|frame| timestamp_s(frame, fps));
    columns.push(Arc::new(Float32Array::from_iter_values(timestamps)));
    for name in INDICES {
        let values = frames.clone().map(|frame| index_value(name, row, frame));
        columns.push(Arc::new(Int64Array::from_iter_values(values)));
    }
    columns
}

fn vectors(data_type: DataType, width: usize, values: ArrayRef) -> ArrayRef {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        reason = "widths are single digits"
    )]
    let width = width as i32;
    Arc::new(FixedSizeListArray::new(
        schema::item(data_type),
        width,
        values,
        None,
    ))
}

/// Value of one of the integer columns.
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
