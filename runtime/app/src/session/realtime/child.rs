//! The policy process as its parent sees it: started, waited for, listened to, and told to go.

use std::ffi::OsString;
use std::path::Path;

use hal::{Chunk, PolicyError, TimeNs};
use tch::Device;
use trocar_nets::checkpoint::Recipe;
use trocar_nets::compute::{Arithmetic, Compute};
use trocar_nets::loaded_policy::PolicyOutline;
use trocar_topics::{
    Events, PolicyStage, PolicyStatus, PolicyStatusTopic, Publisher, Reply, RunCommand, RunControl,
    RunControlTopic, Subscriber, TopicNode,
};

use super::arm_chunks::ArmChunks;
use super::checkpoint_files::{CheckpointFiles, FilesCheck};
use super::child_process::{ChildProcess, Spawned};
use super::policy_process::FIRST_ARM;
use super::remote_arms::PrintLine;
use super::supervisor::{Remote, await_ready};
use crate::rt::{self, MonotonicClock};
use crate::session::external::{ExternalChoice, ExternalLink, LOOK_NS};
use crate::session::source::{STEP_NS, camera_names};
use crate::session::{SessionError, Setup};
use hal::PerArm;

/// How long the process may take until it is ready, ns.
const LOAD_NS_MAX: u64 = 120_000_000_000;

/// A process that says nothing for this long hangs, ns. Far beyond any inference.
const SILENCE_NS_MAX: u64 = 5_000_000_000;

/// A process that lives and answers no observation for this long, and a query's interval, answers
/// none any more, ns.
pub(super) const ANSWER_NS_MAX: u64 = 10_000_000_000;

/// The code with which this program ends for bad input.
const BAD_INPUT: i32 = 2;

/// Polling period for whether an external policy is there, ns.
const LOOK_EVERY_NS: u64 = 20_000_000;

/// The topics on which frames are.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outside<'a> {
    /// Their name.
    pub(super) topics: &'a str,
    /// How far a frame may be from the instant of an observation, ms: 0 of cameras that draw the
    /// run's own scene.
    pub(super) frames_within_ms: u64,
}

impl Outside<'_> {
    /// The topics of an external policy: it is where the frames are, and sees these as they are.
    pub(super) fn topics_of(&self, choice: &ExternalChoice) -> Result<&str, SessionError> {
        match choice.name.as_ref().filter(|name| **name != self.topics) {
            None => Ok(self.topics),
            Some(name) => Err(SessionError::BadArgument(format!(
                "--policy external:{name}: it is on the topics of the cameras, --topics {}",
                self.topics
            ))),
        }
    }
}

/// A process of ours, with the checkpoint that it has loaded.
struct OwnProcess {
    process: ChildProcess<PolicyStatus>,
    files: CheckpointFiles,
    /// While it is to be started again, and its files are compared.
    check: Option<FilesCheck>,
}

impl OwnProcess {
    /// Starts the process again once its files were found to be the same; whether it has been.
    fn start_checked(&mut self) -> Result<bool, SessionError> {
        let Some(check) = self.check.take_if(|check| check.is_done()) else {
            return Ok(false);
        };
        check.found()?;
        self.process.start_again()?;
        Ok(true)
    }

    /// Why it says no more, if so; one that is to be started again has ended for good.
    fn ended(&mut self) -> Option<String> {
        match self.check {
            Some(_) => None,
            None => self.process.exit(),
        }
    }
}

/// Whose process it is.
enum Peer {
    Own(Box<OwnProcess>),
    /// One that this run did not start, which is told to stop and left to itself.
    External(Box<ExternalLink>),
}

impl Peer {
    const fn node(&self) -> &TopicNode {
        match self {
            Self::Own(own) => &own.process.node,
            Self::External(link) => &link.node,
        }
    }

    const fn control(&self) -> &Publisher<RunControl> {
        match self {
            Self::Own(own) => &own.process.control,
            Self::External(link) => &link.control,
        }
    }

    /// Hands what was said to a process that has come since: of an external policy, who the session
    /// is too.
    fn keep_alive(&self) -> Result<(), SessionError> {
        match self {
            Self::Own(own) => own.process.control.keep_alive()?,
            Self::External(link) => link.keep_alive()?,
        }
        Ok(())
    }

    const fn status(&self) -> &Subscriber<PolicyStatus> {
        match self {
            Self::Own(own) => &own.process.status,
            Self::External(link) => &link.status,
        }
    }

    /// The number of the run's episode at first.
    const fn first_episode(&self) -> u64 {
        match self {
            Self::Own(_) => 1,
            Self::External(link) => link.session + 1,
        }
    }

