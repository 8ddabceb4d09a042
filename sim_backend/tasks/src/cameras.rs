//! A task's cameras: they render a snapshot of the scene, in whatever thread they live. Nothing is
//! drawn for a camera that no image is requested.

mod flap;
mod model;

use hal::{CameraFrame, Intrinsics, Mesh, Pose};
use nalgebra::{Point3, Vector3};
use trocar_render::visual::instance;
use trocar_render::{Camera, Light, Optics, Planes, RenderError, Renderer, Shading, look_at};

use crate::SimulationError;
use crate::scene::SceneSnapshot;
use crate::task::{
    Appearance, CameraConfig, Drawn, TaskConfig, TaskScene, scene_poses, scene_visuals,
};
use flap::DrawnFlap;

pub use model::SceneModel;

/// Image depth range, m.
const NEAR_M: f64 = 0.005;
const FAR_M: f64 = 1.0;

/// From which angle between their views on a camera looks across the endoscope's light, rad: more
/// than two eyes are apart.
const ACROSS_RAD: f64 = 0.35;

/// The cameras of one task, their light and the device that draws.
pub struct SceneCameras {
    renderer: Renderer,
    scene: Box<dyn TaskScene>,
    views: Vec<View>,
    flap: Option<DrawnFlap>,
    /// The endoscope: all cameras see in its light.
    endoscope: usize,
    /// How that differs from the scene file in this episode, if it does.
    look: Option<Appearance>,
    /// Names of the visuals.
    visuals: Vec<&'static str>,
    /// Visuals of this episode whose shape the renderer does not have yet.
    reshaped: Vec<(usize, Mesh)>,
}

/// A camera and what carries it.
struct View {
    name: String,
    intrinsics: Intrinsics,
    /// In the scene frame, or in the tip frame of the arm that carries it.
    camera_in_mount: Pose,
    carrier: Option<usize>,
    optics: Optics,
}

impl SceneCameras {
    /// Opens a device for the cameras of `task`, which stand as the file says until an episode
    /// begins.
    ///
    /// # Errors
    /// [`SimulationError::Render`] if there is no device to render with.
    pub fn new(task: &TaskConfig) -> Result<Self, SimulationError> {
        let visuals = scene_visuals(task);
        let backdrop = task.scene.backdrop();
        let renderer = Renderer::with_backdrop(&visuals, &backdrop, task.shading)?;
        let views = View::all(task);
        Ok(Self {
            renderer,
            scene: task.scene.clone(),
            views,
            flap: DrawnFlap::new(&*task.scene, &visuals),
            endoscope: task.light_camera(),
            look: None,
            visuals: visuals.iter().map(|visual| visual.name).collect(),
            reshaped: Vec::new(),
        })
    }

    /// Puts the cameras where `task` has them in the episode `seed`, and shows its needle in its
    /// light through its lenses: its view and what it varies may be others in each.
    pub fn begin_episode(&mut self, task: &TaskConfig, seed: u64) {
        let drawn = task.drawn(seed);
        self.views = View::of_episode(task, seed, &drawn);
        self.endoscope = task.light_camera();
        if drawn.needle.is_some() {
            self.scene = task.scene_of(seed);
            let visuals = self.scene.visuals().into_iter().enumerate();
            let needles = visuals.filter(|(_, visual)| visual.instance == instance::NEEDLE);
            self.reshaped = needles
                .map(|(index, visual)| (index, visual.mesh))
                .collect();
        }
        self.look = drawn.light;
        let looks = self.look.iter();
        let tints = looks.flat_map(|look| look.tints_of(&self.visuals));
        self.renderer.tint(tints);
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
        Ok(self.view(camera)?.intrinsics)
    }

    /// The pose of a camera in the scene frame at the instant of `snapshot`.
    ///
    /// # Errors
    /// [`SimulationError::NoSuchCamera`], [`SimulationError::NoCarrier`].
    pub fn pose(&self, camera: usize, snapshot: &SceneSnapshot) -> Result<Pose, SimulationError> {
        self.view(camera)?.camera_in_scene(snapshot)
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
        let (camera, light) = (self.placed(camera, snapshot)?, self.light(snapshot)?);
        let poses = scene_poses(&*self.scene, snapshot);
        self.bend(snapshot)?;
        self.renderer.render(&poses, &camera, &light, frame)?;
        Ok(())
    }

