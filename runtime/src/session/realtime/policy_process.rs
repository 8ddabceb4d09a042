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
const POLL_NS: u64 = 500_000;

/// Silence after which a sign of life is given all the same, in looks.
const STATUS_EVERY_POLLS: u64 = 100;

/// What the process is started with.
#[derive(Clone, Debug)]
pub struct PolicyProcessOptions {
    /// Names the run's topics.
    pub run_id: String,
    /// The checkpoint's directory.
    pub policy: PathBuf,
    /// Where the network computes.
    pub device: Device,
}

/// Serves observations until told to stop or until the parent process is gone.
///
/// # Errors
/// If the checkpoint or the topics can't be opened, or the network fails.
pub fn serve_policy(options: &PolicyProcessOptions) -> Result<(), SessionError> {
    let parent = parent_id();
    let node = TopicNode::join(&options.run_id)?;
    let mut service = Service {
        control: RunControlTopic::subscriber(&node, ARM)?,
        arm: ArmStateTopic::subscriber(&node, ARM)?,
        chunks: ChunkTopic::publisher(&node, ARM)?,
        status: PolicyStatusTopic::publisher(&node, ARM)?,
        cameras: Vec::new(),
        network: ActPolicy::load(&options.policy, options.device)?,
        report: None,
        counts: Counts::default(),
    };
    for camera in camera_names(&service.network) {
        service
            .cameras
            .push(CameraTopic::subscriber(&node, &camera)?);
    }
    let mut every = 0_u64;
    while parent_id() == parent {
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
    report: Option<ArmReport>,
    counts: Counts,
}

impl Service {
    /// Follows the control process; `false` means that it is time to go.
    fn obey(&mut self, control: &RunControl) -> bool {
        match control.command() {
            Some(RunCommand::Wait) => true,
            Some(RunCommand::Run { seed }) => {
                if control.episode != self.counts.episode {
                    self.network.reset(seed);
                    self.counts.episode = control.episode;
                    self.counts.queries = 0;
                }
                true
            }
            Some(RunCommand::Stop) | None => false,
        }
    }

    /// Answers the newest observation, if there is a new one whose parts belong together.
    fn answer(&mut self) -> Result<(), SessionError> {
        if let Some(report) = self.arm.newest()? {
            self.report = Some(report);
        }
        let views = self
            .cameras
            .iter_mut()
            .map(FrameSubscriber::newest)
            .collect::<Result<Vec<_>, _>>()?;
        let Some(views) = views.into_iter().collect::<Option<Vec<FrameView>>>() else {
            return Ok(());
        };
        // Reports are published before the frames of the same instant, so the newest one is late only if it overtook.
        let Some(report) = self
            .report
            .filter(|report| views.iter().all(|view| view.header().stamp == report.stamp))
        else {
            return Ok(());
        };
        let frames: Vec<FrameRef<'_>> = views.iter().map(FrameView::as_frame).collect();
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
