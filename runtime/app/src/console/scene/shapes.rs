//! The scene's shapes one by one, each a file and a frame of its own: what a viewer gets that moves frames and not the nodes of a file.

use hal::{Intrinsics, Pose};
use trocar_tasks::cameras::SceneModel;

use super::glb::Writer;

/// Shapes and cameras of a scene, in the order of their places.
#[derive(Debug, Default)]
pub(crate) struct Shapes {
    visuals: Vec<(String, Vec<u8>)>,
    cameras: Vec<(String, Intrinsics)>,
}

impl Shapes {
    /// Those of `model`. A shape that bends has a frame and no file: the file would show it as it was at first.
    pub(in super::super) fn new(model: &SceneModel, bent: &[usize]) -> Self {
        let visuals = model.visuals().iter().enumerate().map(|(index, visual)| {
            let mut writer = Writer::default();
            if !bent.contains(&index) && !visual.mesh.indices.is_empty() {
                writer.mesh(
                    visual.name,
                    &visual.mesh,
                    &visual.material,
                    &Pose::identity(),
                );
            }
            let file = if writer.is_empty() {
                Vec::new()
            } else {
                writer.finish()
            };
            (format!("{index} {}", visual.name), file)
        });
        let cameras = model.cameras();
        Self {
            visuals: visuals.collect(),
            cameras: cameras
                .map(|(name, lens)| (name.to_owned(), lens))
                .collect(),
        }
    }

    /// The frames of the shapes.
    pub(in super::super) fn frames(&self) -> impl Iterator<Item = &str> {
        self.visuals.iter().map(|(frame, _)| frame.as_str())
    }

    /// The frames of the cameras.
    pub(in super::super) fn cameras(&self) -> impl Iterator<Item = &str> {
        self.cameras.iter().map(|(name, _)| name.as_str())
    }

    /// The shapes that do not bend, with their frames.
    pub(in super::super) fn files(&self) -> impl Iterator<Item = (&str, &[u8])> {
        let files = self.visuals.iter().filter(|(_, file)| !file.is_empty());
        files.map(|(frame, file)| (frame.as_str(), file.as_slice()))
    }

    /// The lens of a camera.
    pub(in super::super) fn lens(&self, camera: &str) -> Option<&Intrinsics> {
        let found = self.cameras.iter().find(|(name, _)| name == camera);
        found.map(|(_, lens)| lens)
    }
}
