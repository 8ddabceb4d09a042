//! The cameras' own process of a simulated run in real time: where everything is in, frames out. A
//! renderer that crashes, or a driver that hangs, takes no control thread with it.
//!
//! ```text
//!  run ── snapshots of policy steps ──> draws its cameras ── frames ──> policy process, log
//!      ── snapshots for pages ────────> draws one camera of those asked for ── frames ──> console
//! ```
//!
//! A run starts it and looks after it; anyone can start another by hand, for a run with `--topics`.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::os::unix::process::parent_id;

use hal::{ARMS_MAX, Pose, TimeNs};
use trocar_tasks::cameras::SceneCameras;
use trocar_tasks::scene::{SceneSnapshot, THINGS_MAX};
use trocar_topics::{
    CamerasStatus, CamerasStatusTopic, Publisher, RunCommand, RunControl, RunControlTopic,
    SnapshotReport, SnapshotTopic, Subscriber, TopicNode,
};
use trocar_world::ArmBodies;

use super::policy_process::{DYING_MAX, FIRST_ARM, STATUS_EVERY_NS};
use crate::rt::{self, MonotonicClock};
use crate::session::external::LOOK_NS;
use crate::session::published::Published;
use crate::session::{SessionError, Setup, snapshot_report};

/// Names the topics of what is for the console alone.
pub(super) const CONSOLE: &str = "console";

/// Names the topic on which the process is told what to do.
pub(super) const CAMERAS: &str = "cameras";

/// The topic of what pages see of the camera `name`.
pub(super) fn for_console(name: &str) -> String {
    format!("{CONSOLE}/{name}")
}

/// What the process is started with.
#[derive(Clone, Debug)]
pub struct CamerasOptions {
    /// Names the run's topics.
    pub topics: String,
    /// The scene.
    pub setup: Setup,
    /// The episode that is drawn until a snapshot says another.
    pub seed: u64,
    /// The cameras whose frames are published, by name.
    pub cameras: Vec<String>,
    /// Whether pages of the run's console are shown cameras too.
    pub pages: bool,
    /// The process that started this one, as it knows itself, with which it ends; without one it
    /// ends by a signal.
    pub parent: Option<u32>,
}

/// Draws what a run shows until it is told to stop, the parent process is gone or, without a
/// parent, a signal comes; gives how many snapshots it drew. `say` gets a line when the cameras are
/// there and for each run that is seen, if they were started by hand, and when pages can't be shown
/// more.
///
/// # Errors
/// If there is no such camera, from the renderer or the topics, and [`SessionError::BadArgument`]
/// for a run with another scene.
pub fn serve_cameras(
    options: &CamerasOptions,
    say: &mut dyn FnMut(&str),
) -> Result<u64, SessionError> {
    // Joining frees what a parent that is already dead has left.
    let node = TopicNode::join(&options.topics)?;
    let parent_lives = || options.parent.is_none_or(|parent| parent_id() == parent);
    let served = if parent_lives() {
        serve(&node, options, parent_lives, say)
    } else {
        Ok(0)
    };
    if let Some(parent) = options.parent.filter(|_| !parent_lives()) {
        // It could not tidy up. What is left of it after this time, the next run removes.
        let _gone = node.remove_dying(parent, DYING_MAX);
    }
    served
}

fn serve(
    node: &TopicNode,
    options: &CamerasOptions,
    parent_lives: impl Fn() -> bool,
    say: &mut dyn FnMut(&str),
) -> Result<u64, SessionError> {
    let events = node.events()?;
    let mut studio = Studio::open(node, options)?;
    if options.parent.is_none() {
        say(&studio.described());
    }
    let mut parent = options.parent.map(|_| Parent::open(node)).transpose()?;
    while parent_lives() && !rt::interrupted() {
        if let Some(parent) = &mut parent {
            if parent.wants_an_end()? {
                break;
            }
            parent.say(studio.drawn, studio.draw_ns)?;
        }
        if !studio.turn(say)? {
            studio.keep_alive()?;
            rt::wait(&events, LOOK_NS);
        }
    }
    Ok(studio.drawn)
}

/// The run that started this process.
struct Parent {
    control: Subscriber<RunControl>,
    status: Publisher<CamerasStatus>,
    clock: MonotonicClock,
    said: Option<TimeNs>,
    count: u64,
}

