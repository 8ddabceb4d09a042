//! Demonstrations on disk, in the LeRobot v3.0 layout: rows and PNG images in parquet, one file an
//! episode.
//!
//! ```text
//! meta/info.json                              format, rate, totals, features; written last, so it is the commit record
//! meta/stats.json                             per feature min, max, mean, std, count and quantiles
//! meta/tasks.parquet                          the task text, as the pandas index
//! meta/episodes/chunk-000/file-000.parquet    where each episode's rows are
//! data/chunk-000/file-000.parquet             one row a frame, images as PNG bytes
//! videos/FEATURE/chunk-000/file-000.mp4       instead of the PNG, where the camera is kept as video
//! meta/trocar_recording.json                  the recording's options, if the recorder says so; see [`Notes`]
//! meta/trocar_episodes.jsonl                  how each episode came about, likewise
//! ```
//!
//! Datasets of v2.0 and v2.1 are read too. Video goes through the system's ffmpeg and loses some of
//! the picture; depth and instance ids are never video.
//!
//! Of two arms, each vector has the first arm's numbers and then the second's, and every name in it
//! begins with its arm's (`psm1_yaw`); a single arm's names stand alone. Poses are in each arm's
//! own RCM frame.
//!
//! A camera that keeps depth has three features more: `observation.depth.NAME`, 16-bit PNG in units
//! of [`DEPTH_UNIT_M`](crate::perception::DEPTH_UNIT_M); `observation.instance.NAME`, 8-bit PNG;
//! and `observation.camera_pose.NAME`, where the camera was in the scene. Its lens stands in the
//! depth feature's `info`.
//!
//! [`DatasetWriter`] records, [`Dataset`] reads, several as one too. A recording that is cut off
//! loses the episode in progress and nothing else. Every file is replaced by renaming, never
//! written in place. [`DatasetWriter::resume`] goes on with it.
//!
//! A row is a frame: what was observed at its instant, and the command given for it, so `action` of
//! row `t` belongs to the observation of row `t`. Times are `frame / fps` since the episode's first
//! frame, rounded to `f32` as LeRobot's readers check them; the writer is given no times, so frames
//! must come at that rate.

mod check;
mod depth;
#[cfg(test)]
mod depth_tests;
pub(crate) mod encoder;
mod episode;
mod error;
pub(crate) mod foreign;
mod guard;
#[cfg(test)]
mod intervention_tests;
mod joined;
mod layout;
mod listed;
mod meta;
mod notes;
mod pages;
mod png;
mod reader;
#[cfg(test)]
mod resume_tests;
mod rows;
pub(crate) mod schema;
mod segments;
mod spec;
pub(crate) mod stats;
pub(crate) mod store;
mod table;
#[cfg(test)]
mod tests;
mod video;
#[cfg(test)]
mod video_tests;
mod writer;

pub use depth::{DepthFrame, RecordedDepth};
pub use error::DatasetError;
pub use guard::file_being_read;
pub use joined::Part;
pub use notes::Notes;
pub use png::SIDE_MAX;
pub use png::{decode_rgb, encode_rgb};
pub use reader::Dataset;
pub use video::VideoCodec;
pub use writer::{DatasetWriter, Totals};

use hal::Intrinsics;

/// Numbers of one arm in `observation.state`: six joint positions (rad, insertion m) and the jaw
/// angle (rad).
pub const STATE_WIDTH: usize = 7;
/// Numbers of one arm in `observation.tip_pose`: x, y, z (m) and a unit quaternion x, y, z, w, in
/// the RCM frame.
pub const TIP_POSE_WIDTH: usize = 7;
/// Numbers of one arm in `action`: the commanded tip pose as in [`TIP_POSE_WIDTH`], then the jaw
/// angle (rad).
pub const ACTION_WIDTH: usize = 8;

/// What a dataset is of. Fixed for all episodes; [`DatasetWriter::resume`] refuses another one.
#[derive(Clone, Debug, PartialEq)]
pub struct DatasetSpec {
    /// Frames a second; the spacing of rows is exactly `1 / fps`.
    pub fps: u32,
    /// The robot's name. LeRobot shows it and does not interpret it.
    pub robot_type: String,
    /// How many arms it has, one or two.
    pub arms: usize,
    /// What every episode shows, in words. LeRobot's language instruction; policies conditioned on
    /// language see it.
    pub task: String,
    /// The cameras, in the order in which frames bring their images.
    pub cameras: Vec<CameraSpec>,
    /// Whether each frame says if an operator drove, in LeRobot's feature `intervention`.
    pub intervention: bool,
}

/// One camera of a dataset.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraSpec {
    /// Name, without `/`; the feature is `observation.images.<name>`.
    pub name: String,
    /// Image width, pixels.
    pub width: u32,
    /// Image height, pixels.
    pub height: u32,
    /// Its lens, if depth and instance ids are kept too.
    pub depth: Option<Intrinsics>,
}

impl CameraSpec {
    /// Bytes of one RGB image.
    #[must_use]
    pub const fn image_size_bytes(&self) -> usize {
        3 * self.width as usize * self.height as usize
    }
}

/// One arm in one frame: what was observed and the command given for it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmFrame {
    /// Measured joint positions (rad, insertion m) and jaw angle (rad); stored as `f32`.
    pub state: [f32; STATE_WIDTH],
    /// Measured tip pose in the RCM frame, see [`TIP_POSE_WIDTH`]; stored as `f64`.
    pub tip_pose: [f64; TIP_POSE_WIDTH],
    /// Commanded tip pose in the RCM frame and jaw, see [`ACTION_WIDTH`]; stored as `f32`, so
    /// positions within 0.25 m are rounded by at most 8 nm.
    pub action: [f64; ACTION_WIDTH],
}

/// What happened in one frame.
///
/// Borrowed: the writer copies what it keeps before [`DatasetWriter::push_frame`] returns.
#[derive(Clone, Copy, Debug)]
pub struct FrameRecord<'a> {
    /// The arms in their order, as many as [`DatasetSpec::arms`].
    pub arms: &'a [ArmFrame],
    /// One RGB image a camera, 8 bit, row-major, in the order of [`DatasetSpec::cameras`].
    pub images: &'a [&'a [u8]],
    /// Depth and ids, one of each camera whose [`CameraSpec::depth`] says so, in their order.
    pub depth: &'a [DepthFrame<'a>],
}

/// Where one episode lies among all frames.
///
/// Episodes lie one after another without a gap: each `start` is the end of the one before.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Episode {
    /// Number of the episode, from 0.
    pub index: usize,
    /// Its first frame.
    pub start: usize,
    /// Its number of frames, at least 1.
    pub len: usize,
}

impl Episode {
    /// Its frames.
    #[must_use]
    pub const fn frames(&self) -> std::ops::Range<usize> {
        self.start..self.start + self.len
    }
}
