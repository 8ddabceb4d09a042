//! The policy process as its parent sees it: started, waited for, listened to, and told to go.

use std::env;
use std::fs;
use std::os::unix::process::CommandExt as _;
use std::path::Path;
use std::process::{self, Child, Command, Stdio};

use hal::{Chunk, PolicyError, TimeNs};
use tch::Device;
use trocar_nets::compute::{Arithmetic, Compute};
use trocar_nets::loaded_policy::LoadedPolicy;
use trocar_topics::{
    PolicyStage, PolicyStatus, PolicyStatusTopic, Publisher, Reply, RunCommand, RunControl,
    RunControlTopic, Subscriber, TopicNode,
};

use super::arm_chunks::ArmChunks;
use super::on_can::{PATIENCE_NS, Say};
use super::policy_process::FIRST_ARM;
use crate::rt::{self, MonotonicClock};
use crate::session::external::{ExternalChoice, ExternalLink};
use crate::session::source::{STEP_NS, camera_names};
use crate::session::{SessionError, Setup};
use hal::PerArm;

/// The process has this long to load its weights, ns.
const LOAD_NS_MAX: u64 = 120_000_000_000;

/// The process has this long to go by itself, ns.
const EXIT_NS_MAX: u64 = 3_000_000_000;

/// A process that says nothing for this long hangs, ns. Far beyond any inference.
const SILENCE_NS_MAX: u64 = 5_000_000_000;

/// A process that lives and answers no observation for this long, and a query's interval, answers none any more, ns.
const ANSWER_NS_MAX: u64 = 10_000_000_000;

/// Time between two looks, ns.
const POLL_NS: u64 = 1_000_000;

/// Time between two looks at whether an external policy is there, ns.
const LOOK_EVERY_NS: u64 = 20_000_000;

/// Where frames come from that another process shows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outside<'a> {
    /// The name of its topics.
    pub(super) topics: &'a str,
    /// The run's clock.
    pub(super) clock: MonotonicClock,
    /// How far a frame may be from the instant of an observation, ms.
    pub(super) frames_within_ms: u64,
}

impl Outside<'_> {
    /// The topics of an external policy: it is where the frames are, and sees these as they are.
    pub(super) fn topics_of(&self, choice: &ExternalChoice) -> Result<&str, SessionError> {
        match choice.name.as_ref().filter(|name| **name != self.topics) {
            None => Ok(self.topics),
            Some(name) => Err(SessionError::BadArgument(format!(
                "--policy external:{name}: with --backend can it is on the topics of the cameras, --topics {}",
                self.topics
            ))),
        }
    }
}

/// A process that was started here. Dropping it ends it, in peace if it listens.
struct OwnProcess {
    process: Child,
    node: TopicNode,
    control: Publisher<RunControl>,
    status: Subscriber<PolicyStatus>,
    /// While it loads it does not.
    listens: bool,
}

/// Whose process it is.
enum Peer {
    Own(OwnProcess),
    /// Somebody else's, which is told to stop and left to itself.
    External(Box<ExternalLink>),
}

impl Peer {
    const fn node(&self) -> &TopicNode {
        match self {
            Self::Own(own) => &own.node,
            Self::External(link) => &link.node,
        }
    }

    const fn control(&self) -> &Publisher<RunControl> {
        match self {
            Self::Own(own) => &own.control,
            Self::External(link) => &link.control,
        }
    }

    const fn status(&self) -> &Subscriber<PolicyStatus> {
        match self {
            Self::Own(own) => &own.status,
            Self::External(link) => &link.status,
        }
    }

