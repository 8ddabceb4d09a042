//! What pages of a console look at of a simulated scene: where everything is, and the cameras that
//! some page wants, drawn for it.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;

use hal::{CameraFrame, TimeNs};
use trocar_tasks::cameras::SceneCameras;
use trocar_tasks::scene::SceneSnapshot;

use super::SessionError;
use crate::console::{FramePlanes, FrameTap, SceneTap};

/// The scene of one console.
pub(super) struct Views {
    to: FrameTap,
    scene: SceneTap,
    /// The instant that is drawn, and the cameras that it is still to be drawn for.
    instant: Option<(TimeNs, SceneSnapshot)>,
    waiting: Vec<usize>,
    /// One a camera of the task, made when a page first looks at it.
    frames: BTreeMap<usize, CameraFrame>,
}

impl Views {
    pub(super) const fn new(to: FrameTap, scene: SceneTap) -> Self {
        Self {
            to,
            scene,
            instant: None,
            waiting: Vec::new(),
            frames: BTreeMap::new(),
        }
    }

    /// Whether all that pages look at is drawn, and another instant may come.
    pub(super) const fn are_drawn(&self) -> bool {
        self.waiting.is_empty()
    }

    /// From now on this is the newest instant, of which [`Self::draw`] draws what pages look at.
    ///
    /// # Errors
    /// If an arm that carries a camera is not in `scene`.
    pub(super) fn show(
        &mut self,
        stamp: TimeNs,
        scene: &SceneSnapshot,
        cameras: &SceneCameras,
    ) -> Result<(), SessionError> {
        self.scene.show(scene, stamp)?;
        self.instant = Some((stamp, *scene));
        let wanted = (0..cameras.names().count()).filter(|camera| self.to.wants(*camera));
        self.waiting = wanted.collect();
        Ok(())
    }

    /// Draws one camera of those that pages look at, so that nobody else's frames wait for more
    /// than that; whether there was one.
    ///
    /// # Errors
    /// From the renderer.
    pub(super) fn draw(&mut self, cameras: &mut SceneCameras) -> Result<bool, SessionError> {
        let (Some((stamp, scene)), Some(camera)) = (&self.instant, self.waiting.pop()) else {
            return Ok(false);
        };
        let frame = match self.frames.entry(camera) {
            Entry::Occupied(frame) => frame.into_mut(),
            Entry::Vacant(place) => place.insert(cameras.blank_frame(camera)?),
        };
        cameras.render(camera, scene, frame)?;
        show_frame(&self.to, camera, *stamp, frame);
        Ok(true)
    }
}

/// Shows what pages want of `frame`, the newest of the camera of this index.
pub(super) fn show_frame(to: &FrameTap, camera: usize, stamp: TimeNs, frame: &CameraFrame) {
    let planes = FramePlanes {
        colour: &frame.colour,
        depth_m: &frame.depth_m,
        instance: &frame.instance,
    };
    let seen_from = (&frame.intrinsics, &frame.camera_in_scene);
    to.show(camera, stamp, seen_from, &planes);
}
