//! The scene's shapes one by one, each a file and a frame of its own: what a viewer gets that moves
//! frames and not the nodes of a file.

use hal::{Intrinsics, Pose};
use trocar_log::live::BentShape;
use trocar_tasks::cameras::SceneModel;

use super::glb::Writer;

/// Shapes and cameras of a scene, in the order of their places.
#[derive(Debug, Default)]
pub(crate) struct Shapes {
    visuals: Vec<(String, Vec<u8>)>,
    cameras: Vec<(String, Intrinsics)>,
    bending: Vec<Bending>,
}

/// What stays of a shape that bends.
#[derive(Debug)]
struct Bending {
    /// Which of the visuals it is.
    visual: usize,
    vertices: usize,
    indices: Vec<u32>,
    /// sRGB.
    colour: [f32; 3],
}

impl Shapes {
    /// Those of `model`, of which `bent` bend. A shape that bends has a frame and no file, which
    /// would show it as it was at first: see [`Self::bent`].
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
        let bending = bent.iter().filter_map(|&visual| {
            let found = model.visuals().get(visual)?;
            Some(Bending {
                visual,
                vertices: found.mesh.positions.len(),
                indices: found.mesh.indices.clone(),
                colour: found.material.base_colour.map(srgb),
            })
        });
        let cameras = model.cameras();
        Self {
            bending: bending.collect(),
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

    /// The shapes that bend, as a message of [`super::message`] says.
    pub(in super::super) fn bent(&self, message: &[u8]) -> Vec<BentShape<'_>> {
        let told = super::bent(message).unwrap_or_default().into_iter();
        let shapes = told.filter_map(|(visual, positions)| {
            // A message of another scene, on its way as this one came, has other shapes.
            let fits = |it: &&Bending| it.visual == visual && it.vertices == positions.len();
            let bending = self.bending.iter().find(fits)?;
            let (frame, _) = self.visuals.get(visual)?;
            Some(BentShape {
                frame,
                positions,
                indices: &bending.indices,
                colour: bending.colour,
            })
        });
        shapes.collect()
    }

    /// The lens of a camera.
    pub(in super::super) fn lens(&self, camera: &str) -> Option<&Intrinsics> {
        let found = self.cameras.iter().find(|(name, _)| name == camera);
        found.map(|(_, lens)| lens)
    }
}

/// A part of a linear colour as sRGB (IEC 61966-2-1).
fn srgb(linear: f32) -> f32 {
    let linear = linear.clamp(0.0, 1.0);
    if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * linear.powf(1.0 / 2.4) - 0.055
    }
}