    /// How long it may say nothing, ns.
    fn silence_ns_max(&self) -> u64 {
        match self {
            Self::Own(_) => SILENCE_NS_MAX,
            Self::External(link) => link.within_ns.max(SILENCE_NS_MAX),
        }
    }

    /// How long it may answer nothing, ns, besides a query's interval.
    fn answer_ns_max(&self) -> u64 {
        match self {
            Self::Own(_) => ANSWER_NS_MAX,
            Self::External(link) => link.within_ns.max(ANSWER_NS_MAX),
        }
    }

    /// What it is called where a run ends with it.
    fn who(&self) -> String {
        match self {
            Self::Own(own) => own.process.who().to_owned(),
            Self::External(link) => format!("external policy {:?}, {},", link.name, link.who()),
        }
    }

    /// Why it says no more in `episode`, if so.
    fn ended(&mut self, episode: u64) -> Result<Option<String>, SessionError> {
        match self {
            Self::Own(own) => Ok(own.ended()),
            Self::External(link) => {
                if let Some(reply) = link.replies.newest()?
                    && reply.episode == episode
                    && reply.what() == Reply::Failed
                {
                    let reason = format!("{} failed: {}", link.who(), reply.text.text());
                    return Ok(Some(link.failed(reason).to_string()));
                }
                Ok(link.gone().map(|reason| link.failed(reason).to_string()))
            }
        }
    }
}

/// The running policy process.
pub(super) struct PolicyChild {
    peer: Peer,
    events: Events,
    chunks: ArmChunks,
    query_every_steps: u64,
    history_steps: u64,
    queries: u64,
    /// What the policy depends on that is random.
    seed: u64,
    /// Counts how often it was told to begin.
    episode: u64,
    /// The highest number of a chunk that was handed on, and that of those before the present
    /// process.
    highest: u64,
    numbered_from: u64,
    /// No observation of before, by the run's clock, is answered any more.
    since: TimeNs,
    /// Of its own: when it was heard and looked at.
    clock: MonotonicClock,
    /// The run's clock, once there is one: instants on topics are the system's.
    of_run: MonotonicClock,
    heard: TimeNs,
    /// When it last answered, or was first asked for its answers.
    answered: Option<TimeNs>,
    /// When it was last looked at whether its process is there.
    looked: TimeNs,
}

impl PolicyChild {
    /// Starts the process and waits until it has loaded the checkpoint of `files`.
    ///
    /// Of it no more than the `outline` is read here: what is wrong with the weights, the process
    /// says on standard error. Its topics, and the frames, are `outside`.
    pub(super) fn start(
        outline: &PolicyOutline,
        files: CheckpointFiles,
        (seed, compute): (u64, Compute),
        outside: Outside<'_>,
        say: PrintLine<'_>,
    ) -> Result<Self, SessionError> {
        let query_every_steps = u64::from(outline.recipe.query_every_steps).max(1);
        let node = TopicNode::join(outside.topics)?;
        let control = RunControlTopic::publisher(&node, FIRST_ARM)?;
        let status = PolicyStatusTopic::subscriber(&node, FIRST_ARM)?;
        let chunks = ArmChunks::open(&node, outline.recipe.arms)?;
        let policy = files.folder().to_owned();
        let spawned = policy_verb(&policy, compute, outside);
        let own = OwnProcess {
            process: ChildProcess::start(spawned, node, (control, status))?,
            files,
            check: None,
        };
        let shown = (query_every_steps, outline.history_steps);
        let peer = Peer::Own(Box::new(own));
        let mut child = Self::new(peer, chunks, shown, seed)?;
        match child.wait_until_ready(LOAD_NS_MAX, say) {
            Ok(()) => Ok(child),
            Err(_) if child.has_refused() => Err(SessionError::BadArgument(format!(
                "policy {}: its process has refused it, as said above",
                policy.display()
            ))),
            Err(error) => Err(error),
        }
    }

    /// Waits until the external policy behind `link`, of `arms` arms, is ready.
    pub(super) fn external(
        link: ExternalLink,
        arms: usize,
        seed: u64,
        say: PrintLine<'_>,
    ) -> Result<Self, SessionError> {
        let within_ns = link.within_ns;
        let chunks = ArmChunks::open(&link.node, arms)?;
        let hello = &link.hello;
        let shown = (hello.query_every_steps, hello.history_steps);
        let peer = Peer::External(Box::new(link));
        let mut child = Self::new(peer, chunks, shown, seed)?;
        child.wait_until_ready(within_ns, say)?;
        Ok(child)
    }

    fn new(
        peer: Peer,
        chunks: ArmChunks,
        (query_every_steps, history_steps): (u64, u64),
        seed: u64,
    ) -> Result<Self, SessionError> {
        Ok(Self {
            events: peer.node().events()?,
            chunks,
            query_every_steps,
            history_steps,
            queries: 0,
            seed,
            episode: peer.first_episode(),
            highest: 0,
            numbered_from: 0,
            since: TimeNs(0),
            clock: MonotonicClock::new(),
            of_run: MonotonicClock::new(),
            heard: TimeNs(0),
            answered: None,
            looked: TimeNs(0),
            peer,
        })
    }

