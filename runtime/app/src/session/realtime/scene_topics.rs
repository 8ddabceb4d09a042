//! Where everything in a simulated scene is, on topics for whoever draws it, and for the pages of a console.

use hal::TimeNs;
use trocar_log::Level;
use trocar_tasks::scene::SceneSnapshot;
use trocar_topics::{
    Publisher, SnapshotReport, SnapshotTopic, Subscriber, TaskReport, TaskTopic, TopicNode,
};

use super::cameras_process::CONSOLE;
use super::policy_process::FIRST_ARM;
use super::signals::Signals;
use crate::console::{FrameTap, SceneTap};
use crate::mailbox::{MailboxReader, MailboxWriter};
use crate::rt::MonotonicClock;
use crate::session::source::STEP_NS;
use crate::session::world_report::WorldName;
use crate::session::{Plan, SessionError, snapshot_report};

/// A scene at one instant.
#[derive(Clone, Copy, Debug)]
pub(super) struct Snapshot {
    pub(super) step: u64,
    /// The instant of the arms' measurement in this step.
    pub(super) stamp: TimeNs,
    pub(super) scene: SceneSnapshot,
}

/// Snapshots of policy steps, for the cameras.
pub(super) struct SceneForCameras {
    topic: Publisher<SnapshotReport>,
    world: WorldName,
    /// When one was last published while the cameras were waited for, by which clock.
    waited: (MonotonicClock, Option<TimeNs>),
}

impl SceneForCameras {
    pub(super) fn open(plan: &Plan, node: &TopicNode) -> Result<Self, SessionError> {
        Ok(Self {
            topic: SnapshotTopic::publisher(node, FIRST_ARM)?,
            world: plan.world_name(),
            waited: (MonotonicClock::new(), None),
        })
    }

    /// Shows `start`, as it is before the run begins, at most once a policy step: other cameras than ours may wait for something to draw.
    pub(super) fn show_start(&mut self, start: &SceneSnapshot) -> Result<(), SessionError> {
        let (clock, shown) = &mut self.waited;
        let now = clock.now();
        if shown.is_none_or(|shown| now.since(shown) >= STEP_NS) {
            *shown = Some(now);
            let stamp = clock.to_system(now);
            let report = snapshot_report::report(stamp, 0, &self.world, start);
            self.topic.publish(&report)?;
        }
        Ok(())
    }

    /// Publishes a snapshot of the run's `clock`.
    pub(super) fn show(
        &self,
        snapshot: &Snapshot,
        clock: MonotonicClock,
    ) -> Result<(), SessionError> {
        self.topic
            .publish(&reported(snapshot, clock, &self.world))?;
        Ok(())
    }

    /// Lets cameras that have just come connect.
    pub(super) fn keep_alive(&self) -> Result<(), SessionError> {
        Ok(self.topic.keep_alive()?)
    }
}

/// `snapshot`, whose time is the run's `clock`, as it is on topics.
fn reported(snapshot: &Snapshot, clock: MonotonicClock, world: &WorldName) -> SnapshotReport {
    let stamp = clock.to_system(snapshot.stamp);
    snapshot_report::report(stamp, snapshot.step, world, &snapshot.scene)
}

/// What pages of a console look at. They have snapshots of their own, so that none for the policy or the log is replaced.
pub(super) struct SceneForPages {
    tap: SceneTap,
    frames: FrameTap,
    /// How many cameras the task has.
    cameras: usize,
    snapshots: MailboxReader<Snapshot>,
    /// Where the cameras' process of this run is told what to draw, if there is one.
    topic: Option<(Publisher<SnapshotReport>, WorldName)>,
}

impl SceneForPages {
    pub(super) fn new(
        (tap, frames): (SceneTap, FrameTap),
        cameras: usize,
        snapshots: MailboxReader<Snapshot>,
    ) -> Self {
        Self {
            tap,
            frames,
            cameras,
            snapshots,
            topic: None,
        }
    }

    /// The same whose cameras are drawn by the process of ours on the topics of `node`.
    pub(super) fn drawn_on(self, plan: &Plan, node: &TopicNode) -> Result<Self, SessionError> {
        let topic = SnapshotTopic::publisher(node, CONSOLE)?;
        Ok(Self {
            topic: Some((topic, plan.world_name())),
            ..self
        })
    }
}

