//! The policy's own process in a real-time run: frames and the arm in, chunks out.

use std::os::unix::process::parent_id;
use std::path::PathBuf;

use hal::topic::{
    ArmReport, ArmStateTopic, CameraTopic, ChunkTopic, FrameSubscriber, FrameView, PolicyStage,
    PolicyStatus, PolicyStatusTopic, Publisher, RunCommand, RunControl, RunControlTopic,
    Subscriber, TopicNode,
};
use hal::{Chunk, FrameRef, Observation, Policy};
use policy::act_policy::ActPolicy;
use tch::Device;

use crate::rt::{self, MonotonicClock};
use crate::session::SessionError;
use crate::session::source::camera_names;

/// The arm that the topics of a one-armed task are named after.
pub(super) const ARM: &str = "psm1";

/// Time between two looks at the topics, ns.
const POLL_NS: u64 = 1_000_000;

/// Silence after which a sign of life is given all the same, in looks.
const STATUS_EVERY_POLLS: u64 = 50;

/// What the process is started with.
#[derive(Clone, Debug)]
pub struct PolicyProcessOptions {
    /// Names the run's topics.
    pub run_id: String,
    /// The checkpoint's directory.
    pub policy: PathBuf,
    /// Where the network computes.
    pub device: Device,
    /// The process that started this one, as it knows itself: it may die before this one can look.
    pub parent: u32,
}

/// Serves observations until told to stop or until the parent process is gone.
///
/// # Errors
/// If the checkpoint or the topics can't be opened, or the network fails.
pub fn serve_policy(options: &PolicyProcessOptions) -> Result<(), SessionError> {
    // Joining frees what a parent that is already dead has left.
    let node = TopicNode::join(&options.run_id)?;
    let parent_lives = || parent_id() == options.parent;
    let served = if parent_lives() {
        serve(&node, options, parent_lives)
    } else {
        Ok(())
    };
    if !parent_lives() {
        // It could not tidy up.
        node.remove_dead();
    }
    served
}

fn serve(
    node: &TopicNode,
    options: &PolicyProcessOptions,
    parent_lives: impl Fn() -> bool,
) -> Result<(), SessionError> {
    let mut service = Service::open(node, options)?;
    let mut every = 0_u64;
    while parent_lives() {
        if every.is_multiple_of(STATUS_EVERY_POLLS) {
            service.say(PolicyStage::Ready)?;
        }
        every += 1;
        if let Some(control) = service.control.newest()?
            && !service.obey(&control)
        {
            return Ok(());
        }
        service.answer()?;
        rt::sleep_ns(POLL_NS);
    }
    Ok(())
}

#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    said: u64,
    episode: u64,
    queries: u64,
    infer_ns: u64,
}

struct Service {
    control: Subscriber<RunControl>,
    arm: Subscriber<ArmReport>,
    chunks: Publisher<Chunk>,
    status: Publisher<PolicyStatus>,
    cameras: Vec<FrameSubscriber>,
    network: ActPolicy,
    /// Policy steps from one query to the next.
    every_steps: u64,
    report: Option<ArmReport>,
    /// The newest frame of each camera.
    views: Vec<Option<FrameView>>,
    /// The stretch of `every_steps` steps that the last answer was for.
    answered: Option<u64>,
    counts: Counts,
}

impl Service {
    fn open(node: &TopicNode, options: &PolicyProcessOptions) -> Result<Self, SessionError> {
        let network = ActPolicy::load(&options.policy, options.device)?;
        let cameras = camera_names(&network)
            .iter()
            .map(|camera| CameraTopic::subscriber(node, camera))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            control: RunControlTopic::subscriber(node, ARM)?,
            arm: ArmStateTopic::subscriber(node, ARM)?,
            chunks: ChunkTopic::publisher(node, ARM)?,
            status: PolicyStatusTopic::publisher(node, ARM)?,
            every_steps: u64::from(network.recipe().query_every_steps).max(1),
            report: None,
            views: cameras.iter().map(|_| None).collect(),
            answered: None,
            counts: Counts::default(),
            cameras,
            network,
        })
    }

    /// Follows the control process; `false` means that it is time to go.
    fn obey(&mut self, control: &RunControl) -> bool {
        match control.command() {
            Some(RunCommand::Wait) => true,
            Some(RunCommand::Run { seed }) => {
                if control.episode != self.counts.episode {
                    self.network.reset(seed);
                    self.counts.episode = control.episode;
                    self.counts.queries = 0;
                    self.answered = None;
                }
                true
            }
            Some(RunCommand::Stop) | None => false,
        }
    }

    /// Answers the newest observation if it is one's turn and its parts belong together.
    ///
    /// Turns begin at multiples of `every_steps`. When the camera or the network was too slow for the first observation of a
    /// turn, the newest one takes its place.
    fn answer(&mut self) -> Result<(), SessionError> {
        if let Some(report) = self.arm.newest()? {
            self.report = Some(report);
        }
        for (camera, view) in self.cameras.iter_mut().zip(&mut self.views) {
            if let Some(newest) = camera.newest()? {
                *view = Some(newest);
            }
        }
        let Some(report) = self.report else {
            return Ok(());
        };
        let turn = report.sequence / self.every_steps;
        let views: Vec<&FrameView> = self
            .views
            .iter()
            .flatten()
            .filter(|view| view.header().stamp == report.stamp)
            .collect();
        if self.answered == Some(turn) || views.len() != self.cameras.len() {
            return Ok(());
        }
        self.answered = Some(turn);
        let frames: Vec<FrameRef<'_>> = views.iter().map(|view| view.as_frame()).collect();
        let state = report.state();
        let clock = MonotonicClock::new();
        let before = clock.now();
        let observation = Observation {
            arm: &state,
            tip_in_rcm: report.tip_in_rcm(),
            frames: &frames,
        };
        let chunk = self.network.infer(&observation)?;
        self.counts.infer_ns = clock.now().since(before);
        self.counts.queries += 1;
        self.chunks.publish(&chunk)?;
        self.say(PolicyStage::Ready)
    }

    fn say(&mut self, stage: PolicyStage) -> Result<(), SessionError> {
        self.counts.said += 1;
        let Counts {
            said,
            episode,
            queries,
            infer_ns,
        } = self.counts;
        self.status
            .publish(&PolicyStatus::new(said, episode, stage, queries, infer_ns))?;
        Ok(())
    }
}
