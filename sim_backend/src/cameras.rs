//! A task's cameras: they render a snapshot of the scene, in whatever thread they live.

use hal::{CameraFrame, Intrinsics, Pose};
use nalgebra::{Point3, Vector3};

use crate::render::{Camera, Light, Planes, Renderer, look_at};
use crate::simulation::SimulationError;
use crate::task::{ARMS_MAX, CameraConfig, Scene, THINGS_MAX, TaskConfig};
use crate::task::{scene_poses, scene_visuals};
use crate::world::ArmBodies;

/// Image depth range, m.
const NEAR_M: f64 = 0.005;
const FAR_M: f64 = 1.0;

/// Where everything that moves is at one instant, in the scene frame.
#[derive(Clone, Copy, Debug)]
pub struct SceneSnapshot {
    /// The things that move, as many as the task has.
    pub things: [Pose; THINGS_MAX],
    /// The place where something is to be brought, if the task has one.
    pub goal: Pose,
    /// The instruments' parts.
    pub arms: [Option<ArmBodies>; ARMS_MAX],
}

/// The cameras of one task, their light and the device that draws.
pub struct SceneCameras {
    renderer: Renderer,
    scene: Scene,
    views: Vec<View>,
    light: Light,
}

struct View {
    name: String,
    camera: Camera,
}

impl SceneCameras {
    /// Opens a device for the cameras of `task`.
    ///
    /// # Errors
    /// [`SimulationError::Render`] if there is no device to render with.
    pub fn new(task: &TaskConfig) -> Result<Self, SimulationError> {
        let backdrop = task.scene.of_task().backdrop();
        let renderer = Renderer::with_backdrop(&scene_visuals(task), &backdrop, task.shading)?;
        let views: Vec<View> = task.cameras.iter().map(View::new).collect();
        // The endoscope comes first, and all cameras see in its light.
        let endoscope = views.first().map(|view| Light::beside(&view.camera));
        Ok(Self {
            renderer,
            scene: task.scene.clone(),
            views,
            light: endoscope.unwrap_or_default(),
        })
    }

    /// How many cameras there are.
    #[must_use]
    pub const fn count(&self) -> usize {
        self.views.len()
    }

    /// Names of the cameras, in order.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.views.iter().map(|view| view.name.as_str())
    }

    /// The index of the camera called `name`.
    #[must_use]
    pub fn find(&self, name: &str) -> Option<usize> {
        self.names().position(|camera| camera == name)
    }

    /// Name of the device that draws.
    #[must_use]
    pub fn adapter_name(&self) -> &str {
        self.renderer.adapter_name()
    }

    /// The name of a camera.
    ///
    /// # Errors
    /// [`SimulationError::NoSuchCamera`], as of every function here that takes an index.
    pub fn name(&self, camera: usize) -> Result<&str, SimulationError> {
        Ok(&self.view(camera)?.name)
    }

    /// The lens of a camera.
    ///
    /// # Errors
    /// [`SimulationError::NoSuchCamera`].
    pub fn intrinsics(&self, camera: usize) -> Result<Intrinsics, SimulationError> {
        Ok(self.view(camera)?.camera.intrinsics)
    }

    /// The pose of a camera in the scene frame.
    ///
    /// # Errors
    /// [`SimulationError::NoSuchCamera`].
    pub fn pose(&self, camera: usize) -> Result<Pose, SimulationError> {
        Ok(self.view(camera)?.camera.camera_in_scene)
    }

    /// A black frame of the right size.
    ///
    /// # Errors
    /// [`SimulationError::NoSuchCamera`].
    pub fn blank_frame(&self, camera: usize) -> Result<CameraFrame, SimulationError> {
        Ok(CameraFrame::blank(self.intrinsics(camera)?))
    }

    /// Takes one image of `snapshot`; stamp and sequence of the frame stay the caller's.
    ///
    /// # Errors
    /// [`SimulationError`]; the frame's content is then unspecified.
    pub fn render(
        &mut self,
        camera: usize,
        snapshot: &SceneSnapshot,
        frame: &mut CameraFrame,
    ) -> Result<(), SimulationError> {
        let camera = self.view(camera)?.camera;
        let poses = scene_poses(&self.scene, snapshot);
        self.renderer.render(&poses, &camera, &self.light, frame)?;
        Ok(())
    }

    /// Takes one image of `snapshot` straight into the caller's buffers, shared memory for example.
    ///
    /// # Errors
    /// [`SimulationError`], also for buffers of the wrong size; their content is then unspecified.
    pub fn render_into(
        &mut self,
        camera: usize,
        snapshot: &SceneSnapshot,
        planes: Planes<'_>,
    ) -> Result<(), SimulationError> {
        let camera = self.view(camera)?.camera;
        let poses = scene_poses(&self.scene, snapshot);
        self.renderer
            .render_into(&poses, &camera, &self.light, planes)?;
        Ok(())
    }

    fn view(&self, camera: usize) -> Result<&View, SimulationError> {
        let count = self.views.len();
        self.views.get(camera).ok_or(SimulationError::NoSuchCamera {
            index: camera,
            count,
        })
    }
}

impl View {
    fn new(config: &CameraConfig) -> Self {
        let camera_in_scene = look_at(
            Point3::from(config.eye_m),
            Point3::from(config.target_m),
            Vector3::from(config.up),
        );
        let camera = Camera {
            intrinsics: config.intrinsics(),
            camera_in_scene,
            near_m: NEAR_M,
            far_m: FAR_M,
        };
        Self {
            name: config.name.clone(),
            camera,
        }
    }
}