impl ForPages for SceneForPages {
    fn turn(&mut self, clock: MonotonicClock) -> Result<(), SessionError> {
        let Some(snapshot) = self.snapshots.take() else {
            return Ok(());
        };
        self.tap.show(&snapshot.scene, snapshot.stamp)?;
        let Some((topic, world)) = &self.topic else {
            return Ok(());
        };
        let wanted = (0..self.cameras).filter(|camera| self.frames.wants(*camera));
        let wanted = wanted.fold(0, |bits, camera| bits | 1_u64.unbounded_shl(bit(camera)));
        if wanted != 0 {
            let all = reported(&snapshot, clock, world);
            topic.publish(&SnapshotReport { wanted, ..all })?;
        }
        Ok(())
    }
}

/// What a world in another process says of itself beside the state that decides the run: where everything is, and how its task stands.
pub(super) struct WorldTopics {
    snapshots: Subscriber<SnapshotReport>,
    task: Subscriber<TaskReport>,
    /// The scene that pages are shown, if there is one.
    scene: Option<SceneTap>,
}

impl WorldTopics {
    pub(super) fn open(node: &TopicNode) -> Result<Self, SessionError> {
        Ok(Self {
            snapshots: SnapshotTopic::subscriber(node, FIRST_ARM)?,
            task: TaskTopic::subscriber(node, FIRST_ARM)?,
            scene: None,
        })
    }

    /// Where everything is, if that is news.
    pub(super) fn newest(&self) -> Result<Option<SceneSnapshot>, SessionError> {
        let report = self.snapshots.newest()?;
        Ok(report.map(|report| snapshot_report::scene(&report)))
    }

    /// The same with a `scene` that pages are shown.
    pub(super) fn with_scene(self, scene: SceneTap) -> Self {
        let scene = Some(scene);
        Self { scene, ..self }
    }

    /// Whether pages are shown a scene.
    pub(super) const fn has_scene(&self) -> bool {
        self.scene.is_some()
    }

    /// The same for pages, which are told by `task` how it stands.
    pub(super) const fn shown_on(self, task: MailboxWriter<TaskReport>) -> WorldForPages {
        WorldForPages { from: self, task }
    }
}

/// What pages of a console see of a world in another process.
pub(super) struct WorldForPages {
    from: WorldTopics,
    task: MailboxWriter<TaskReport>,
}

/// What hands the newest instant to pages.
pub(super) trait ForPages {
    /// Hands the newest instant on, if there is one.
    fn turn(&mut self, clock: MonotonicClock) -> Result<(), SessionError>;
}

impl ForPages for WorldForPages {
    fn turn(&mut self, clock: MonotonicClock) -> Result<(), SessionError> {
        if let Some(report) = self.from.task.newest()? {
            self.task.put(report);
        }
        if let Some(report) = self.from.snapshots.newest()?
            && let Some(scene) = &mut self.from.scene
        {
            let stamp = clock.from_system(report.stamp);
            scene.show(&snapshot_report::scene(&report), stamp)?;
        }
        Ok(())
    }
}

/// Hands the newest instant to the pages of `scene`, if there is one; one that can't be shown ends with a word, the run goes on.
pub(super) fn show_pages(
    scene: &mut Option<impl ForPages>,
    clock: MonotonicClock,
    signals: &Signals,
) {
    let Some(pages) = scene else {
        return;
    };
    if let Err(error) = pages.turn(clock) {
        let text = format!("the console is shown no more of the scene: {error}");
        signals.tell(clock.now(), Level::Warning, &text);
        *scene = None;
    }
}

fn bit(camera: usize) -> u32 {
    u32::try_from(camera).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use super::super::cameras_process::is_wanted;
    use super::*;

    /// What is asked for here is what the process finds.
    #[test]
    fn a_camera_is_asked_for_by_its_bit() {
        for camera in [0, 5, 63] {
            let wanted = 1_u64.unbounded_shl(bit(camera));
            let found = (0..100).filter(|other| is_wanted(wanted, *other));
            assert_eq!(found.collect::<Vec<_>>(), [camera]);
        }
        assert_eq!(1_u64.unbounded_shl(bit(64)), 0);
    }
}
