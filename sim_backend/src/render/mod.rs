//! The off-screen renderer: colour, metric depth and instance ids of a scene, as an endoscope sees it.
//!
//! Everything is drawn in one pass on any Vulkan device; a software rasteriser is enough. Coordinates go to the device
//! relative to the camera, so that single precision is never spent on where the camera is. What the surfaces look
//! like is in `surface.wgsl`. On one device and driver the same inputs give the same bytes.

mod camera;
mod gpu;
mod pipelines;
mod scene;
mod targets;

#[cfg(test)]
mod tests;

use hal::{CameraFrame, Intrinsics, Pose};

pub use camera::{Camera, Light, look_at};

use crate::visual::{Mesh, Visual};
use gpu::Gpu;
use pipelines::Pipelines;
use scene::Scene;
use targets::Targets;

/// Why there is no image.
#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// The Vulkan loader or every driver is missing.
    #[error(
        "no Vulkan device: install a GPU driver, or mesa-vulkan-drivers to render in software (see VK_DRIVER_FILES)"
    )]
    NoAdapter,
    /// The driver is there and refuses.
    #[error("the Vulkan device {adapter} can't be opened: {reason}")]
    Device {
        /// Which one.
        adapter: String,
        /// What it says.
        reason: String,
    },
    /// A mesh can't be drawn.
    #[error("mesh of {name}: {reason}")]
    Mesh {
        /// Name of the visual.
        name: &'static str,
        /// What is wrong.
        reason: &'static str,
    },
    /// The image is empty or larger than the device allows.
    #[error("image of {width} x {height} pixels: each side must be in 1..={max}")]
    ImageSize {
        /// Asked width.
        width: u32,
        /// Asked height.
        height: u32,
        /// Largest side.
        max: u32,
    },
    /// The caller's buffers do not fit the image.
    #[error("the buffers given are not for an image of {pixels} pixels")]
    Buffers {
        /// Pixels of the image.
        pixels: usize,
    },
    /// The camera can't be.
    #[error("camera: {0}")]
    Camera(&'static str),
    /// The light can't be.
    #[error("light: {0}")]
    Light(&'static str),
    /// One pose a visual is needed.
    #[error("{got} poses for {expected} visuals")]
    PoseCount {
        /// Visuals in the scene.
        expected: usize,
        /// Poses given.
        got: usize,
    },
    /// The device failed at work.
    #[error("Vulkan: {0}")]
    Gpu(String),
}

/// The buffers of one image.
#[derive(Debug)]
pub struct Planes<'a> {
    /// sRGB bytes, 3 a pixel.
    pub colour: &'a mut [u8],
    /// Distance along the camera's z axis, metres; 0 where nothing was hit.
    pub depth_m: &'a mut [f32],
    /// Instance id of what was hit; 0 is background.
    pub instance: &'a mut [u8],
}

impl Planes<'_> {
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

/// How much work goes into an image; depth and ids do not depend on it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Quality {
    /// Shadows from the light.
    #[default]
    Shadows,
    /// No shadows, cheaper.
    Plain,
}

/// Draws one fixed set of visuals, which may move and bend, from any number of cameras.
pub struct Renderer {
    gpu: Gpu,
    scene: Scene,
    pipelines: Pipelines,
    targets: Option<Targets>,
    quality: Quality,
}

impl Renderer {
    /// Opens the best Vulkan device of the machine, a software one if there is no other, and uploads the meshes.
    ///
    /// The loader's own variables, `VK_DRIVER_FILES` and the like, decide which devices there are.
    ///
    /// # Errors
    /// No usable device, or a mesh that can't be drawn.
    pub fn new(visuals: &[Visual]) -> Result<Self, RenderError> {
        let gpu = Gpu::open()?;
        let scene = Scene::upload(&gpu.device, visuals)?;
        let pipelines = Pipelines::new(&gpu.device, &scene);
        gpu.check()?;
        Ok(Self {
            gpu,
            scene,
            pipelines,
            targets: None,
            quality: Quality::default(),
        })
    }

    /// Name of the device and its driver.
    #[must_use]
    pub fn adapter_name(&self) -> &str {
        &self.gpu.name
    }

    /// Chooses how much work goes into the following images; [`Quality::Shadows`] at first.
    pub const fn set_quality(&mut self, quality: Quality) {
        self.quality = quality;
    }

    /// Bends the visual `index`: its vertices go to where `mesh` has them, for all following images. The triangles stay what
    /// they were; those of `mesh` are not looked at.
    ///
    /// # Errors
    /// No such visual, or another number of vertices.
    pub fn reshape(&mut self, index: usize, mesh: &Mesh) -> Result<(), RenderError> {
        self.scene.reshape(&self.gpu.queue, index, mesh)
    }

    /// Takes one image: `poses` are the visuals' poses in the scene frame, in their order.
    ///
    /// Fills colour, depth, ids, intrinsics and camera pose of `frame` and resizes its buffers if they do not fit;
    /// stamp and sequence stay the caller's. After an error the frame's content is unspecified.
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
        camera.check(self.gpu.size_px_max)?;
        let pixels = camera.intrinsics.pixel_count();
        frame.colour.resize(3 * pixels, 0);
        frame.instance.resize(pixels, 0);
        frame.depth_m.resize(pixels, 0.0);
        let planes = Planes {
            colour: &mut frame.colour,
            depth_m: &mut frame.depth_m,
            instance: &mut frame.instance,
        };
        self.render_into(poses, camera, light, planes)?;
        frame.intrinsics = camera.intrinsics;
        frame.camera_in_scene = camera.camera_in_scene;
        Ok(())
    }

    /// Takes one image straight into the caller's buffers: `width * height` pixels, row-major from the top left.
    ///
    /// # Errors
    /// As [`Self::render`], and buffers of another size.
    pub fn render_into(
        &mut self,
        poses: &[Pose],
        camera: &Camera,
        light: &Light,
        mut planes: Planes<'_>,
    ) -> Result<(), RenderError> {
        camera.check(self.gpu.size_px_max)?;
        planes.check(&camera.intrinsics)?;
        light.check()?;
        self.scene.place(&self.gpu.queue, poses, camera, light)?;
        let targets = match self.targets.take() {
            Some(targets) if targets.fits(&camera.intrinsics) => targets,
            Some(_) | None => Targets::new(&self.gpu.device, &camera.intrinsics),
        };
        let mut encoder = self
            .gpu
            .device
            .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        let shadows = self.quality == Quality::Shadows;
        if shadows {
            self.pipelines.draw_shadow_map(&mut encoder, &self.scene);
        }
        self.pipelines
            .draw_scene(&mut targets.begin(&mut encoder), &self.scene, shadows);
        targets.copy(&mut encoder);
        self.gpu.queue.submit([encoder.finish()]);
        targets.read(&self.gpu, &mut planes)?;
        self.targets = Some(targets);
        Ok(())
    }
}
