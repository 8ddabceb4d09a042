//! A camera of a simulated scene whose frames are drawn straight into shared memory.

use hal::TimeNs;
use trocar_render::Planes;
use trocar_tasks::cameras::SceneCameras;
use trocar_tasks::scene::SceneSnapshot;
use trocar_topics::{CameraTopic, FrameHeader, FramePublisher, TopicNode};

use super::SessionError;

/// One of a scene's cameras with its topic.
pub(super) struct Published {
    camera: usize,
    publisher: FramePublisher,
}

impl Published {
    /// The camera of this index of `cameras`, on the topic that `named` makes of its name.
    ///
    /// # Errors
    /// If there is no such camera, or from the topic.
    pub(super) fn open(
        node: &TopicNode,
        cameras: &SceneCameras,
        camera: usize,
        named: impl FnOnce(&str) -> String,
    ) -> Result<Self, SessionError> {
        let pixels = cameras.intrinsics(camera)?.pixel_count();
        let topic = named(cameras.name(camera)?);
        let publisher = CameraTopic::publisher(node, &topic, pixels)?;
        Ok(Self { camera, publisher })
    }

    /// Draws `scene` as it was at `stamp`, on the system's clock, and publishes the frame of that
    /// number.
    ///
    /// # Errors
    /// From the renderer or the topic.
    pub(super) fn draw(
        &self,
        cameras: &mut SceneCameras,
        (stamp, sequence): (TimeNs, u64),
        scene: &SceneSnapshot,
    ) -> Result<(), SessionError> {
        let pose = cameras.pose(self.camera, scene)?;
        let lens = cameras.intrinsics(self.camera)?;
        let header = FrameHeader::new(stamp, sequence, lens, &pose);
        let mut loan = self.publisher.loan(&header)?;
        let (colour, depth_m, instance) = loan.planes();
        let planes = Planes {
            colour,
            depth_m,
            instance,
        };
        cameras.render_into(self.camera, scene, planes)?;
        loan.send()?;
        Ok(())
    }

    /// Draws `scene` for nobody: the first image takes far longer than the others.
    ///
    /// # Errors
    /// From the renderer.
    pub(super) fn warm_up(
        &self,
        cameras: &mut SceneCameras,
        scene: &SceneSnapshot,
    ) -> Result<(), SessionError> {
        let mut frame = cameras.blank_frame(self.camera)?;
        Ok(cameras.render(self.camera, scene, &mut frame)?)
    }

    /// Hands the newest frame to readers that have come since.
    ///
    /// # Errors
    /// From the topic.
    pub(super) fn keep_alive(&self) -> Result<(), SessionError> {
        Ok(self.publisher.keep_alive()?)
    }
}
