//! Other places for a task's cameras, to see how a policy does from where it was not trained.

use core::f64::consts::PI;

use hal::Pose;
use nalgebra::{Translation3, UnitQuaternion};
use trocar_world::rng::Rng;

use super::TaskConfig;
use super::camera::{CameraConfig, ENDOSCOPE, Mount, SIDE};

/// How far [`View::View1`] moves a camera along each of its axes at most, m (Moghani et al.,
/// "SuFIA-BC", 2025).
pub const VIEW1_SHIFT_M: f64 = 0.01;

/// How far it turns one about each of its axes at most, rad (same source).
pub const VIEW1_TURN_RAD: f64 = 5.0 * PI / 180.0;

/// How the cameras stand against where the scene file has them. Wrist cameras stay as they are in
/// every view.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum View {
    /// As in the file.
    #[default]
    Train,
    /// Each camera shifted along and turned about its own axes, each by a number that is uniform
    /// within [`VIEW1_SHIFT_M`] and [`VIEW1_TURN_RAD`] and depends on the episode's seed and the
    /// camera's name.
    View1,
    /// Endoscope and side camera swapped: each has the place and the lens of the other, and keeps
    /// its name.
    View2,
}

impl View {
    /// All views.
    pub const ALL: [Self; 3] = [Self::Train, Self::View1, Self::View2];

    /// The name on the command line and in results.
    #[must_use]
    pub const fn name(self) -> &'static str {
        match self {
            Self::Train => "train",
            Self::View1 => "view1",
            Self::View2 => "view2",
        }
    }

    /// What `camera` is moved by in the episode `seed`: its new pose in its old frame.
    pub(crate) fn shift(self, camera: &CameraConfig, seed: u64) -> Pose {
        match (self, camera.mount) {
            (Self::View1, Mount::Scene) => {
                // A stream each, so that no camera's place depends on what other cameras there are.
                let mut rng = Rng::stream(seed, &format!("view1 {}", camera.name));
                let [x, y, z] = [(); 3].map(|()| rng.range(-VIEW1_SHIFT_M, VIEW1_SHIFT_M));
                let [a, b, c] = [(); 3].map(|()| rng.range(-VIEW1_TURN_RAD, VIEW1_TURN_RAD));
                Pose::from_parts(
                    Translation3::new(x, y, z),
                    UnitQuaternion::from_euler_angles(a, b, c),
                )
            }
            (Self::View1, Mount::Wrist) | (Self::Train | Self::View2, _) => Pose::identity(),
        }
    }
}

/// The requested view needs a camera that the task lacks.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{task} has no camera {camera:?}, which {} swaps", View::View2.name())]
pub struct NoSuchView {
    /// The task.
    pub task: String,
    /// The camera that it lacks.
    pub camera: &'static str,
}

impl TaskConfig {
    /// The same task seen from `view`; from [`View::Train`] before.
    ///
    /// # Errors
    /// [`NoSuchView`] if [`View::View2`] has nothing to swap.
    pub fn with_view(mut self, view: View) -> Result<Self, NoSuchView> {
        self.view = view;
        if view == View::View2 {
            let (endoscope, side) = (self.standing(ENDOSCOPE)?, self.standing(SIDE)?);
            let (there, here) = (self.cameras[side].clone(), self.cameras[endoscope].clone());
            self.cameras[endoscope].stand_as(&there);
            self.cameras[side].stand_as(&here);
        }
        Ok(self)
    }

    /// The index of the camera with the light guide: the one at the place of the endoscope, or the
    /// first of a task that has none.
    pub(crate) fn light_camera(&self) -> usize {
        let there = match self.view {
            View::Train | View::View1 => ENDOSCOPE,
            View::View2 => SIDE,
        };
        self.standing(there).unwrap_or(0)
    }

    /// The index of the camera called `name`, which stands in the scene.
    fn standing(&self, name: &'static str) -> Result<usize, NoSuchView> {
        let stands = |camera: &CameraConfig| camera.name == name && camera.mount == Mount::Scene;
        self.cameras.iter().position(stands).ok_or(NoSuchView {
            task: self.name.clone(),
            camera: name,
        })
    }
}

impl CameraConfig {
    /// Takes over place and lens, in pictures of its own size.
    fn stand_as(&mut self, other: &Self) {
        let mut seen = other.clone();
        seen.resize(self.width, self.height);
        self.vertical_fov_rad = seen.vertical_fov_rad;
        self.calibration = seen.calibration;
        self.distortion = other.distortion;
        self.vignette = other.vignette;
        self.eye_m = other.eye_m;
        self.target_m = other.target_m;
        self.up = other.up;
    }
}

#[cfg(test)]
mod tests;
