//! Why frames gave no point cloud.

use core::fmt;

/// What happened to the pixels of frames that left no point.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Refused {
    /// All pixels.
    pub pixels: usize,
    /// Those of an instance that may be seen.
    pub of_instance: usize,
    /// Of these, those with a depth.
    pub with_depth: usize,
}

impl Refused {
    /// Adds those of another frame.
    pub(super) const fn add(&mut self, other: &Self) {
        self.pixels += other.pixels;
        self.of_instance += other.of_instance;
        self.with_depth += other.with_depth;
    }
}

impl fmt::Display for Refused {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self {
            pixels,
            of_instance,
            with_depth,
        } = self;
        write!(
            formatter,
            "of {pixels} pixels {of_instance} show a wanted instance, {with_depth} of these have a depth, and none lies in the box"
        )
    }
}

/// Why there is no point cloud.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PerceptionError {
    /// There is no frame.
    #[error("there is no frame to take points from")]
    NoFrame,
    /// A frame's depth or instance ids do not cover the image.
    #[error("frame {frame}: {what} has {actual} pixels, the image {expected}")]
    Size {
        /// Index of the frame.
        frame: usize,
        /// `depth` or `instance ids`.
        what: &'static str,
        /// Pixels of the image.
        expected: usize,
        /// What is there.
        actual: usize,
    },
    /// A frame's lens or pose is senseless.
    #[error("frame {frame}: {what} = {value} is not {allowed}")]
    Camera {
        /// Index of the frame.
        frame: usize,
        /// Which number.
        what: &'static str,
        /// Its value.
        value: f64,
        /// What it may be.
        allowed: &'static str,
    },
    /// The box has no inside.
    #[error("crop box: axis {axis} goes from {min_m} m to {max_m} m")]
    Crop {
        /// 0 x, 1 y, 2 z.
        axis: usize,
        /// Lower end, m.
        min_m: f32,
        /// Upper end, m.
        max_m: f32,
    },
    /// The cubes for thinning have no size.
    #[error("voxel_m = {side_m} is not a positive, finite length")]
    Voxel {
        /// The requested side, m.
        side_m: f32,
    },
    /// The requested number of points is 0.
    #[error("a cloud of no points was requested")]
    NoPoints,
    /// Nothing is left of the frames. A cloud is refused for it only if wanted pixels are in view
    /// and none has a depth.
    #[error("no point is left: {0}")]
    Empty(Refused),
    /// There is no point to choose from.
    #[error("there is no point to choose from")]
    NothingToChoose,
    /// There are fewer points than neighbours requested.
    #[error("{wanted} neighbours were requested among {points} points")]
    TooFewNeighbours {
        /// Neighbours of each centre.
        wanted: usize,
        /// Points there are.
        points: usize,
    },
    /// A point is not finite.
    #[error("point {index} is not finite")]
    NotFinite {
        /// Index of the point.
        index: usize,
    },
}
