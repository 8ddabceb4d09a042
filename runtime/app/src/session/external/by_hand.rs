//! A checkpoint as an external policy: a process that a person starts, which answers one session
//! after another.

use std::path::PathBuf;
use std::process;

use hal::{Chunk, Policy as _, PolicyError, TimeNs, arm_names};
use trocar_nets::compute::Compute;
use trocar_nets::loaded_policy::LoadedPolicy;
use trocar_topics::{
    ChunkTopic, Events, Line, POLICY_CAMERAS_MAX, PolicyHello, PolicyHelloTopic, PolicyReply,
    PolicyReplyTopic, PolicyStage, PolicyStatus, PolicyStatusTopic, Publisher, Reply, RunCommand,
    RunControl, RunControlTopic, SessionHello, SessionHelloTopic, Subscriber, TopicNode,
};

use super::link::{FIRST_ARM, LOOK_NS};
use crate::rt::{self, MonotonicClock};
use crate::session::SessionError;
use crate::session::realtime::observed::{ObservationBuffer, QuerySchedule, StepKind};
use crate::session::source::camera_names;

/// Time between two signs of life, ns.
const STATUS_EVERY_NS: u64 = 50_000_000;

/// Polling period for whether the session's process is there, ns.
const ALIVE_EVERY_NS: u64 = 200_000_000;

/// What a policy by hand is started with.
#[derive(Clone, Debug)]
pub struct ByHand {
    /// The name of its topics.
    pub name: String,
    /// The checkpoint's directory.
    pub policy: PathBuf,
    /// Where and how the network computes.
    pub compute: Compute,
    /// After how many sessions it ends; only a signal ends it if not given.
    pub sessions: Option<u64>,
}

/// Answers sessions of `--policy external:NAME`, in lockstep and in real time, with the checkpoint
/// of `options`; how many they were.
///
/// A session that the network fails in is told why, and the next one can come. `say` hears of
/// sessions as they come and go.
///
/// # Errors
/// If the checkpoint or the topics can't be opened; [`SessionError::BadArgument`] if it looks
/// through more cameras than can be asked for.
pub fn serve_by_hand(options: &ByHand, say: &mut dyn FnMut(&str)) -> Result<u64, SessionError> {
    let mut server = Server::open(options)?;
    say(&format!(
        "{} is on topics {:?}",
        options.policy.display(),
        options.name
    ));
    let mut served = 0;
    while options.sessions.is_none_or(|wanted| served < wanted) {
        if rt::interrupted() {
            server.fail("it was stopped by a signal")?;
            break;
        }
        if let Some(ended) = server.look(say)? {
            served += 1;
            say(ended);
        }
        rt::wait(&server.events, LOOK_NS);
    }
    Ok(served)
}

#[derive(Clone, Copy, Debug, Default)]
struct Counts {
    said: u64,
    queries: u64,
    infer_ns: u64,
    /// The observation that was dealt with last.
    sequence: u64,
}

struct Server {
    node: TopicNode,
    events: Events,
    hello: Publisher<PolicyHello>,
    control: Subscriber<RunControl>,
    sessions: Subscriber<SessionHello>,
    status: Publisher<PolicyStatus>,
    replies: Publisher<PolicyReply>,
    /// One an arm.
    chunks: Vec<Publisher<Chunk>>,
    observed: ObservationBuffer,
    network: LoadedPolicy,
    turns: QuerySchedule,
    session: Option<SessionHello>,
    /// An episode that it was told of, before it knows the session.
    waiting: Option<RunControl>,
    episode: u64,
    running: bool,
    counts: Counts,
    clock: MonotonicClock,
    /// When it last gave a sign of life, and looked at the session's process.
    told: TimeNs,
    looked: TimeNs,
}

impl Server {
    fn open(options: &ByHand) -> Result<Self, SessionError> {
        let network = LoadedPolicy::load(&options.policy, options.compute)?;
        let turns = QuerySchedule::of(&network);
        let hello = hello(options, &network, turns.steps())?;
        let node = TopicNode::join(&options.name)?;
        let arms = arm_names(network.recipe().arms);
        let server = Self {
            hello: PolicyHelloTopic::publisher(&node, FIRST_ARM)?,
            control: RunControlTopic::subscriber(&node, FIRST_ARM)?,
            sessions: SessionHelloTopic::subscriber(&node, FIRST_ARM)?,
            status: PolicyStatusTopic::publisher(&node, FIRST_ARM)?,
            replies: PolicyReplyTopic::publisher(&node, FIRST_ARM)?,
            chunks: arms
                .map(|arm| ChunkTopic::publisher(&node, arm))
                .collect::<Result<_, _>>()?,
            observed: ObservationBuffer::open(&node, &network)?,
            events: node.events()?,
            node,
            network,
            turns,
            session: None,
            waiting: None,
            episode: 0,
            running: false,
            counts: Counts::default(),
            clock: MonotonicClock::new(),
            told: TimeNs(0),
            looked: TimeNs(0),
        };
        // Last, so that whoever hears it is heard.
        server.hello.publish(&hello)?;
        Ok(server)
    }

