//! The off-screen renderer: colour, metric depth and instance ids of a scene, as an endoscope sees
//! it.
//!
//! It runs on any Vulkan device; a software rasteriser is enough. Coordinates go to the device
//! relative to the camera, so that single precision is never spent on where the camera is. Ids and
//! depth come from a pass of their own, with one sample a pixel, so that no way of shading touches
//! them. What surfaces look like is in `bake.wgsl` (patterns, painted once), `surface.wgsl` and
//! `light.wgsl`. On one device and driver the same inputs give the same bytes.
//!
//! An image: `station` finds targets and records for the camera, `scene` writes the records and
//! orders the draws, `pipelines` encodes the passes (shadow map, labels, colour), `deferred` shades
//! a fine picture before its colour is drawn, `lens` adds a pass where there is distortion or dirt,
//! `targets` copies all planes into one staging buffer and unpacks it. Several cameras are
//! submitted before the first is waited for.
//!
//! Bind groups: 0 is the frame's record and, at a dynamic offset, the object's (`records`); 1 is
//! shadow map and patterns (`maps`); 2 what is shaded apart (`deferred`). The lens pass and the
//! painting of patterns (`bake`) have layouts of their own.

mod bake;
mod camera;
mod deferred;
mod error;
mod gpu;
mod lens;
mod maps;
mod occlusion;
mod optics;
mod pipelines;
mod rays;
mod records;
mod scene;
mod station;
mod targets;
mod textures;
mod vessel_pass;
mod vessels;

use std::sync::{Mutex, PoisonError};

use hal::{CameraFrame, Intrinsics, Mesh, Pose};

pub use camera::{Camera, Light, look_at};
pub use error::RenderError;
pub use optics::Optics;

use crate::visual::{Backdrop, Visual};
use bake::{Paints, Wanted};
use gpu::Gpu;
use lens::LensPass;
use pipelines::{Pipelines, SHADOW_MAP_PX};
use records::{Eye, Records, View};
use scene::Scene;
use station::{Plot, Station, Stations};

/// Renderers are opened one after the other: a driver may hang when several threads do it at the
/// same time.
static OPENING: Mutex<()> = Mutex::new(());

/// The buffers of one image.
///
/// Row-major from the top left, without padding: `width * height` pixels in each. What is in them
/// before does not matter.
#[derive(Debug)]
pub struct Planes<'a> {
    /// sRGB bytes, 3 a pixel: red, green, blue.
    pub colour: &'a mut [u8],
    /// Distance along the camera's z axis, metres; 0 where nothing was hit. Not the length of the
    /// ray. Behind a lens that distorts z is still that of the pinhole camera.
    pub depth_m: &'a mut [f32],
    /// Instance id of what was hit; 0 is background.
    pub instance: &'a mut [u8],
}

impl Planes<'_> {
    /// Whether the buffers are of the size that `intrinsics` say.
    fn check(&self, intrinsics: &Intrinsics) -> Result<(), RenderError> {
        let pixels = intrinsics.pixel_count();
        if (self.colour.len(), self.depth_m.len(), self.instance.len())
            == (3 * pixels, pixels, pixels)
        {
            return Ok(());
        }
        Err(RenderError::Buffers { pixels })
    }
}

/// How much work goes into colours; depth and ids do not depend on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Shading {
    /// Shadows, surroundings mirrored in metal and fluid, relief.
    #[default]
    Full,
    /// For pictures that people look at: edges smoothed over the pixel, light that comes through
    /// thin tissue, hollows that the light from all around does not reach (both baked by rays when
    /// it is chosen first). A software rasteriser takes 2.5 to 4 times as long
    /// (`tests/benches/RESULTS.md`).
    ///
    /// Shadows have penumbras (percentage-closer soft shadows, R. Fernando, 2005) of a light guide
    /// of 4 mm: they grow with the height of the caster over the surface, up to 3 mm wide.
    ///
    /// It is shaded in a compute pass, at each pixel's centre. What covers no centre is not seen: a
    /// thread thinner than a pixel breaks up.
    ///
    /// Relief of patterned surfaces and of the film on them is steeper than in full shading, so
    /// that tissue glistens in more places, what is mirrored has more of its colour, and what is
    /// behind everything is out of focus; paint is worn. Full shading is without these, for policies
    /// are trained on it.
    Fine,
    /// Painted colours in the same light without any of these, in 0.5 to 0.8 of the time.
    Plain,
}

impl Shading {
    /// Whether pictures show the cameras' [`Optics`]; distortion they show always.
    const fn shows_optics(self) -> bool {
        matches!(self, Self::Full | Self::Fine)
    }
}

