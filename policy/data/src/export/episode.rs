//! One episode: its rows, its videos, and the statistics of both.
//!
//! Colour goes frame by frame from the dataset into ffmpeg, so an episode's pictures are never in
//! memory as a whole; its numbers are one record batch.

use std::sync::Arc;

use arrow_array::{
    ArrayRef, FixedSizeListArray, Float32Array, Int64Array, RecordBatch, StringArray,
};
use arrow_schema::DataType;
use hal::JOINT_COUNT;
use parquet::basic::Compression;
use parquet::errors::ParquetError;
use parquet::file::properties::WriterProperties;
use serde_json::{Map, Value};

use super::names::{JOINTS, schema};
use super::{CHUNK_SIZE, Source};
use crate::dataset::encoder::Encoder;
use crate::dataset::schema::{ACTION, INDICES, STATE, TIMESTAMP, item};
use crate::dataset::stats::{ColumnStats, ImageStats};
use crate::dataset::store::{parquet_error, write_parquet};
use crate::dataset::{ACTION_WIDTH, DatasetError, Episode};

/// Every how many frames an image counts for the statistics. Mean and deviation of so many pixels
/// are still close; minimum and maximum may miss a value.
const IMAGE_STATS_STRIDE: usize = 10;

/// Writes the dataset's episode `episode` as number `index`, of which `first` frames come before.
/// Returns its statistics by feature.
pub(super) fn write_episode(
    source: &Source<'_>,
    index: usize,
    episode: usize,
    first: usize,
) -> Result<Value, DatasetError> {
    let rows = Rows {
        source,
        episode: source.dataset.episodes()[episode],
        index,
        first,
        task: source.task_of[episode],
    };
    let mut stats = Map::new();
    for camera in 0..source.cameras.len() {
        let feature = source.cameras[camera].clone();
        stats.insert(feature, plain(rows.film(camera)?.to_json()));
    }
    rows.write()?;
    rows.add_stats(&mut stats);
    Ok(Value::Object(stats))
}

/// The rows of one episode.
///
/// `index`, `first` and `task` are numbers of the exported dataset; `episode` is a range of the
/// source's frames.
struct Rows<'a> {
    source: &'a Source<'a>,
    episode: Episode,
    index: usize,
    first: usize,
    task: usize,
}

