//! How the clouds of these tests are made.

use trocar_data::perception::{CloudFrame, CloudRecipe, Padding};

/// 32 points of all that is in view, in the frame of the scene.
pub(crate) fn cloud() -> CloudRecipe {
    CloudRecipe {
        frame: CloudFrame::Scene,
        crop_m: None,
        dropped_instances: vec![0],
        voxel_m: None,
        points: 32,
        padding: Padding::FirstPoint,
    }
}