impl Parent {
    fn open(node: &TopicNode) -> Result<Self, SessionError> {
        Ok(Self {
            control: RunControlTopic::subscriber(node, CAMERAS)?,
            status: CamerasStatusTopic::publisher(node, FIRST_ARM)?,
            clock: MonotonicClock::new(),
            said: None,
            count: 0,
        })
    }

    fn wants_an_end(&self) -> Result<bool, SessionError> {
        let told = self.control.newest()?;
        let goes_on = |control: &RunControl| {
            let command = control.command();
            matches!(command, Some(RunCommand::Wait | RunCommand::Run { .. }))
        };
        Ok(told.is_some_and(|control| !goes_on(&control)))
    }

    /// Gives a sign of life, if the last one is some time ago.
    fn say(&mut self, drawn: u64, draw_ns: u64) -> Result<(), SessionError> {
        let now = self.clock.now();
        if self
            .said
            .is_some_and(|said| now.since(said) < STATUS_EVERY_NS)
        {
            return Ok(());
        }
        self.said = Some(now);
        self.count += 1;
        self.status.publish(&CamerasStatus {
            sequence: self.count,
            drawn,
            draw_ns,
        })?;
        Ok(())
    }
}

/// The cameras with all that they draw for.
struct Studio<'a> {
    options: &'a CamerasOptions,
    scene_hash: u64,
    cameras: SceneCameras,
    /// Which episode is drawn.
    seed: u64,
    views: Vec<Published>,
    snapshots: Subscriber<SnapshotReport>,
    pages: Option<Pages>,
    /// Whether a run was seen.
    welcomed: bool,
    drawn: u64,
    draw_ns: u64,
}

/// What pages look at.
struct Pages {
    node: TopicNode,
    snapshots: Subscriber<SnapshotReport>,
    /// The instant that is drawn, and the cameras that it is still to be drawn for.
    instant: Option<SnapshotReport>,
    waiting: Vec<usize>,
    /// One a camera, made when a page first looks at it.
    views: BTreeMap<usize, Published>,
}

impl<'a> Studio<'a> {
    /// Opens the renderer and the topics; each camera draws once, since its first image takes far
    /// longer than the others.
    fn open(node: &TopicNode, options: &'a CamerasOptions) -> Result<Self, SessionError> {
        let setup = &options.setup;
        let mut cameras = SceneCameras::new(&setup.task)?;
        cameras.begin_episode(&setup.task, options.seed);
        let start = start(setup.task.arms.len());
        let mut views = Vec::new();
        for name in &options.cameras {
            let Some(camera) = cameras.find(name) else {
                let known = setup.camera_names().join(", ");
                return Err(SessionError::BadArgument(format!(
                    "--cameras {name}: there is no such camera; task {} has {known}",
                    setup.task_name
                )));
            };
            let view = Published::open(node, &cameras, camera, str::to_owned)?;
            view.warm_up(&mut cameras, &start)?;
            views.push(view);
        }
        let pages = options.pages.then(|| Pages::open(&options.topics));
        Ok(Self {
            options,
            scene_hash: setup.scene_hash(),
            cameras,
            seed: options.seed,
            views,
            snapshots: SnapshotTopic::subscriber(node, FIRST_ARM)?,
            pages: pages.transpose()?,
            welcomed: false,
            drawn: 0,
            draw_ns: 0,
        })
    }

    fn described(&self) -> String {
        format!(
            "cameras {} of {} on topics {:?}, drawn by {}",
            self.options.cameras.join(", "),
            self.options.setup.task_name,
            self.options.topics,
            self.cameras.adapter_name()
        )
    }

    /// Draws what is newest: for the policy and the log first, else one camera that a page looks
    /// at. Whether there was something.
    fn turn(&mut self, say: &mut dyn FnMut(&str)) -> Result<bool, SessionError> {
        if let Some(report) = self.snapshots.newest()? {
            self.begin(&report, say)?;
            let scene = snapshot_report::scene(&report);
            let clock = MonotonicClock::new();
            for view in &self.views {
                view.draw(&mut self.cameras, (report.stamp, report.sequence), &scene)?;
            }
            self.draw_ns = clock.now().0;
            self.drawn += 1;
            return Ok(true);
        }
        let Some(pages) = &mut self.pages else {
            return Ok(false);
        };
        if let Some(report) = pages.newest(self.cameras.count())? {
            self.begin(&report, say)?;
        }
        let drew = match &mut self.pages {
            Some(pages) => pages.draw(&mut self.cameras),
            None => return Ok(false),
        };
        match drew {
            // Whoever looks on takes no frames from the policy: there may be no shared memory for
            // more.
            Err(SessionError::Topic(error)) => {
                say(&format!("the console is shown no more cameras: {error}"));
                self.pages = None;
                Ok(false)
            }
            drew => drew,
        }
    }

