//! Where everything in a simulated scene is, on topics for whoever draws it, and for the pages of a
//! console.

use hal::TimeNs;
use trocar_log::{Level, SceneLog};
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
use crate::session::{Plan, SessionError, scene_record, snapshot_report};

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

    /// Shows `start`, as it is before the run begins, at most once a policy step: other cameras
    /// than ours may wait for something to draw.
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

/// What pages of a console look at. They have snapshots of their own, so that none for the policy
/// or the log is replaced.
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

/// What a world in another process says of itself beside the state that decides the run: where
/// everything is, and how its task stands.
pub(super) struct WorldTopics {
    snapshots: Subscriber<SnapshotReport>,
    task: Subscriber<TaskReport>,
    /// The scene that pages are shown, if there is one.
    scene: Option<SceneTap>,
    /// Where all of it is written, if there is a log.
    log: Option<LoggedWorld>,
}

impl WorldTopics {
    pub(super) fn open(node: &TopicNode) -> Result<Self, SessionError> {
        Ok(Self {
            snapshots: SnapshotTopic::subscriber(node, FIRST_ARM)?,
            task: TaskTopic::subscriber(node, FIRST_ARM)?,
            scene: None,
            log: None,
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

    /// The same, written into `log` if there is one.
    pub(super) fn logged_in(self, log: Option<SceneLog>) -> Self {
        let log = log.map(LoggedWorld::new);
        Self { log, ..self }
    }

    /// The same for whoever looks on; pages, if there are any, are told by `task` how it stands.
    pub(super) const fn told_to(self, task: Option<MailboxWriter<TaskReport>>) -> WorldForPages {
        WorldForPages { from: self, task }
    }
}

/// A world in another process as a log has it: each scene with how the task stood in it.
struct LoggedWorld {
    log: SceneLog,
    /// The newest scene, which waits for how the task stands, and when it was by the run's clock.
    waits: Option<(TimeNs, SnapshotReport)>,
    /// How the task stood last.
    stands: TaskReport,
}

impl LoggedWorld {
    fn new(log: SceneLog) -> Self {
        Self {
            log,
            waits: None,
            stands: TaskReport::default(),
        }
    }

    /// Takes in what is new. A scene is written when it is known how its task stands, or when the
    /// next one comes.
    fn hear(&mut self, task: Option<TaskReport>, scene: Option<(TimeNs, SnapshotReport)>) {
        if scene.is_some() {
            self.write();
            self.waits = scene;
        }
        self.stands = task.unwrap_or(self.stands);
        let stamp = self.waits.as_ref().map(|(_, report)| report.stamp);
        if stamp.is_some_and(|stamp| self.stands.stamp >= stamp) {
            self.write();
        }
    }

    fn write(&mut self) {
        if let Some((at, report)) = self.waits.take() {
            let scene = snapshot_report::scene(&report);
            let record = scene_record::record(&scene, &self.stands);
            self.log.scene(at, record);
        }
    }
}

/// What pages of a console, and a log, are told of a world in another process.
pub(super) struct WorldForPages {
    from: WorldTopics,
    task: Option<MailboxWriter<TaskReport>>,
}

/// What hands the newest instant to pages.
pub(super) trait ForPages {
    /// Hands the newest instant on, if there is one.
    fn turn(&mut self, clock: MonotonicClock) -> Result<(), SessionError>;
}

impl ForPages for WorldForPages {
    fn turn(&mut self, clock: MonotonicClock) -> Result<(), SessionError> {
        let task = self.from.task.newest()?;
        if let (Some(report), Some(pages)) = (task, &mut self.task) {
            pages.put(report);
        }
        let scene = self.from.snapshots.newest()?;
        let scene = scene.map(|report| (clock.from_system(report.stamp), report));
        if let Some(log) = &mut self.from.log {
            log.hear(task, scene);
        }
        if let (Some((stamp, report)), Some(pages)) = (scene, &mut self.from.scene) {
            pages.show(&snapshot_report::scene(&report), stamp)?;
        }
        Ok(())
    }
}

/// Hands the newest instant to the pages and the log of `scene`, if there is one; one that can't be
/// shown ends with a word, the run goes on.
pub(super) fn show_pages(
    scene: &mut Option<impl ForPages>,
    clock: MonotonicClock,
    signals: &Signals,
) {
    let Some(pages) = scene else {
        return;
    };
    if let Err(error) = pages.turn(clock) {
        let text = format!("console and log are told no more of the scene: {error}");
        signals.tell(clock.now(), Level::Warning, &text);
        *scene = None;
    }
}

fn bit(camera: usize) -> u32 {
    u32::try_from(camera).unwrap_or(u32::MAX)
}

#[cfg(test)]
mod tests {
    use trocar_log::{LoggedItem, Pressure, Recorder, RunHeader, SceneRecord, read_items};
    use trocar_topics::Line;

    use super::super::cameras_process::is_wanted;
    use super::*;
    use crate::session::scratch::Scratch;

    /// A scene is written once, with how its own task stood, though that comes after it, or else
    /// with the newest that is known.
    #[test]
    fn a_world_is_logged_with_how_its_task_stood() {
        let folder = Scratch::folder("logged-world");
        let path = folder.0.join("run.mcap");
        let recorder = Recorder::create(&path, &RunHeader::default(), Pressure::Block).unwrap();
        let (_ticks, _side, scenes, file) = recorder.split();
        let mut world = LoggedWorld::new(scenes);
        let scene = |tick: u64| {
            let report = SnapshotReport {
                stamp: TimeNs::from_tick(1000 + tick),
                moment_ms: tick,
                ..SnapshotReport::default()
            };
            Some((TimeNs::from_tick(tick), report))
        };
        let task = |tick: u64| {
            Some(TaskReport {
                stamp: TimeNs::from_tick(1000 + tick),
                missing: Line::new(&format!("of {tick}")),
                ..TaskReport::default()
            })
        };
        world.hear(None, scene(0));
        world.hear(task(0), None);
        world.hear(task(40), scene(40));
        world.hear(None, None);
        // How the task stood at 80 is missed.
        world.hear(None, scene(80));
        world.hear(None, scene(120));
        world.hear(task(120), None);
        drop(world);
        file.finish(None).unwrap();
        let mut told = Vec::new();
        read_items(&path, |item| {
            if let LoggedItem::Scene { at, message } = item {
                let record = SceneRecord::read(message.as_bytes()).unwrap();
                told.push((at.tick(), record.moment_ms, record.task.missing));
            }
        })
        .unwrap();
        let expected = [(0, 0), (40, 40), (80, 40), (120, 120)];
        let expected = expected.map(|(at, of)| (u64::from(at), at, format!("of {of}")));
        assert_eq!(told, expected);
    }

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
