//! Whose cameras a simulated run has: nobody's, those of a process of ours, or those of others on
//! the same topics.

use trocar_tasks::scene::SceneSnapshot;
use trocar_topics::TopicNode;

use super::cameras_child::CamerasChild;
use super::child::Outside;
use super::child_process::fresh_run_id;
use super::opened::Opened;
use super::remote_arms::{Camera, FRAMES_WITHIN_MS, PrintLine, cameras};
use super::scene_topics::SceneForCameras;
use crate::rt::MonotonicClock;
use crate::session::source::SizedCamera;
use crate::session::{Plan, SessionError};

/// The cameras.
pub(super) enum Cameras {
    /// Nobody looks, and nothing is drawn.
    None,
    /// Those that a process of ours draws.
    Own(Box<CamerasChild>),
    /// Those that others show, and how many of them the policy looks through: the first.
    Others(Vec<Camera>, usize),
}

/// What the processes of a run share before it begins.
pub(super) struct Stage {
    /// The name of their topics.
    topics: String,
    /// The run's place there, if there is any other process.
    pub(super) node: Option<TopicNode>,
    pub(super) cameras: Cameras,
    /// The cameras whose frames are wanted, with their sizes in pixels if some are asked for: those
    /// that the policy looks through first.
    pub(super) wanted: Vec<SizedCamera>,
    looked_at: usize,
    /// Where everything is, for whoever draws it.
    pub(super) scene: Option<SceneForCameras>,
}

impl Stage {
    /// Joins the topics, and starts our cameras' process: it opens its renderer while the `policy`
    /// loads.
    pub(super) fn open(plan: &Plan, policy: &Opened<'_>) -> Result<Self, SessionError> {
        let others = plan.cameras_on.as_deref();
        let topics = match others.or_else(|| policy.topics()) {
            Some(topics) => topics.to_owned(),
            None => fresh_run_id()?,
        };
        let looked_at = policy.cameras();
        let mut stage = Self {
            topics,
            node: None,
            cameras: Cameras::None,
            wanted: wanted(plan, looked_at.clone(), policy.is_remote()),
            looked_at: looked_at.len(),
            scene: None,
        };
        let draws = !stage.wanted.is_empty() || plan.console.is_some();
        let own = others.is_none() && draws;
        if own {
            let names = stage.names();
            let pages = plan.console.is_some();
            let child = CamerasChild::start(plan, &stage.topics, &names, pages)?;
            stage.cameras = Cameras::Own(Box::new(child));
        }
        if own || others.is_some() || policy.is_remote() {
            let node = TopicNode::join(&stage.topics)?;
            stage.scene = Some(SceneForCameras::open(plan, &node)?);
            stage.node = Some(node);
        }
        Ok(stage)
    }

    /// Names of the cameras whose frames are wanted.
    pub(super) fn names(&self) -> Vec<String> {
        self.wanted.iter().map(|(name, _)| name.clone()).collect()
    }

    /// Whether the policy looks through cameras.
    pub(super) const fn is_looked_at(&self) -> bool {
        self.looked_at > 0
    }

    /// Where a policy process finds frames.
    pub(super) fn outside(&self, plan: &Plan) -> Outside<'_> {
        Outside {
            topics: &self.topics,
            frames_within_ms: plan.cameras_on.as_ref().map_or(0, |_| FRAMES_WITHIN_MS),
        }
    }

    /// Waits until our process has drawn, or others have shown a frame of each camera that is
    /// wanted, of the size that is asked for; they may draw `start`.
    pub(super) fn wait(
        &mut self,
        plan: &Plan,
        start: &SceneSnapshot,
        say: PrintLine<'_>,
    ) -> Result<(), SessionError> {
        if let Cameras::Own(child) = &mut self.cameras {
            // Pages are shown what they look at when it is there.
            if self.wanted.is_empty() {
                return Ok(());
            }
            return child.wait_until_ready(say);
        }
        let (Some(_), Some(node), Some(scene)) = (&plan.cameras_on, &self.node, &mut self.scene)
        else {
            return Ok(());
        };
        let topics = (self.topics.as_str(), "`trocar cameras --cameras NAME`");
        let mut meanwhile = || scene.show_start(start);
        let clock = MonotonicClock::new();
        let found = cameras(node, &self.wanted, clock, topics, (say, &mut meanwhile))?;
        self.cameras = Cameras::Others(found, self.looked_at);
        Ok(())
    }
}

/// The cameras that are drawn for the policy, which looks through `seen`, the log, the pictures
/// and, if it is `remote`, others on its topics.
fn wanted(plan: &Plan, seen: Vec<SizedCamera>, remote: bool) -> Vec<SizedCamera> {
    let setup = &plan.setup;
    let kept = setup.kept_cameras.is_some();
    let others = plan.cameras_on.is_some();
    // Of others' cameras only those are waited for that were asked for.
    let all = if others {
        kept
    } else {
        plan.wants_frames() || (remote && kept)
    };
    if !all {
        return seen;
    }
    let names = seen.iter().map(|(name, _)| name.clone()).collect();
    let known = seen.len();
    let more = setup.cameras_with(names).into_iter().skip(known);
    seen.into_iter()
        .chain(more.map(|name| (name, None)))
        .collect()
}