    /// What is drawn from now on is the episode of `report`, whose scene must be this one.
    fn begin(
        &mut self,
        report: &SnapshotReport,
        say: &mut dyn FnMut(&str),
    ) -> Result<(), SessionError> {
        let (setup, topics) = (&self.options.setup, &self.options.topics);
        let task = report.task.text();
        if task != setup.task_name {
            return Err(SessionError::BadArgument(format!(
                "the run on topics {topics:?} is of task {task}, these cameras are of {}",
                setup.task_name
            )));
        }
        if report.scene_hash != self.scene_hash {
            return Err(SessionError::BadArgument(format!(
                "the run on topics {topics:?} has another scene than these cameras: --scene, --needle, --view and --set scene.KEY must be the \
                 same for `trocar cameras` and `trocar run`"
            )));
        }
        if self.welcomed && self.seed == report.seed {
            return Ok(());
        }
        if self.seed != report.seed {
            self.seed = report.seed;
            self.cameras.begin_episode(&setup.task, report.seed);
        }
        self.welcomed = true;
        if self.options.parent.is_none() {
            say(&format!("a run of {task}, seed {}", report.seed));
        }
        Ok(())
    }

    /// Lets readers that have just come connect.
    fn keep_alive(&self) -> Result<(), SessionError> {
        self.views.iter().try_for_each(Published::keep_alive)
    }
}

impl Pages {
    fn open(topics: &str) -> Result<Self, SessionError> {
        let node = TopicNode::join(topics)?;
        Ok(Self {
            snapshots: SnapshotTopic::subscriber(&node, CONSOLE)?,
            node,
            instant: None,
            waiting: Vec::new(),
            views: BTreeMap::new(),
        })
    }

    /// The next instant, once that before it is drawn; of `count` cameras those are drawn that are
    /// wanted.
    fn newest(&mut self, count: usize) -> Result<Option<SnapshotReport>, SessionError> {
        if !self.waiting.is_empty() {
            return Ok(None);
        }
        let Some(report) = self.snapshots.newest()? else {
            return Ok(None);
        };
        let wanted = (0..count).filter(|camera| is_wanted(report.wanted, *camera));
        self.waiting = wanted.collect();
        self.instant = Some(report);
        Ok(self.instant)
    }

    /// Draws one camera of those that pages look at, so that nobody else's frames wait for more
    /// than that; whether there was one.
    fn draw(&mut self, cameras: &mut SceneCameras) -> Result<bool, SessionError> {
        let (Some(report), Some(camera)) = (&self.instant, self.waiting.pop()) else {
            return Ok(false);
        };
        let view = match self.views.entry(camera) {
            Entry::Occupied(view) => view.into_mut(),
            Entry::Vacant(place) => {
                let view = Published::open(&self.node, cameras, camera, for_console)?;
                place.insert(view)
            }
        };
        let at = (report.stamp, report.sequence);
        view.draw(cameras, at, &snapshot_report::scene(report))?;
        Ok(true)
    }
}

/// Whether the camera of this index is among those whose bits are set.
pub(super) const fn is_wanted(wanted: u64, camera: usize) -> bool {
    camera < 64 && wanted >> camera & 1 == 1
}

/// Some scene with so many arms, to be drawn for nobody.
fn start(arms: usize) -> SceneSnapshot {
    let here = Pose::identity();
    let bodies = ArmBodies {
        shaft: here,
        wrist: here,
        finger_left: here,
        finger_right: here,
        tip: here,
    };
    SceneSnapshot {
        moment_ms: 0,
        things: [here; THINGS_MAX],
        goal: here,
        arms: core::array::from_fn::<_, ARMS_MAX, _>(|arm| (arm < arms).then_some(bodies)),
        flap: None,
    }
}
