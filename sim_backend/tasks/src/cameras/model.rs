//! A task's scene for whoever draws it without a renderer of ours: shapes, and where they and the cameras are at an instant.

use hal::{Intrinsics, Mesh, Pose};
use trocar_render::visual::{Visual, VisualPoses};

use super::View;
use super::flap::DrawnFlap;
use crate::SimulationError;
use crate::scene::SceneSnapshot;
use crate::task::{TaskConfig, TaskScene, scene_poses, scene_visuals};

/// The shapes of one episode. All poses are in the scene frame, in metres; cameras look along their z axis, x is to the right of the image.
pub struct SceneModel {
    scene: Box<dyn TaskScene>,
    visuals: Vec<Visual>,
    flap: Option<DrawnFlap>,
    views: Vec<View>,
}

impl SceneModel {
    /// Those of the episode `seed` of `task`.
    #[must_use]
    pub fn new(task: &TaskConfig, seed: u64) -> Self {
        let scene = task.scene_of(seed);
        let mut visuals = scene_visuals(task);
        for (visual, own) in visuals.iter_mut().zip(scene.visuals()) {
            *visual = own;
        }
        Self {
            flap: DrawnFlap::new(&*scene, &visuals),
            views: View::of_episode(task, seed, &task.drawn(seed)),
            scene,
            visuals,
        }
    }

    /// Everything that is drawn, a soft thing as it is before anything touches it.
    #[must_use]
    pub fn visuals(&self) -> &[Visual] {
        &self.visuals
    }

    /// Where each of the visuals is.
    #[must_use]
    pub fn poses(&self, snapshot: &SceneSnapshot) -> VisualPoses {
        scene_poses(&*self.scene, snapshot)
    }

    /// The visuals whose shape changes, by index, with the shapes that they have now.
    pub fn bent(&mut self, snapshot: &SceneSnapshot) -> Vec<(usize, &Mesh)> {
        let (Some(drawn), Some(flap)) = (&mut self.flap, &snapshot.flap) else {
            return Vec::new();
        };
        drawn.bend(flap);
        drawn.meshes().to_vec()
    }

    /// Names and lenses of the cameras.
    pub fn cameras(&self) -> impl Iterator<Item = (&str, Intrinsics)> {
        self.views
            .iter()
            .map(|view| (view.name.as_str(), view.intrinsics))
    }

    /// Where each of the cameras is.
    ///
    /// # Errors
    /// [`SimulationError::NoCarrier`] if an arm that carries one is not in `snapshot`.
    pub fn camera_poses(&self, snapshot: &SceneSnapshot) -> Result<Vec<Pose>, SimulationError> {
        let placed = self.views.iter().map(|view| view.camera_in_scene(snapshot));
        placed.collect()
    }
}