/// Draws one fixed set of visuals, which may move and bend, from any number of cameras.
///
/// Owns its device. Every image takes `&mut self`; for images in parallel a process opens several.
/// Opening one compiles shaders and paints patterns, so it is kept for a whole run.
pub struct Renderer {
    /// The device, its queue and its first uncollected error.
    gpu: Gpu,
    /// Meshes on the device, and the order of drawing of the last eye.
    scene: Scene,
    /// Passes for the present shading.
    pipelines: Pipelines,
    /// Records of the shadow map's eye.
    light: Records,
    /// Targets of earlier images, used again.
    stations: Stations,
    /// Made when the first camera needs it.
    lens_pass: Option<LensPass>,
    /// What is behind, as it was given.
    backdrop: Backdrop,
    /// The layer that the backdrop's pattern was painted in.
    backdrop_layer: f32,
    /// How colours are made now.
    shading: Shading,
}

impl Renderer {
    /// Opens the best Vulkan device of the machine, a software one if there is no other, and
    /// uploads the meshes. Behind them is the inside of a body.
    ///
    /// The loader's own variables, `VK_DRIVER_FILES` and the like, decide which devices there are.
    ///
    /// # Errors
    /// No usable device, or a mesh that can't be drawn.
    pub fn new(visuals: &[Visual]) -> Result<Self, RenderError> {
        Self::with_backdrop(visuals, &Backdrop::CAVITY, Shading::default())
    }

    /// The same with something else behind and a choice of shading.
    ///
    /// # Errors
    /// As [`Self::new`].
    pub fn with_backdrop(
        visuals: &[Visual],
        backdrop: &Backdrop,
        shading: Shading,
    ) -> Result<Self, RenderError> {
        let _turn = OPENING.lock().unwrap_or_else(PoisonError::into_inner);
        let gpu = Gpu::open()?;
        let things = visuals.iter().map(Wanted::of);
        let squares = things.chain([Wanted::behind(backdrop)]);
        let paints = Paints::new(&gpu.device, &gpu.queue, squares);
        let mut scene = Scene::upload(&gpu.device, visuals, &paints)?;
        if shading == Shading::Fine {
            scene.bake(&gpu.queue);
        }
        let pipelines = Pipelines::new(&gpu.device, &paints, shading);
        let light = Records::new(&gpu.device, pipelines.records(), scene.part_count());
        gpu.finish()?;
        Ok(Self {
            gpu,
            scene,
            pipelines,
            light,
            stations: Stations::default(),
            lens_pass: None,
            backdrop: *backdrop,
            backdrop_layer: paints.layer(&Wanted::behind(backdrop)),
            shading,
        })
    }

    /// Name of the device and its driver.
    #[must_use]
    pub fn adapter_name(&self) -> &str {
        &self.gpu.name
    }

    /// Chooses how much work goes into the colours of the following images.
    ///
    /// Compiles the colour pipelines anew, and bakes the scene the first time that shading is fine;
    /// nothing if it is the shading already. Targets of the old shading are kept for a while.
    pub fn set_shading(&mut self, shading: Shading) {
        if self.shading != shading {
            self.shading = shading;
            let Gpu { device, queue, .. } = &self.gpu;
            if shading == Shading::Fine {
                self.scene.bake(queue);
            }
            self.pipelines.set_shading(device, shading);
        }
    }

    /// Bends the visual `index`: its vertices go to where `mesh` has them, for all following
    /// images. The triangles stay what they were; those of `mesh` are not looked at.
    ///
    /// Takes effect with the next image. Painted patterns stick to the vertices as they were
    /// uploaded; what was baked for fine shading stays as it was.
    ///
    /// # Errors
    /// No such visual, or another number of vertices.
    pub fn reshape(&mut self, index: usize, mesh: &Mesh) -> Result<(), RenderError> {
        self.scene.reshape(&self.gpu.queue, index, mesh)
    }

    /// Multiplies the linear RGB of the visuals by `tints`, in their order, for all following
    /// images; those beyond the last one have the colours that they came with.
    pub fn tint(&mut self, tints: impl IntoIterator<Item = [f32; 3]>) {
        self.scene.tint(tints);
    }

    /// Takes one image: `poses` are the visuals' poses in the scene frame, in their order.
    ///
    /// Fills colour, depth, ids, intrinsics and camera pose of `frame` and resizes its buffers if
    /// they do not fit; stamp and sequence stay the caller's. After an error the frame's content is
    /// unspecified.
    ///
    /// One submission and one wait; allocates a handful of small lists, and whatever the frame
    /// lacks. The thread blocks until the device is done.
    ///
    /// # Errors
    /// An image size, camera, light or number of poses that can't be, or a failing device.
    pub fn render(
        &mut self,
        poses: &[Pose],
        camera: &Camera,
        light: &Light,
        frame: &mut CameraFrame,
    ) -> Result<(), RenderError> {
        self.render_all(poses, light, &mut [(*camera, frame)])
    }