    fn wait_until_ready(&mut self, within_ns: u64, say: PrintLine<'_>) -> Result<(), SessionError> {
        self.tell_to_begin()?;
        let events = self.peer.node().events()?;
        await_ready(self, (self.clock, within_ns), &events, say)
    }

    /// Whether a process of ours has ended because its policy can't be loaded.
    fn has_refused(&mut self) -> bool {
        match &mut self.peer {
            Peer::Own(own) => own.process.exit_code() == Some(BAD_INPUT),
            Peer::External(_) => false,
        }
    }

    /// Tells it to begin the next episode. Nothing that was said before counts.
    fn begin_anew(&mut self) -> Result<(), SessionError> {
        self.episode += 1;
        self.queries = 0;
        self.numbered_from = self.highest;
        self.tell_to_begin()
    }

    fn tell_to_begin(&self) -> Result<(), SessionError> {
        let command = RunCommand::Run { seed: self.seed };
        let run = RunControl::new(TimeNs(0), self.episode, command);
        self.peer.control().publish(&run)?;
        Ok(())
    }

    /// From now on instants are those of the run's `clock`.
    pub(super) const fn follow(&mut self, clock: MonotonicClock) {
        self.of_run = clock;
    }

    /// Tells a process of ours to go, without waiting for it; one that is still loading is ended
    /// later.
    pub(super) fn tell_to_go(&self) {
        if let Peer::Own(own) = &self.peer
            && own.process.listens
        {
            let _told = own.process.tell_to_go();
        }
    }

    /// Waits until it may have said something, or for [`LOOK_NS`].
    pub(super) fn wait(&self) {
        rt::wait(&self.events, LOOK_NS);
    }

    /// Policy steps from one query to the next.
    pub(super) const fn query_every_steps(&self) -> u64 {
        self.query_every_steps
    }

    /// Policy steps before a query that it wants to have observed too.
    pub(super) const fn history_steps(&self) -> u64 {
        self.history_steps
    }

    /// No answer is expected of it for now, since it is shown nothing.
    pub(super) fn excuse(&mut self) {
        self.answered = self.answered.map(|_| self.clock.now());
    }

    /// The newest answer, a chunk for each arm, if one has come since the last call.
    pub(super) fn newest_chunks(&mut self) -> Result<Option<PerArm<Chunk>>, SessionError> {
        let answer = self.chunks.newest()?;
        if answer.is_some() || self.answered.is_none() {
            self.answered = Some(self.clock.now());
        }
        let of_run = self.of_run;
        let numbered_from = self.numbered_from;
        let answer = answer.map(|chunks| {
            chunks.map(|chunk| Chunk {
                observed_at: of_run.from_system(chunk.observed_at),
                // A process that begins anew counts from the beginning, and the gate wants to see
                // them rise.
                sequence: chunk.sequence.saturating_add(numbered_from),
                ..chunk
            })
        });
        let answer = answer.filter(|chunks| chunks.first.observed_at >= self.since);
        if let Some(chunks) = &answer {
            self.highest = self.highest.max(chunks.first.sequence);
        }
        Ok(answer)
    }

    /// How long the newest chunk took to compute, once for each chunk.
    pub(super) fn newest_inference_ns(&mut self) -> Result<Option<u64>, SessionError> {
        let Some(status) = self.peer.status().newest()? else {
            return Ok(None);
        };
        self.heard = self.clock.now();
        let fresh = status.queries != self.queries;
        self.queries = status.queries;
        Ok(fresh.then_some(status.infer_ns))
    }
}

impl Remote for PolicyChild {
    fn who(&self) -> String {
        self.peer.who()
    }

    fn is_own(&self) -> bool {
        matches!(self.peer, Peer::Own(_))
    }

    /// Our own process is started again, with the same checkpoint or not at all; an external one is
    /// told to begin again, and may be another process by then.
    fn call_again(&mut self) -> Result<(), SessionError> {
        match &mut self.peer {
            Peer::Own(own) => {
                // One that hangs takes no core from the comparison, which goes on if it is under
                // way.
                own.process.kill();
                if own.check.is_none() {
                    own.check = Some(own.files.begin_check()?);
                }
            }
            Peer::External(_) => self.begin_anew()?,
        }
        Ok(())
    }

    /// Whether the files of our own are compared.
    fn is_preparing(&self) -> bool {
        matches!(&self.peer, Peer::Own(own) if own.check.is_some())
    }

