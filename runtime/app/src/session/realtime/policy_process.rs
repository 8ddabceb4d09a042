//! The policy's own process in a real-time run: frames and the arms in, a chunk for each arm out.

use std::os::unix::process::parent_id;
use std::path::PathBuf;
use std::time::Duration;

use hal::{ARM_NAMES, Chunk, Policy, arm_names};
use trocar_nets::compute::Compute;
use trocar_nets::loaded_policy::LoadedPolicy;
use trocar_topics::{
    ChunkTopic, PolicyStage, PolicyStatus, PolicyStatusTopic, Publisher, RunCommand, RunControl,
    RunControlTopic, Subscriber, TopicNode,
};

use super::observed::{ObservationBuffer, QuerySchedule, StepKind};
use crate::rt::{self, MonotonicClock};
use crate::session::SessionError;
use crate::session::external::LOOK_NS;

/// The arm that the topics which all arms share are named after.
pub(super) const FIRST_ARM: &str = ARM_NAMES[0];

/// Silence after which a sign of life is given all the same, ns.
pub(super) const STATUS_EVERY_NS: u64 = 50_000_000;

/// How long a killed parent may take to be gone: with a big memory, tens of milliseconds.
pub(super) const DYING_MAX: Duration = Duration::from_secs(5);

/// What the process is started with.
#[derive(Clone, Debug)]
pub struct PolicyProcessOptions {
    /// Names the run's topics.
    pub run_id: String,
    /// The checkpoint's directory.
    pub policy: PathBuf,
    /// Where and how the network computes.
    pub compute: Compute,
    /// How far a frame of any camera but the first may be from the instant of an observation, which
    /// is the first one's, ms: 0 where cameras and arms have one clock, as in a simulation.
    pub frames_within_ms: u64,
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
        // It could not tidy up. What is left of it after this time, the next run removes.
        let _gone = node.remove_dying(options.parent, DYING_MAX);
    }
    served
}

fn serve(
    node: &TopicNode,
    options: &PolicyProcessOptions,
    parent_lives: impl Fn() -> bool,
) -> Result<(), SessionError> {
    let events = node.events()?;
    let mut service = Service::open(node, options)?;
    let clock = MonotonicClock::new();
    let mut said = None;
    while parent_lives() {
        let now = clock.now();
        if said.is_none_or(|said| now.since(said) >= STATUS_EVERY_NS) {
            said = Some(now);
            service.say(PolicyStage::Ready)?;
        }
        if let Some(control) = service.control.newest()?
            && !service.obey(&control)
        {
            return Ok(());
        }
        service.answer()?;
        rt::wait(&events, LOOK_NS);
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
    observed: ObservationBuffer,
    /// One an arm.
    chunks: Vec<Publisher<Chunk>>,
    status: Publisher<PolicyStatus>,
    network: LoadedPolicy,
    turns: QuerySchedule,
    /// How far a frame of any camera but the first may be from the instant of an observation, ns.
    frames_within_ns: u64,
    counts: Counts,
}

impl Service {
    fn open(node: &TopicNode, options: &PolicyProcessOptions) -> Result<Self, SessionError> {
        let network = LoadedPolicy::load(&options.policy, options.compute)?;
        let names = arm_names(network.recipe().arms);
        let chunks = names.map(|arm| ChunkTopic::publisher(node, arm));
        Ok(Self {
            control: RunControlTopic::subscriber(node, FIRST_ARM)?,
            observed: ObservationBuffer::open(node, &network)?,
            chunks: chunks.collect::<Result<_, _>>()?,
            status: PolicyStatusTopic::publisher(node, FIRST_ARM)?,
            turns: QuerySchedule::of(&network),
            frames_within_ns: options.frames_within_ms * 1_000_000,
            counts: Counts::default(),
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
                    self.turns.begin();
                }
                true
            }
            Some(RunCommand::Stop) | None => false,
        }
    }

    /// Answers the newest observation if it is one's turn and its parts belong together.
    fn answer(&mut self) -> Result<(), SessionError> {
        self.observed.look()?;
        let Some(whole) = self.observed.whole(self.frames_within_ns) else {
            return Ok(());
        };
        match self.turns.of_step(whole.sequence) {
            StepKind::Skip => Ok(()),
            StepKind::Observe => Ok(self.network.observe(&whole.observation())?),
            StepKind::Query => {
                let clock = MonotonicClock::new();
                let before = clock.now();
                let chunks = self.network.infer(&whole.observation())?;
                self.counts.infer_ns = clock.now().since(before);
                self.counts.queries += 1;
                for (publisher, chunk) in self.chunks.iter().zip(&chunks) {
                    publisher.publish(chunk)?;
                }
                self.say(PolicyStage::Ready)
            }
        }
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
