//! A patient on a turntable, as pictures that a person looks at.

use core::f64::consts::{FRAC_PI_2, TAU};
use std::path::{Path, PathBuf};

use hal::mesh::single;
use hal::{CameraFrame, Intrinsics, Pose};
use nalgebra::{Point3, Vector3};
use trocar_anatomy::assets::{self, Part};
use trocar_render::visual::{Backdrop, Visual, instance};
use trocar_render::{Camera, Light, Optics, Renderer, Shading, look_at};
use trocar_tasks::SimulationError;
use trocar_tasks::task::tissue_material;

use super::SessionError;
use super::pictures::Thumbnails;

/// The group that holds all others; they are seen without it.
const SKIN: &str = "body";
/// Field of view, rad, and how much of it the patient fills.
const VIEW_RAD: f64 = 0.5;
const FILLED: f64 = 1.0;
/// How far above the patient's middle the camera is, as a share of its distance.
const ABOVE: f64 = 0.25;
/// One turn, ms.
const TURN_MS: u32 = 4000;
/// Radius of the model that stands for the patient, m: the renderer's surroundings are of the size
/// of a belly.
const MODEL_M: f64 = 0.060;
/// Brightness on the model, as a share of an endoscope's on what it looks at: bones are light.
const BRIGHT: f64 = 0.7;
/// Height of the table under it, m.
const TABLE_M: f64 = -0.066;

/// What to draw.
#[derive(Clone, Debug)]
pub struct Preview {
    /// The patient's folder, or a file of another program.
    pub patient: PathBuf,
    /// The groups; all but the skin if there are none.
    pub groups: Vec<String>,
    /// The file: a GIF, or a PNG with the pictures side by side.
    pub out: PathBuf,
    /// Side of an image, pixels.
    pub width: u32,
    /// Pictures of a turn.
    pub frames: u32,
}

/// The ball that everything lies in, in the scan's world.
struct Ball {
    middle: Point3<f64>,
    radius_m: f64,
}

/// Draws a turn of a patient, which `trocar anatomy build` made; `done` is told how many pictures
/// there are.
///
/// # Errors
/// [`SessionError::BadArgument`] for a folder without a patient, a group that it has not, and a
/// file that is neither GIF nor PNG; [`SessionError::Simulation`] without a device that draws,
/// [`SessionError::Output`] if the file can't be written.
pub fn draw(preview: &Preview, done: &mut dyn FnMut(u32)) -> Result<(), SessionError> {
    let is_gif = is_gif(&preview.out)?;
    let parts = chosen(preview)?;
    let ball = Ball::around(&parts);
    let visuals: Vec<Visual> = parts.into_iter().map(|part| ball.model(part)).collect();
    let backdrop = Backdrop::table(TABLE_M, [0.2, 0.05, 0.03]);
    let mut renderer = Renderer::with_backdrop(&visuals, &backdrop, Shading::Fine)
        .map_err(SimulationError::from)?;
    let poses = vec![Pose::identity(); visuals.len()];
    let mut pictures = Thumbnails::default();
    for index in 0..preview.frames {
        let camera = camera(preview.width, f64::from(index) / f64::from(preview.frames));
        let mut frame = CameraFrame::blank(camera.intrinsics);
        let drawn = renderer.render(&poses, &camera, &light(&camera), &mut frame);
        drawn.map_err(SimulationError::from)?;
        pictures.push_whole(&frame);
        done(index + 1);
    }
    if is_gif {
        pictures.write_gif(&preview.out, TURN_MS / preview.frames)
    } else {
        pictures.write_strip(&preview.out, preview.frames, 1)
    }
}

/// Whether the file is a GIF; else it is a PNG.
fn is_gif(out: &Path) -> Result<bool, SessionError> {
    match out.extension().and_then(|ending| ending.to_str()) {
        Some("gif") => Ok(true),
        Some("png") => Ok(false),
        _ => Err(refused(&format!(
            "--out {}: a preview is a .gif or a .png",
            out.display()
        ))),
    }
}

fn refused(reason: &str) -> SessionError {
    SessionError::BadArgument(reason.to_owned())
}

/// The groups that are asked for.
fn chosen(preview: &Preview) -> Result<Vec<Part>, SessionError> {
    let parts = assets::read(&preview.patient).map_err(|error| refused(&error.to_string()))?;
    let known = |name: &String| parts.iter().any(|part| part.name == *name);
    if let Some(name) = preview.groups.iter().find(|name| !known(name)) {
        let names: Vec<&str> = parts.iter().map(|part| part.name.as_str()).collect();
        let (folder, names) = (preview.patient.display(), names.join(", "));
        return Err(refused(&format!("--groups {name}: {folder} has {names}")));
    }
    let shown = |part: &Part| match preview.groups.as_slice() {
        [] => part.name != SKIN,
        groups => groups.contains(&part.name),
    };
    Ok(parts.into_iter().filter(shown).collect())
}

impl Ball {
    fn around(parts: &[Part]) -> Self {
        let all = || parts.iter().flat_map(|part| &part.mesh.positions);
        let along = |axis: usize, choose: fn(f32, f32) -> f32| {
            let extreme = all().map(|p| p[axis]).reduce(choose);
            f64::from(extreme.unwrap_or(0.0))
        };
        let low = Point3::from([0, 1, 2].map(|axis| along(axis, f32::min)));
        let high = Point3::from([0, 1, 2].map(|axis| along(axis, f32::max)));
        Self {
            middle: nalgebra::center(&low, &high),
            radius_m: 0.5 * (high - low).norm().max(1e-3),
        }
    }

    /// A group of the model, whose middle is the origin.
    fn model(&self, mut part: Part) -> Visual {
        let material = tissue_material(&part);
        for position in &mut part.mesh.positions {
            let from_middle = Point3::from(position.map(f64::from)) - self.middle;
            *position = single(&(from_middle * (MODEL_M / self.radius_m)));
        }
        Visual::new("tissue", part.mesh, material, instance::ORGAN)
    }
}

/// The camera after a share of a turn, in front of the patient at first.
fn camera(width: u32, turn: f64) -> Camera {
    let distance_m = MODEL_M / (FILLED * 0.5 * VIEW_RAD).sin();
    let (sin, cos) = (FRAC_PI_2 + TAU * turn).sin_cos();
    let eye = Point3::from(distance_m * Vector3::new(cos, sin, ABOVE));
    Camera {
        intrinsics: Intrinsics::from_vertical_fov(width, width, VIEW_RAD),
        camera_in_scene: look_at(eye, Point3::origin(), Vector3::z()),
        near_m: 0.2 * distance_m,
        far_m: 4.0 * distance_m,
        optics: Optics::CLEAN,
    }
}

/// The light beside it.
fn light(camera: &Camera) -> Light {
    let light = Light::beside(camera);
    Light {
        reference_distance_m: camera.camera_in_scene.translation.vector.norm(),
        intensity: BRIGHT * light.intensity,
        ..light
    }
}
