//! What a world shows to other processes: its scene, how the task stands and the verdict, and what
//! its cameras see.
//!
//! Used by the emulated drives and by the simulator, which both have a world and lead no control
//! loop. Runs on their first thread; a mailbox keeps it apart from the thread that steps the world,
//! so slow drawing skips instants and delays none.

use hal::ARM_NAMES;
use trocar_tasks::cameras::{SceneCameras, SceneModel};
use trocar_tasks::scene::SceneSnapshot;
use trocar_tasks::task::Outcome;
use trocar_topics::{
    Publisher, SceneReport, SceneTopic, SnapshotReport, SnapshotTopic, TaskReport, TaskTopic,
    TopicError, TopicNode,
};

use super::bus_thread::Shown;
use crate::console::Console;
use crate::mailbox::MailboxReader;
use crate::session::published::Published;
use crate::session::views::Views;
use crate::session::world_report::{WorldName, report};
use crate::session::{Plan, SessionError, snapshot_report};

/// Where a world shows itself.
pub(in crate::session) struct ShowOptions<'a> {
    /// Names the topics.
    pub(in crate::session) topics: &'a str,
    /// Whether the cameras that the setup keeps are drawn and published.
    pub(in crate::session) cameras: bool,
    /// Where pages see them besides.
    pub(in crate::session) console: Option<&'a Console>,
}

/// The topics of a world.
pub(in crate::session) struct Show {
    /// Kept for as long as the topics live.
    _node: TopicNode,
    /// Task, seed and hash of the scene: readers refuse a world that is not theirs.
    world: WorldName,
    /// What decides a run: the verdict, and the state that scripted experts see.
    scene: Publisher<SceneReport>,
    /// For whoever draws it, or shows it on pages.
    snapshots: Publisher<SnapshotReport>,
    /// The criteria of success and what is missing, for pages and logs.
    task: Publisher<TaskReport>,
    /// There if cameras are published or a page may look.
    cameras: Option<SceneCameras>,
    /// Cameras that are published.
    views: Vec<Published>,
    /// The newest instant that has not been published.
    shown: MailboxReader<Shown>,
    /// What pages look at besides.
    page: Option<Views>,
    /// Whether the verdict has been said: it stays the same from then on.
    decided: bool,
}

impl Show {
    /// Opens the topics, and the renderer if there are cameras to draw; draws `start` once, since
    /// the first image takes far longer than the others.
    ///
    /// # Errors
    /// [`SessionError::BadArgument`] if another world shows its scene under this name; from the
    /// topics and the renderer.
    pub(in crate::session) fn open(
        plan: &Plan,
        options: &ShowOptions<'_>,
        shown: MailboxReader<Shown>,
        start: &SceneSnapshot,
    ) -> Result<Self, SessionError> {
        let setup = &plan.setup;
        let node = TopicNode::join(options.topics)?;
        let scene = SceneTopic::publisher(&node, ARM_NAMES[0]).map_err(|error| {
            if matches!(error, TopicError::AlreadyPublished { .. }) {
                return SessionError::BadArgument(format!(
                    "--topics {}: another simulated world shows its scene there",
                    options.topics
                ));
            }
            SessionError::Topic(error)
        })?;
        let snapshots = SnapshotTopic::publisher(&node, ARM_NAMES[0])?;
        let task = TaskTopic::publisher(&node, ARM_NAMES[0])?;
        let mut cameras = None;
        let mut views = Vec::new();
        let page = show_scene(plan, options, start)?;
        if options.cameras || page.is_some() {
            let mut opened = SceneCameras::new(&setup.task)?;
            opened.begin_episode(&setup.task, plan.seed);
            let mut names = setup.cameras_with(Vec::new());
            names.retain(|_| options.cameras);
            let wanted: Vec<usize> = names.iter().filter_map(|name| opened.find(name)).collect();
            for camera in wanted {
                let view = Published::open(&node, &opened, camera, str::to_owned)?;
                view.warm_up(&mut opened, start)?;
                views.push(view);
            }
            cameras = Some(opened);
        }
        Ok(Self {
            _node: node,
            world: plan.world_name(),
            scene,
            snapshots,
            task,
            cameras,
            views,
            shown,
            page,
            decided: false,
        })
    }

    /// Publishes the newest instant, if there is a new one, and says the verdict once.
    ///
    /// Called every few milliseconds. Without a new instant it lets readers that have just come
    /// connect. Drawing all published cameras takes most of its time.
    ///
    /// # Errors
    /// From the topics and the renderer of published cameras; never from the page.
    pub(in crate::session) fn turn(
        &mut self,
        say: &mut dyn FnMut(&str),
    ) -> Result<(), SessionError> {
        let Some(shown) = self.shown.take() else {
            self.scene.keep_alive()?;
            self.snapshots.keep_alive()?;
            self.task.keep_alive()?;
            for view in &self.views {
                view.keep_alive()?;
            }
            self.draw_for_page(say);
            return Ok(());
        };
        let (stamp, sequence) = (shown.stamp, shown.sequence);
        let report_now = report(stamp, sequence, &self.world, &shown.world);
        self.scene.publish(&report_now)?;
        let snapshot = snapshot_report::report(stamp, sequence, &self.world, &shown.snapshot);
        self.snapshots.publish(&snapshot)?;
        self.task
            .publish(&shown.world.task.report(stamp, sequence))?;
        self.draw(&shown)?;
        self.show_on_page(&shown, say);
        if let Some(outcome) = shown.world.outcome
            && !matches!(outcome, Outcome::Running)
            && !self.decided
        {
            self.decided = true;
            say(&format!("verdict: {outcome}"));
        }
        Ok(())
    }

    /// Hands the newest instant to the page, if there is one that has drawn the one before, and
    /// draws one of its cameras.
    fn show_on_page(&mut self, shown: &Shown, say: &mut dyn FnMut(&str)) {
        if let (Some(page), Some(cameras)) = (&mut self.page, &self.cameras)
            && page.are_drawn()
            && let Err(error) = page.show(shown.stamp, &shown.snapshot, cameras)
        {
            self.drop_page(&error, say);
        }
        self.draw_for_page(say);
    }

    /// Draws one camera that a page looks at, if there is one.
    fn draw_for_page(&mut self, say: &mut dyn FnMut(&str)) {
        if let (Some(page), Some(cameras)) = (&mut self.page, &mut self.cameras)
            && let Err(error) = page.draw(cameras)
        {
            self.drop_page(&error, say);
        }
    }

    /// Whoever looks on ends no drives.
    fn drop_page(&mut self, error: &SessionError, say: &mut dyn FnMut(&str)) {
        say(&format!("the console gets no more cameras: {error}"));
        self.page = None;
    }

    /// Every published camera, in order, of this one instant.
    fn draw(&mut self, shown: &Shown) -> Result<(), SessionError> {
        let Some(cameras) = &mut self.cameras else {
            return Ok(());
        };
        for view in &self.views {
            let at = (shown.stamp, shown.sequence);
            view.draw(cameras, at, &shown.snapshot)?;
        }
        Ok(())
    }
}

/// The scene of the drives, for the pages of a console if there is one.
///
/// None without a console. The scene's file is built here, once.
fn show_scene(
    plan: &Plan,
    options: &ShowOptions<'_>,
    start: &SceneSnapshot,
) -> Result<Option<Views>, SessionError> {
    let Some(console) = options.console else {
        return Ok(None);
    };
    let setup = &plan.setup;
    let model = SceneModel::new(&setup.task, plan.seed);
    let scene = console.show_scene(model, start, &setup.robot.control.arms)?;
    Ok(Some(Views::new(console.frames(), scene)))
}