    /// Takes an image from each of several cameras at the same instant, the same as one by one, but
    /// without waiting for one before the next is begun, and with one shadow map for all.
    ///
    /// # Errors
    /// As [`Self::render`]; then the content of all frames is unspecified.
    pub fn render_all(
        &mut self,
        poses: &[Pose],
        light: &Light,
        shots: &mut [(Camera, &mut CameraFrame)],
    ) -> Result<(), RenderError> {
        let mut views = Vec::with_capacity(shots.len());
        for (camera, frame) in shots {
            camera.check(self.gpu.size_px_max)?;
            let pixels = camera.intrinsics.pixel_count();
            frame.colour.resize(3 * pixels, 0);
            frame.instance.resize(pixels, 0);
            frame.depth_m.resize(pixels, 0.0);
            frame.intrinsics = camera.intrinsics;
            frame.camera_in_scene = camera.camera_in_scene;
            let planes = Planes {
                colour: &mut frame.colour,
                depth_m: &mut frame.depth_m,
                instance: &mut frame.instance,
            };
            views.push((*camera, planes));
        }
        self.render_all_into(poses, light, &mut views)
    }

    /// Takes one image straight into the caller's buffers: `width * height` pixels, row-major from
    /// the top left.
    ///
    /// # Errors
    /// As [`Self::render`], and buffers of another size.
    pub fn render_into(
        &mut self,
        poses: &[Pose],
        camera: &Camera,
        light: &Light,
        planes: Planes<'_>,
    ) -> Result<(), RenderError> {
        self.render_all_into(poses, light, &mut [(*camera, planes)])
    }

    /// [`Self::render_all`] straight into the callers' buffers.
    ///
    /// # Errors
    /// As [`Self::render_into`].
    pub fn render_all_into(
        &mut self,
        poses: &[Pose],
        light: &Light,
        views: &mut [(Camera, Planes<'_>)],
    ) -> Result<(), RenderError> {
        light.check()?;
        for (camera, planes) in &*views {
            camera.check(self.gpu.size_px_max)?;
            planes.check(&camera.intrinsics)?;
        }
        let cameras = views.iter().map(|(camera, _)| camera);
        let plot = Plot {
            device: &self.gpu.device,
            records: self.pipelines.records(),
            parts: self.scene.part_count(),
            shading: self.shading,
            deferred: self.pipelines.deferred(),
            size_px_max: self.gpu.size_px_max,
        };
        self.stations.fit(&plot, cameras, &mut self.lens_pass)?;
        let mut submissions = Vec::with_capacity(views.len());
        for (index, (camera, _)) in views.iter().enumerate() {
            submissions.push(self.submit(poses, light, camera, index)?);
        }
        let stations = self.stations.iter();
        for ((station, submission), (_, planes)) in stations.zip(submissions).zip(views) {
            station.targets.read(&self.gpu, submission, planes)?;
        }
        Ok(())
    }

    /// Begins the image of one camera at its station; the first one's submission draws the shadow
    /// map for all.
    ///
    /// The order of the passes matters: with one sample a pixel colour is drawn on the labels'
    /// depth. The camera that is drawn may be wider than the one asked for, see `lens`.
    fn submit(
        &mut self,
        poses: &[Pose],
        light: &Light,
        camera: &Camera,
        index: usize,
    ) -> Result<wgpu::SubmissionIndex, RenderError> {
        let Some(station) = self.stations.get(index) else {
            return Err(RenderError::Gpu("no room for the image".to_owned()));
        };
        let queue = &self.gpu.queue;
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        if index == 0 && self.shading != Shading::Plain {
            self.scene
                .place(queue, &self.light, poses, &Eye::light(light))?;
            self.pipelines
                .draw_shadow_map(&mut encoder, &self.scene, &self.light);
        }
        let Station { targets, records } = station;
        let lens = targets.lens.as_ref();
        let intrinsics = &camera.intrinsics;
        let pinhole = Camera {
            intrinsics: lens.map_or(*intrinsics, |lens| lens.pinhole(intrinsics)),
            ..*camera
        };
        let eye = Eye::camera(
            light,
            View {
                camera: &pinhole,
                backdrop: &self.backdrop,
                backdrop_layer: self.backdrop_layer,
                shadow_map_px: SHADOW_MAP_PX,
                exposure: if self.shading.shows_optics() {
                    camera.optics.exposure
                } else {
                    1.0
                },
            },
        );
        self.scene.place(queue, records, poses, &eye)?;
        self.pipelines.draw_labels(
            &mut targets.begin_labels(&mut encoder),
            &self.scene,
            records,
        );
        self.pipelines
            .draw_colour(&mut encoder, targets, &self.scene, records)?;
        if let (Some(lens), Some(pass)) = (lens, &self.lens_pass) {
            lens.place(queue, camera, self.shading.shows_optics());
            pass.draw(&mut targets.begin_picture(&mut encoder), lens);
        }
        targets.copy(&mut encoder);
        let submission = queue.submit([encoder.finish()]);
        targets.ask();
        Ok(submission)
    }
}

#[cfg(test)]
mod tests;