    /// Deals with what has come; says so if a session has ended with it.
    fn look(&mut self, say: &mut dyn FnMut(&str)) -> Result<Option<&'static str>, SessionError> {
        if let Some(session) = self.sessions.newest()? {
            let (task, pid) = (session.task.text(), session.pid);
            let trained_on = &self.network.recipe().dataset.task;
            let warning = match task.is_empty() || task == *trained_on {
                true => String::new(),
                false => format!("; the network was trained on task {trained_on:?}"),
            };
            say(&format!("session of process {pid}, task {task:?}{warning}"));
            self.session = Some(session);
        }
        if let Some(control) = self.control.newest()? {
            match control.command() {
                Some(RunCommand::Wait) => {}
                Some(RunCommand::Run { .. }) => self.waiting = Some(control),
                Some(RunCommand::Stop) | None if self.is_of_session(&control) => {
                    return self.end("the session is over").map(Some);
                }
                Some(RunCommand::Stop) | None => {}
            }
        }
        self.begin()?;
        if self.running {
            self.answer()?;
        }
        self.give_signs_of_life()?;
        if self.is_left() {
            self.node.remove_dead();
            return self.end("the session's process is gone").map(Some);
        }
        Ok(None)
    }

    /// Whether the session's process has died; looks now and then.
    fn is_left(&mut self) -> bool {
        let now = self.clock.now();
        let Some(session) = &self.session else {
            return false;
        };
        if now.since(self.looked) <= ALIVE_EVERY_NS {
            return false;
        }
        self.looked = now;
        !self.node.is_alive(session.pid)
    }

    /// Whether `control` is from the session that it knows: the upper halves of their numbers are
    /// the same.
    fn is_of_session(&self, control: &RunControl) -> bool {
        let session = self.session.as_ref().map(|it| it.session >> 32);
        session == Some(control.episode >> 32)
    }

    /// Resets for the episode that it was told of, once it knows the session.
    fn begin(&mut self) -> Result<(), SessionError> {
        let Some(control) = self.waiting.filter(|it| self.is_of_session(it)) else {
            return Ok(());
        };
        self.waiting = None;
        if control.episode == self.episode {
            return Ok(());
        }
        self.episode = control.episode;
        self.network.reset(control.seed);
        self.turns.begin();
        self.observed.forget()?;
        self.counts.queries = 0;
        self.running = true;
        self.say()
    }

    fn end(&mut self, why: &'static str) -> Result<&'static str, SessionError> {
        self.session = None;
        self.waiting = None;
        self.running = false;
        self.observed.forget()?;
        Ok(why)
    }

    /// Answers or remembers the newest observation, if it wants that.
    fn answer(&mut self) -> Result<(), SessionError> {
        self.observed.look()?;
        let within_ns = self.session.as_ref().map_or(0, |it| it.frames_within_ns);
        let Some(whole) = self.observed.whole(within_ns) else {
            return Ok(());
        };
        let turn = self.turns.of_step(whole.sequence);
        if turn == StepKind::Skip {
            return Ok(());
        }
        let asked = self.clock.now();
        self.counts.sequence = whole.sequence;
        let observation = whole.observation();
        if turn == StepKind::Observe {
            let seen = self.network.observe(&observation);
            return self.reply(seen.map(|()| (Reply::Observed, 0)));
        }
        let chunks = self.network.infer(&observation);
        self.counts.infer_ns = self.clock.now().since(asked);
        self.counts.queries += 1;
        for (publisher, chunk) in self.chunks.iter().zip(chunks.iter().flatten()) {
            publisher.publish(chunk)?;
        }
        self.reply(chunks.map(|chunks| (Reply::Answered, chunks.len() as u64)))?;
        self.say()
    }

    fn reply(&mut self, done: Result<(Reply, u64), PolicyError>) -> Result<(), SessionError> {
        match done {
            Ok((what, count)) => {
                let sequence = self.counts.sequence;
                let reply = PolicyReply::new(self.episode, sequence, what, count, "");
                self.replies.publish(&reply)?;
                Ok(())
            }
            Err(error) => self.fail(&error.to_string()),
        }
    }

    /// Ends the session, if there is one, with `text` as the reason.
    fn fail(&mut self, text: &str) -> Result<(), SessionError> {
        self.running = false;
        if self.session.is_some() {
            let sequence = self.counts.sequence;
            let reply = PolicyReply::new(self.episode, sequence, Reply::Failed, 0, text);
            self.replies.publish(&reply)?;
        }
        Ok(())
    }

    fn give_signs_of_life(&mut self) -> Result<(), SessionError> {
        let now = self.clock.now();
        if now.since(self.told) < STATUS_EVERY_NS {
            return Ok(());
        }
        self.told = now;
        self.hello.keep_alive()?;
        self.replies.keep_alive()?;
        if self.running {
            return self.say();
        }
        Ok(self.status.keep_alive()?)
    }

    fn say(&mut self) -> Result<(), SessionError> {
        self.counts.said += 1;
        let Counts {
            said,
            queries,
            infer_ns,
            ..
        } = self.counts;
        let ready = PolicyStatus::new(said, self.episode, PolicyStage::Ready, queries, infer_ns);
        self.status.publish(&ready)?;
        Ok(())
    }
}

fn hello(
    options: &ByHand,
    network: &LoadedPolicy,
    (query_every_steps, history_steps): (u64, u64),
) -> Result<PolicyHello, SessionError> {
    let names = camera_names(network.recipe());
    let mut cameras = [Line::default(); POLICY_CAMERAS_MAX];
    if names.len() > cameras.len() {
        return Err(SessionError::BadArgument(format!(
            "{}: the network looks through {} cameras: allowed are {POLICY_CAMERAS_MAX}",
            options.policy.display(),
            names.len()
        )));
    }
    for (camera, name) in cameras.iter_mut().zip(&names) {
        *camera = Line::new(name);
    }
    let name = options.policy.file_name().unwrap_or_default();
    Ok(PolicyHello {
        pid: u64::from(process::id()),
        arm_count: network.recipe().arms as u64,
        query_every_steps,
        history_steps,
        camera_count: names.len() as u64,
        name: Line::new(&name.to_string_lossy()),
        cameras,
    })
}
