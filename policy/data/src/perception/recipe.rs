//! How a policy's clouds are made, as its checkpoint states it: the same in training and at run
//! time.

use hal::FrameRef;
use serde::{Deserialize, Serialize};

use super::{
    CloudFrame, CloudOptions, CropBox, InstanceSet, Padding, PerceptionError, Point,
    depth_from_units, depth_units, point_cloud,
};

/// What a checkpoint says about its clouds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CloudRecipe {
    /// The frame in which the points are, and the box.
    pub frame: CloudFrame,
    /// Lower and upper corner of the box outside of which points are dropped, m; no box drops
    /// nothing.
    pub crop_m: Option<[Point; 2]>,
    /// Instance ids that are dropped: background, ground, what hides the rest. Ids as the frames'
    /// instance planes have them.
    pub dropped_instances: Vec<u8>,
    /// Side of the cubes of which each keeps its first point, m.
    pub voxel_m: Option<f32>,
    /// Points in the cloud.
    pub points: usize,
    /// What fills the cloud when there are fewer.
    pub padding: Padding,
}

impl CloudRecipe {
    /// The options that it amounts to.
    #[must_use]
    pub fn options(&self) -> CloudOptions {
        CloudOptions {
            frame: self.frame,
            crop: self
                .crop_m
                .map_or(CropBox::EVERYTHING, |[min_m, max_m]| CropBox {
                    min_m,
                    max_m,
                }),
            instances: InstanceSet::without(&self.dropped_instances),
            voxel_m: self.voxel_m,
            points: self.points,
            padding: self.padding,
        }
    }

    /// The cloud of `frames`, their depths rounded as recordings round them; for these, that
    /// changes nothing.
    ///
    /// # Errors
    /// Those of [`point_cloud`].
    pub fn cloud(&self, frames: &[FrameRef<'_>]) -> Result<Vec<Point>, PerceptionError> {
        let rounded: Vec<Vec<f32>> = frames
            .iter()
            .map(|frame| {
                let depths = frame.depth_m.iter();
                depths.map(|&x| depth_from_units(depth_units(x))).collect()
            })
            .collect();
        let frames: Vec<FrameRef<'_>> = frames
            .iter()
            .zip(&rounded)
            .map(|(frame, depth_m)| FrameRef { depth_m, ..*frame })
            .collect();
        point_cloud(&frames, &self.options())
    }
}