impl Rows<'_> {
    /// Writes a camera's video.
    ///
    /// Returns the statistics of the pictures that went in, not of what the codec made of them.
    fn film(&self, camera: usize) -> Result<ImageStats, DatasetError> {
        let dataset = self.source.dataset;
        let (chunk, index) = (self.index / CHUNK_SIZE, self.index);
        let feature = &self.source.cameras[camera];
        let name = format!("videos/chunk-{chunk:03}/{feature}/episode_{index:06}.mp4");
        let path = self.source.options.out.join(name);
        let (spec, codec) = (&dataset.spec().cameras[camera], self.source.options.video);
        let mut encoder = Encoder::start(&path, spec, dataset.fps(), codec)?;
        let mut stats = ImageStats::new();
        for (step, frame) in self.episode.frames().enumerate() {
            let image = dataset.image_rgb(frame, camera)?;
            encoder.push(image.as_raw())?;
            if step.is_multiple_of(IMAGE_STATS_STRIDE) {
                stats.add(image.as_raw());
            }
        }
        encoder.finish()?;
        Ok(stats)
    }

    /// One parquet file with a single row group, SNAPPY, as LeRobot 0.3.3 reads it.
    fn write(&self) -> Result<(), DatasetError> {
        let (chunk, index) = (self.index / CHUNK_SIZE, self.index);
        let name = format!("data/chunk-{chunk:03}/episode_{index:06}.parquet");
        let path = self.source.options.out.join(name);
        let schema = schema(self.source.dataset.arms());
        let batch = RecordBatch::try_new(Arc::clone(&schema), self.columns())
            .map_err(ParquetError::from)
            .map_err(parquet_error(&path));
        let properties = WriterProperties::builder()
            .set_compression(Compression::SNAPPY)
            .build();
        write_parquet(&path, &schema, properties, std::iter::once(batch))
    }

    /// The columns of [`schema`].
    fn columns(&self) -> Vec<ArrayRef> {
        let (len, arms) = (self.episode.len, self.source.dataset.arms());
        let mut columns = vec![
            vectors(arms * ACTION_WIDTH, self.states()),
            vectors(arms * JOINT_COUNT, self.joints()),
            vectors(arms * ACTION_WIDTH, self.actions()),
        ];
        let text = |text: &str| -> ArrayRef {
            Arc::new(StringArray::from_iter_values(std::iter::repeat_n(
                text, len,
            )))
        };
        columns.extend((0..arms).map(|arm| text(self.source.tool(arm))));
        columns.push(text(&self.source.tasks[self.task]));
        columns.push(Arc::new(Float32Array::from(self.times())));
        for name in INDICES {
            columns.push(Arc::new(Int64Array::from(self.indices(name))));
        }
        columns
    }

    /// Tip pose and jaw of each arm in each frame. `[x, y, z, qx, qy, qz, qw, jaw]` an arm,
    /// row-major.
    fn states(&self) -> Vec<f32> {
        self.numbers(|frame, arm| {
            let dataset = self.source.dataset;
            let pose = dataset.tip_pose(frame, arm).map(single);
            let jaw = dataset.state(frame, arm)[JOINT_COUNT];
            [pose.as_slice(), &[jaw]].concat()
        })
    }

    /// Measured yaw, pitch (rad), insertion (m), roll and wrist joints (rad) of each arm, without
    /// the jaw.
    fn joints(&self) -> Vec<f32> {
        self.numbers(|frame, arm| self.source.dataset.state(frame, arm)[..JOINT_COUNT].to_vec())
    }

    /// The absolute set-point of each arm, in the order of [`Self::states`].
    fn actions(&self) -> Vec<f32> {
        self.numbers(|frame, arm| self.source.dataset.action(frame, arm).map(single).to_vec())
    }

    /// What `of` says of each arm in each frame, one after another.
    fn numbers(&self, of: impl Fn(usize, usize) -> Vec<f32>) -> Vec<f32> {
        let arms = self.source.dataset.arms();
        let frames = self.episode.frames();
        frames
            .flat_map(|frame| (0..arms).flat_map(|arm| of(frame, arm)).collect::<Vec<_>>())
            .collect()
    }

    /// The time of each frame since the episode began, s.
    fn times(&self) -> Vec<f32> {
        let fps = f64::from(self.source.dataset.fps());
        #[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
        let time = |step: usize| single(step as f64 / fps);
        (0..self.episode.len).map(time).collect()
    }

    /// The values of one of LeRobot's integer columns; the last, `task_index`, is the same in all
    /// rows.
    fn indices(&self, name: &str) -> Vec<i64> {
        let value = |step: usize| match name {
            "frame_index" => step,
            "episode_index" => self.index,
            "index" => self.first + step,
            _ => self.task,
        };
        (0..self.episode.len)
            .map(|step| value(step) as i64)
            .collect()
    }

    /// Adds min, max, mean, standard deviation and count of every column of numbers; texts have
    /// none.
    fn add_stats(&self, stats: &mut Map<String, Value>) {
        let arms = self.source.dataset.arms();
        let vectors = [
            (STATE, arms * ACTION_WIDTH, self.states()),
            (JOINTS, arms * JOINT_COUNT, self.joints()),
            (ACTION, arms * ACTION_WIDTH, self.actions()),
            (TIMESTAMP, 1, self.times()),
        ];
        for (name, width, values) in vectors {
            let values = values.into_iter().map(f64::from);
            stats.insert(name.to_owned(), summary(width, values.collect()));
        }
        for name in INDICES {
            #[expect(clippy::cast_precision_loss, reason = "counts stay far below 2^53")]
            let values = self.indices(name).into_iter().map(|value| value as f64);
            stats.insert(name.to_owned(), summary(1, values.collect()));
        }
    }
}

/// Statistics of flat, row-major `values`, `width` a row.
fn summary(width: usize, values: Vec<f64>) -> Value {
    let mut stats = ColumnStats::new(width);
    stats.extend(values.chunks_exact(width).map(<[f64]>::to_vec));
    plain(stats.to_json())
}

/// The parts that v2.1 has: no quantiles.
fn plain(stats: Option<Value>) -> Value {
    let Some(Value::Object(mut stats)) = stats else {
        return Value::Null;
    };
    stats.retain(|part, _| ["min", "max", "mean", "std", "count"].contains(&part.as_str()));
    Value::Object(stats)
}

fn vectors(width: usize, values: Vec<f32>) -> ArrayRef {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_possible_wrap,
        reason = "widths have two digits at most"
    )]
    let width = width as i32;
    let values = Arc::new(Float32Array::from(values));
    Arc::new(FixedSizeListArray::new(
        item(DataType::Float32),
        width,
        values,
        None,
    ))
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "documented: numbers are stored as f32"
)]
const fn single(value: f64) -> f32 {
    value as f32
}