    /// The number of the run's episode.
    const fn episode(&self) -> u64 {
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
            Self::Own(_) => "the policy process".to_owned(),
            Self::External(link) => format!("external policy {:?}, {},", link.name, link.who()),
        }
    }

    /// Why it says no more, if so.
    fn ended(&mut self) -> Result<Option<String>, SessionError> {
        match self {
            Self::Own(own) => {
                let exit = own.process.try_wait().ok().flatten();
                Ok(exit.map(|exit| format!("the policy process ended: {exit}")))
            }
            Self::External(link) => {
                if let Some(reply) = link.replies.newest()?
                    && reply.episode == link.session + 1
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
    chunks: ArmChunks,
    query_every_steps: u64,
    history_steps: u64,
    cameras: Vec<String>,
    queries: u64,
    clock: MonotonicClock,
    /// The run's clock, if the policy's observations have the system's instants.
    outside: Option<MonotonicClock>,
    heard: TimeNs,
    /// When it last answered, or was first asked for its answers.
    answered: Option<TimeNs>,
    /// When it was last looked at whether its process is there.
    looked: TimeNs,
}

impl PolicyChild {
    /// Starts the process and waits until it has loaded the checkpoint in `policy`.
    ///
    /// It is loaded here first, as `network`: a bad one is refused with its reason before any process or thread is started.
    /// With `outside`, the frames come on topics of another process, whose instants are the system's.
    pub(super) fn start(
        network: &LoadedPolicy,
        policy: &Path,
        (seed, compute): (u64, Compute),
        outside: Option<Outside<'_>>,
        say: Say<'_>,
    ) -> Result<Self, SessionError> {
        let query_every_steps = u64::from(network.recipe().query_every_steps).max(1);
        let history_steps = hal::Policy::history_steps(network);
        let cameras = camera_names(network);
        let run_id = match outside {
            Some(Outside { topics, .. }) => topics.to_owned(),
            None => fresh_run_id()?,
        };
        let within_ms = outside.map_or(0, |outside| outside.frames_within_ms);
        let node = TopicNode::join(&run_id)?;
        let control = RunControlTopic::publisher(&node, FIRST_ARM)?;
        let status = PolicyStatusTopic::subscriber(&node, FIRST_ARM)?;
        let chunks = ArmChunks::open(&node, network.recipe().arms)?;
        let own = OwnProcess {
            process: spawn(&run_id, policy, compute, within_ms)?,
            node,
            control,
            status,
            listens: false,
        };
        let mut child = Self {
            peer: Peer::Own(own),
            chunks,
            query_every_steps,
            history_steps,
            cameras,
            queries: 0,
            clock: MonotonicClock::new(),
            outside: outside.map(|outside| outside.clock),
            heard: TimeNs(0),
            answered: None,
            looked: TimeNs(0),
        };
        child.wait_until_ready(seed, LOAD_NS_MAX, say)?;
        Ok(child)
    }

    /// Waits until the external policy behind `link`, of `arms` arms, is ready.
    pub(super) fn external(
        link: ExternalLink,
        arms: usize,
        seed: u64,
        outside: Option<Outside<'_>>,
        say: Say<'_>,
    ) -> Result<Self, SessionError> {
        let within_ns = link.within_ns;
        let mut child = Self {
            chunks: ArmChunks::open(&link.node, arms)?,
            query_every_steps: link.hello.query_every_steps,
            history_steps: link.hello.history_steps,
            cameras: link.cameras.clone(),
            peer: Peer::External(Box::new(link)),
            queries: 0,
            clock: MonotonicClock::new(),
            outside: outside.map(|outside| outside.clock),
            heard: TimeNs(0),
            answered: None,
            looked: TimeNs(0),
        };
        child.wait_until_ready(seed, within_ns, say)?;
        Ok(child)
    }

    fn wait_until_ready(
        &mut self,
        seed: u64,
        within_ns: u64,
        say: Say<'_>,
    ) -> Result<(), SessionError> {
        let mut said = false;
        let episode = self.peer.episode();
        let run = RunControl::new(TimeNs(0), episode, RunCommand::Run { seed });
        self.peer.control().publish(&run)?;
        while self.clock.now().0 < within_ns {
            if let Some(status) = self.peer.status().newest()?
                && status.stage() == PolicyStage::Ready
                && status.episode == episode
            {
                self.heard = self.clock.now();
                if let Peer::Own(own) = &mut self.peer {
                    own.listens = true;
                }
                return Ok(());
            }
            if let Some(reason) = self.ended()? {
                return Err(SessionError::RealTime(format!("{reason}, while loading")));
            }
            if rt::interrupted() {
                return Err(SessionError::RealTime(
                    "interrupted before the run began".to_owned(),
                ));
            }
            if !said && self.clock.now().0 > PATIENCE_NS {
                said = true;
                say(&format!(
                    "waiting for {} to load its weights, for {} s at most; no drive has torque",
                    self.peer.who(),
                    within_ns / 1_000_000_000
                ));
            }
            self.peer.control().keep_alive()?;
            rt::sleep_ns(POLL_NS);
        }
        Err(SessionError::RealTime(format!(
            "{} did not become ready in {} s",
            self.peer.who(),
            within_ns / 1_000_000_000
        )))
    }

    /// Why its process says no more, if so; whether an external one is there is looked at now and then.
    fn ended(&mut self) -> Result<Option<String>, SessionError> {
        let now = self.clock.now();
        if matches!(self.peer, Peer::External(_)) && now.since(self.looked) < LOOK_EVERY_NS {
            return Ok(None);
        }
        self.looked = now;
        self.peer.ended()
    }

    /// Names of the cameras that the policy looks through.
    pub(super) fn cameras(&self) -> Vec<String> {
        self.cameras.clone()
    }

    /// The node that this run's topics live on.
    pub(super) const fn node(&self) -> &TopicNode {
        self.peer.node()
    }

    /// Policy steps from one query to the next.
    pub(super) const fn query_every_steps(&self) -> u64 {
        self.query_every_steps
    }

    /// Policy steps before a query that it wants to have observed too.
    pub(super) const fn history_steps(&self) -> u64 {
        self.history_steps
    }

    /// The newest answer, a chunk for each arm, if one has come since the last call.
    pub(super) fn newest_chunks(&mut self) -> Result<Option<PerArm<Chunk>>, SessionError> {
        let answer = self.chunks.newest()?;
        if answer.is_some() || self.answered.is_none() {
            self.answered = Some(self.clock.now());
        }
        let Some(clock) = &self.outside else {
            return Ok(answer);
        };
        Ok(answer.map(|chunks| {
            chunks.map(|chunk| Chunk {
                observed_at: clock.from_system(chunk.observed_at),
                ..chunk
            })
        }))
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

    /// Why no more chunks will come, if so.
    pub(super) fn end(&mut self) -> Option<String> {
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
            return Some(format!("{who} has been silent for {silence_s} s"));
        }
        let unanswered_ns = self.answered.map_or(0, |answered| now.since(answered));
        let limit_ns = self.peer.answer_ns_max() + self.query_every_steps * STEP_NS;
        (unanswered_ns > limit_ns).then(|| {
            let unanswered_s = seconds(unanswered_ns);
            match &self.peer {
                Peer::Own(_) => format!(
                    "the policy has answered nothing for {unanswered_s} s: it sees no arms and frames of one instant"
                ),
                Peer::External(_) => {
                    let who = self.peer.who();
                    format!("{who} lives and has answered nothing for {unanswered_s} s")
                }
            }
        })
    }
}

impl OwnProcess {
    /// Tells the process to go and waits for it a while; `true` if it went and cleaned up.
    fn goes_by_itself(&mut self) -> bool {
        let told = self
            .control
            .publish(&RunControl::new(TimeNs(0), 1, RunCommand::Stop));
        if told.is_err() {
            return false;
        }
        let clock = MonotonicClock::new();
        while clock.now().0 < EXIT_NS_MAX {
            if let Ok(Some(exit)) = self.process.try_wait() {
                return exit.success();
            }
            rt::sleep_ns(POLL_NS);
        }
        false
    }
}

impl Drop for OwnProcess {
    fn drop(&mut self) {
        if !(self.listens && self.goes_by_itself()) {
            // Whatever went wrong, nothing is left behind: no process, and nothing of it in shared memory.
            let _gone = self.process.kill();
            let _reaped = self.process.wait();
            self.node.remove_dead();
        }
    }
}

/// The task must have the cameras that the network was trained with.
pub(super) fn check_cameras(setup: &Setup, network: &LoadedPolicy) -> Result<(), SessionError> {
    for (index, (name, trained)) in camera_names(network)
        .into_iter()
        .zip(&network.recipe().cameras)
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

/// A name for the run's topics that no other run on this machine has: containers may share memory and count their processes
/// alike, so the process id alone would not do.
fn fresh_run_id() -> Result<String, SessionError> {
    let uuid = fs::read_to_string("/proc/sys/kernel/random/uuid")
        .map_err(|error| failed("naming the run", &error))?;
    let tag: String = uuid.chars().take(8).collect();
    Ok(format!("run-{}-{tag}", process::id()))
}

fn spawn(
    run_id: &str,
    policy: &Path,
    compute: Compute,
    frames_within_ms: u64,
) -> Result<Child, SessionError> {
    let program = env::current_exe().map_err(|error| failed("finding this program", &error))?;
    let device = if compute.device == Device::Cpu {
        "cpu"
    } else {
        "cuda"
    };
    let precision = match compute.arithmetic {
        Arithmetic::F32 => "f32",
        Arithmetic::Bf16 => "bf16",
    };
    Command::new(program)
        .args(["policy-process", "--run-id", run_id, "--policy"])
        .arg(policy)
        .args(["--device", device, "--precision", precision])
        .args(["--threads", &compute.threads.to_string()])
        .args(["--frames-within-ms", &frames_within_ms.to_string()])
        // Threads that wait for each other sleep: spinning, they would take cores from the simulation and the control.
        .env("OMP_WAIT_POLICY", "PASSIVE")
        .args(["--parent-pid", &process::id().to_string()])
        .stdin(Stdio::null())
        // A Ctrl-C in the terminal is for this process alone, which then stops the arm before the policy.
        .process_group(0)
        .spawn()
        .map_err(|error| failed("starting the policy process", &error))
}

fn failed(doing: &str, error: &std::io::Error) -> SessionError {
    SessionError::RealTime(format!("{doing} failed: {error}"))
}