    /// Takes an image from each of the cameras `which` into the frame at its place in `frames`: the
    /// same as one by one, but without waiting for one before the next is begun.
    ///
    /// # Errors
    /// As [`Self::render`]; then the content of all frames is unspecified.
    pub fn render_all(
        &mut self,
        which: &[usize],
        snapshot: &SceneSnapshot,
        frames: &mut [CameraFrame],
    ) -> Result<(), SimulationError> {
        let light = self.light(snapshot)?;
        let poses = scene_poses(&*self.scene, snapshot);
        let mut shots = Vec::with_capacity(which.len());
        for (&camera, frame) in which.iter().zip(frames) {
            shots.push((self.placed(camera, snapshot)?, frame));
        }
        self.bend(snapshot)?;
        self.renderer.render_all(&poses, &light, &mut shots)?;
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
        let (camera, light) = (self.placed(camera, snapshot)?, self.light(snapshot)?);
        let poses = scene_poses(&*self.scene, snapshot);
        self.bend(snapshot)?;
        self.renderer.render_into(&poses, &camera, &light, planes)?;
        Ok(())
    }

    /// Gives the needle the shape of this episode, and the flap the one that it has in `snapshot`.
    fn bend(&mut self, snapshot: &SceneSnapshot) -> Result<(), RenderError> {
        for (index, mesh) in self.reshaped.drain(..) {
            self.renderer.reshape(index, &mesh)?;
        }
        if let (Some(drawn), Some(flap)) = (&mut self.flap, &snapshot.flap)
            && drawn.bend(flap)
        {
            for (index, mesh) in drawn.meshes() {
                self.renderer.reshape(index, mesh)?;
            }
        }
        Ok(())
    }

    /// A camera where it is now.
    fn placed(&self, camera: usize, snapshot: &SceneSnapshot) -> Result<Camera, SimulationError> {
        let view = self.view(camera)?;
        Ok(Camera {
            intrinsics: view.intrinsics,
            camera_in_scene: view.camera_in_scene(snapshot)?,
            near_m: NEAR_M,
            far_m: FAR_M,
            optics: Optics {
                moment: snapshot.moment_ms,
                ..view.optics
            },
        })
    }

    /// The light of the endoscope, in which all cameras see.
    fn light(&self, snapshot: &SceneSnapshot) -> Result<Light, SimulationError> {
        let light = Light::beside(&self.placed(self.endoscope, snapshot)?);
        Ok(self.look.as_ref().map_or(light, |look| look.lit(&light)))
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
    /// The cameras of `task` where they stand in the episode `seed`, for which `drawn` was drawn.
    fn of_episode(task: &TaskConfig, seed: u64, drawn: &Drawn) -> Vec<Self> {
        let mut views = Self::all(task);
        for (view, camera) in views.iter_mut().zip(&task.cameras) {
            view.camera_in_mount *= task.view.shift(camera, seed);
            if let Some(lens) = drawn.lenses.get(&camera.name) {
                view.intrinsics = lens.of(&view.intrinsics);
                let exposure = view.optics.exposure * lens.exposure;
                view.optics = Optics {
                    exposure,
                    ..lens.optics()
                };
            }
        }
        views
    }

    /// The cameras of `task` as the file has them. Those that look across the endoscope's light are
    /// exposed for people's eyes if the pictures are for them.
    fn all(task: &TaskConfig) -> Vec<Self> {
        let mut views: Vec<Self> = task.cameras.iter().map(Self::new).collect();
        let along = |view: &Self| view.camera_in_mount * Vector3::z();
        let light = views.get(task.light_camera()).map(along);
        if let (Shading::Fine, Some(light)) = (task.shading, light) {
            let across =
                |view: &&mut Self| view.carrier.is_none() && along(view).angle(&light) > ACROSS_RAD;
            for view in views.iter_mut().filter(across) {
                view.optics.exposure = task.scene.backdrop().across;
            }
        }
        views
    }

    fn new(config: &CameraConfig) -> Self {
        let (eye, target) = (Point3::from(config.eye_m), Point3::from(config.target_m));
        Self {
            name: config.name.clone(),
            intrinsics: config.intrinsics(),
            camera_in_mount: look_at(eye, target, Vector3::from(config.up)),
            carrier: config.carrier(),
            optics: config.optics(),
        }
    }

    fn camera_in_scene(&self, snapshot: &SceneSnapshot) -> Result<Pose, SimulationError> {
        let Some(arm) = self.carrier else {
            return Ok(self.camera_in_mount);
        };
        let bodies = snapshot.arms.get(arm).copied().flatten();
        let bodies = bodies.ok_or_else(|| SimulationError::NoCarrier {
            camera: self.name.clone(),
            arm,
        })?;
        Ok(bodies.tip * self.camera_in_mount)
    }
}