    /// Whether it has begun as it was told, and answers from now on.
    fn is_ready(&mut self) -> Result<bool, SessionError> {
        self.peer.keep_alive()?;
        let status = self.peer.status().newest()?;
        let ready = status.is_some_and(|status| {
            status.stage() == PolicyStage::Ready && status.episode == self.episode
        });
        if ready {
            self.heard = self.clock.now();
            self.answered = None;
            if let Peer::Own(own) = &mut self.peer {
                own.process.listens = true;
            }
        }
        Ok(ready)
    }

    fn is_back(&mut self, now: TimeNs) -> Result<bool, SessionError> {
        match &mut self.peer {
            Peer::Own(own) if own.check.is_some() => {
                if own.start_checked()? {
                    self.begin_anew()?;
                }
                return Ok(false);
            }
            Peer::Own(_) => {}
            Peer::External(link) => link.welcome()?,
        }
        let back = self.is_ready()?;
        if back {
            // What its predecessor has left, and what it has said itself before it began anew.
            let _stale = self.chunks.newest()?;
            self.since = now;
        }
        Ok(back)
    }

    /// Whether an external one is there is looked at now and then.
    fn ended(&mut self) -> Result<Option<String>, SessionError> {
        let now = self.clock.now();
        if matches!(self.peer, Peer::External(_)) && now.since(self.looked) < LOOK_EVERY_NS {
            return Ok(None);
        }
        self.looked = now;
        self.peer.ended(self.episode)
    }

    /// Why no more chunks will come, if so.
    fn lost(&mut self) -> Option<String> {
        match self.ended() {
            Ok(None) => {}
            Ok(Some(reason)) => return Some(reason),
            Err(error) => return Some(error.to_string()),
        }
        let now = self.clock.now();
        let seconds = |ns: u64| ns / 1_000_000_000;
        let silence_ns = now.since(self.heard);
        if silence_ns > self.peer.silence_ns_max() {
            let (who, silence_s) = (self.peer.who(), seconds(silence_ns));
            return Some(format!("{who} has sent no heartbeat for {silence_s} s"));
        }
        let unanswered_ns = self.answered.map_or(0, |answered| now.since(answered));
        let limit_ns = self.peer.answer_ns_max() + self.query_every_steps * STEP_NS;
        (unanswered_ns > limit_ns).then(|| match &self.peer {
            Peer::Own(_) => answers_nothing(unanswered_ns),
            Peer::External(_) => {
                let (who, unanswered_s) = (self.peer.who(), seconds(unanswered_ns));
                format!("{who} lives and has answered nothing for {unanswered_s} s")
            }
        })
    }
}

/// Why a run ends whose own policy has answered nothing for so long, ns.
pub(super) fn answers_nothing(unanswered_ns: u64) -> String {
    let unanswered_s = unanswered_ns / 1_000_000_000;
    format!(
        "the policy has answered nothing for {unanswered_s} s: it sees no arms and frames of one instant"
    )
}

/// The hidden verb that runs the checkpoint in `policy`.
fn policy_verb(policy: &Path, compute: Compute, outside: Outside<'_>) -> Spawned {
    let device = if compute.device == Device::Cpu {
        "cpu"
    } else {
        "cuda"
    };
    let precision = match compute.arithmetic {
        Arithmetic::F32 => "f32",
        Arithmetic::Bf16 => "bf16",
    };
    let (threads, within_ms) = (compute.threads, outside.frames_within_ms);
    let options = [
        ("--run-id", OsString::from(outside.topics)),
        ("--policy", policy.into()),
        ("--device", device.into()),
        ("--precision", precision.into()),
        ("--threads", threads.to_string().into()),
        ("--frames-within-ms", within_ms.to_string().into()),
    ];
    let options = options
        .into_iter()
        .flat_map(|(name, value)| [name.into(), value]);
    Spawned {
        who: "the policy process",
        arguments: [OsString::from("policy-process")]
            .into_iter()
            .chain(options)
            .collect(),
    }
}

/// The task must have the cameras that the network was trained with.
pub(super) fn check_cameras(setup: &Setup, recipe: &Recipe) -> Result<(), SessionError> {
    for (index, (name, trained)) in camera_names(recipe)
        .into_iter()
        .zip(&recipe.cameras)
        .enumerate()
    {
        let Some(camera) = setup.task.cameras.iter().find(|camera| camera.name == name) else {
            return Err(SessionError::UnknownCamera {
                name,
                available: setup.camera_names().join(", "),
            });
        };
        if (camera.width, camera.height) != (trained.width, trained.height) {
            return Err(SessionError::Policy(PolicyError::ImageSize {
                camera: index,
                expected_width: trained.width,
                expected_height: trained.height,
                width: camera.width,
                height: camera.height,
            }));
        }
    }
    Ok(())
}
