//! Depth images to point clouds: back-projection, mask, crop, thinning, farthest-point sampling.
//!
//! Plain single precision in a stated order of operations: the same frames give the same bits in
//! every build. What comes out is in metres and not normalised, and its order is part of the
//! result: frames in their order, each row by row from the top left, then what the sampling makes
//! of that.
//!
//! Source: reference note on policies, sections 4 and 5.8 (crop before sampling, sampling from
//! index 0, the first of equal maxima, zeros where points are missing).

mod back_projection;
mod buckets;
mod depth_units;
mod error;
mod farthest;
mod instances;
mod neighbours;
mod recipe;
#[cfg(test)]
mod tests;
mod thinning;

use hal::FrameRef;
use serde::{Deserialize, Serialize};

pub use back_projection::{CloudFrame, CropBox, back_project};
pub use depth_units::{DEPTH_MAX_M, DEPTH_UNIT_M, depth_from_units, depth_units};
pub use error::{PerceptionError, Refused};
pub use farthest::farthest_points;
pub use instances::InstanceSet;
pub use neighbours::nearest_points;
pub use recipe::CloudRecipe;
pub use thinning::thin;

/// A point, metres.
pub type Point = [f32; 3];

/// Where all points of a cloud are that shows nothing: the origin of its frame.
const NOWHERE: Point = [0.0; 3];

/// Whether `cloud` is what [`point_cloud`] gives when nothing wanted is in view. True of an empty
/// one too.
#[must_use]
pub fn shows_nothing(cloud: &[Point]) -> bool {
    cloud.iter().all(|point| *point == NOWHERE)
}

/// What fills the cloud when there are fewer points than it must have.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Padding {
    /// The first point again, which is also what sampling on would give: nothing that takes a
    /// maximum sees it.
    #[default]
    FirstPoint,
    /// Points at the origin, as DP3's published code has it. The network sees them.
    Origin,
}

/// How frames become the cloud that a network sees. A checkpoint's [`CloudRecipe`] makes them;
/// tests and tools fill them in directly.
#[derive(Clone, Debug, PartialEq)]
pub struct CloudOptions {
    /// The frame in which the points are, and the box.
    pub frame: CloudFrame,
    /// Points outside are dropped.
    pub crop: CropBox,
    /// What may be seen.
    pub instances: InstanceSet,
    /// Side of the cubes of which each keeps its first point, m; `None` keeps all.
    pub voxel_m: Option<f32>,
    /// Points in the cloud.
    pub points: usize,
    /// What fills the cloud when there are fewer.
    pub padding: Padding,
}

/// The cloud that `frames` show: exactly `options.points` points, the farthest first.
///
/// Where nothing wanted is in view (all of it hidden, or outside of the box) every point is the
/// origin of the cloud's frame, which is what published code's zero padding comes to and what
/// [`shows_nothing`] knows again. Where wanted pixels are in view but none has a depth, the sensor
/// is to blame and there is no cloud.
///
/// # Errors
/// [`PerceptionError`] if a frame is not whole, an option is senseless or no pixel of what is
/// wanted has a depth.
pub fn point_cloud(
    frames: &[FrameRef<'_>],
    options: &CloudOptions,
) -> Result<Vec<Point>, PerceptionError> {
    if options.points == 0 {
        return Err(PerceptionError::NoPoints);
    }
    let seen = match back_project(frames, options.frame, &options.crop, &options.instances) {
        Ok(seen) => seen,
        Err(PerceptionError::Empty(refused))
            if refused.of_instance == 0 || refused.with_depth > 0 =>
        {
            return Ok(vec![NOWHERE; options.points]);
        }
        Err(error) => return Err(error),
    };
    let kept = match options.voxel_m {
        Some(side_m) => thin(&seen, side_m)?,
        None => seen,
    };
    resized(&kept, options)
}

/// As many of `kept` as `options` wants, the farthest first, padded where they are too few.
///
/// Thinned points beyond the wanted number are dropped; with too few, sampling itself repeats the
/// first.
fn resized(kept: &[Point], options: &CloudOptions) -> Result<Vec<Point>, PerceptionError> {
    let chosen = farthest_points(kept, options.points)?;
    let mut cloud: Vec<Point> = chosen.iter().map(|&index| kept[index]).collect();
    if options.padding == Padding::Origin && cloud.len() > kept.len() {
        cloud[kept.len()..].fill(NOWHERE);
    }
    Ok(cloud)
}
