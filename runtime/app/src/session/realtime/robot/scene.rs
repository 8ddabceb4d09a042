//! A robot's instruments in three dimensions, for the pages of a console: where its arms are
//! measured, and its cameras where they say they are.

use hal::{ArmState, Intrinsics, PerArm, Pose, TimeNs};
use trocar_control::config::ArmConfig;
use trocar_control::motion::MotionState;
use trocar_tasks::cameras::SceneModel;

use crate::console::{BETWEEN_NS, Console, SceneTap, is_placed, of_arms};
use crate::session::SessionError;

/// For so long after the first measurement the scene waits for the first frame of each camera, ns:
/// it has those that have said where they are.
const CAMERAS_NS: u64 = 1_000_000_000;

/// The scene, which begins with the first measurement: where the arms are before is not known.
pub(in super::super) struct ArmsScene {
    console: Console,
    arms: Vec<ArmConfig>,
    cameras: Vec<Camera>,
    /// When the arms were measured first, and when pages were shown them last.
    first: Option<TimeNs>,
    shown: Option<TimeNs>,
    tap: Option<SceneTap>,
}

/// A camera, and what it said of itself last.
struct Camera {
    name: String,
    said: Option<(Intrinsics, Pose)>,
    /// Its place among the cameras of the scene, if it is one of them.
    in_scene: Option<usize>,
}

impl ArmsScene {
    /// That of these `arms` on the pages of `console`, with the cameras of these names, in the
    /// order of their indices.
    pub(in super::super) fn new(console: &Console, arms: &[ArmConfig], names: &[String]) -> Self {
        let cameras = names.iter().map(|name| Camera {
            name: name.clone(),
            said: None,
            in_scene: None,
        });
        Self {
            console: console.clone(),
            arms: arms.to_vec(),
            cameras: cameras.collect(),
            first: None,
            shown: None,
            tap: None,
        }
    }

    /// Takes in what the camera of this index says of itself in a frame.
    pub(super) fn saw(&mut self, camera: usize, lens: &Intrinsics, camera_in_scene: &Pose) {
        let Some(camera) = self.cameras.get_mut(camera) else {
            return;
        };
        camera.said = Some((*lens, *camera_in_scene));
        if let (Some(tap), Some(index)) = (&mut self.tap, camera.in_scene)
            && is_placed(lens, camera_in_scene)
        {
            tap.move_camera(index, camera_in_scene);
        }
    }

    /// Shows the arms as they were measured, unless the last time is less than a thirtieth of a
    /// second ago, or a measurement is non-finite.
    ///
    /// # Errors
    /// [`SessionError::Simulation`] if the scene can't be shown.
    pub(super) fn show(&mut self, measured: &PerArm<ArmState>) -> Result<(), SessionError> {
        let at = measured.first.stamp;
        let soon = |shown: TimeNs| shown <= at && at.since(shown) < BETWEEN_NS;
        if self.shown.is_some_and(soon) || !measured.iter().all(ArmState::is_finite) {
            return Ok(());
        }
        let first = *self.first.get_or_insert(at);
        let waits = self.cameras.iter().any(|camera| camera.said.is_none());
        if self.tap.is_none() && waits && at.since(first) < CAMERAS_NS {
            return Ok(());
        }
        self.shown = Some(at);
        let bases = self.arms.iter().map(|arm| arm.scene_from_rcm);
        let axes = measured
            .iter()
            .map(|arm| MotionState::at_rest(arm).position);
        let snapshot = of_arms(bases.zip(axes));
        let tap = match &mut self.tap {
            Some(tap) => tap,
            None => {
                let model = SceneModel::of_arms(self.arms.len()).seen_by(placed(&mut self.cameras));
                let tap = self.console.add_scene(model, &snapshot, &self.arms)?;
                self.tap.insert(tap)
            }
        };
        Ok(tap.show(&snapshot, at)?)
    }
}

/// The cameras that have said where they are, each of which gets its place among them.
fn placed(cameras: &mut [Camera]) -> Vec<(String, Intrinsics, Pose)> {
    let mut found = Vec::new();
    for camera in cameras {
        if let Some((lens, pose)) = camera.said.filter(|(lens, pose)| is_placed(lens, pose)) {
            camera.in_scene = Some(found.len());
            found.push((camera.name.clone(), lens, pose));
        }
    }
    found
}
