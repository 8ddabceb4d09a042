//! A policy in another process, anybody's: it takes part over topics, in lockstep as request and answer.
//!
//! ```text
//! policy                                      session
//!   policy_hello: cameras, query interval ──>
//!                                           <── session_hello, control: run, episode, seed
//!   policy_status: has reset for the episode ──>
//!                                           <── frame of each camera, state of each arm
//!   chunk for each arm, policy_reply ──>
//!                                           <── control: stop
//! ```
//!
//! In real time the same topics are written and read by the threads of the run, and nobody waits for a reply.

use std::{fs, process};

use hal::{ARM_NAMES, Chunk, FrameRef, Observation, Policy, PolicyError, TimeNs};
use trocar_topics::{
    ArmReport, ArmStateTopic, CameraTopic, ChunkTopic, Events, FrameHeader, FramePublisher, Line,
    PolicyHello, PolicyHelloTopic, PolicyReply, PolicyReplyTopic, PolicyStage, PolicyStatus,
    PolicyStatusTopic, Publisher, Reply, RunCommand, RunControl, RunControlTopic, SessionHello,
    SessionHelloTopic, Subscriber, TopicError, TopicNode,
};

use super::source::STEP_NS;
use super::{SessionError, Setup};
use crate::rt::{self, MonotonicClock};

mod by_hand;
mod choice;

pub use by_hand::{ByHand, serve_by_hand};
pub use choice::{DEFAULT_NAME, DEFAULT_WITHIN_S, ExternalChoice, INSTRUCTION_BYTES_MAX};

/// The arm that the topics of the whole policy are named after.
const FIRST_ARM: &str = ARM_NAMES[0];

/// Whoever waits for topics looks this often even if nobody has woken it, ns: for writers that wake nobody, and readers that came late.
pub(super) const LOOK_NS: u64 = 10_000_000;

/// Time from one look at whether the policy lives to the next, ns.
const ALIVE_EVERY_NS: u64 = 25_000_000;

/// Most policy steps from one query to the next, or of a history.
const STEPS_MAX: u64 = 10_000;

/// What a session says of itself.
#[derive(Clone, Copy, Debug)]
pub(super) struct About<'a> {
    /// The task, empty if there is none.
    pub(super) task: &'a str,
    /// What is to be done, in words.
    pub(super) instruction: &'a str,
    /// How many arms there are.
    pub(super) arms: usize,
    /// Whether time stands still until the policy has answered.
    pub(super) lockstep: bool,
    /// How far a frame of any camera but the first may be from the instant of an observation, ms.
    pub(super) frames_within_ms: u64,
}

/// The topics that a session and an external policy share, once the policy has said hello.
pub(super) struct ExternalLink {
    pub(super) name: String,
    pub(super) within_ns: u64,
    pub(super) node: TopicNode,
    pub(super) control: Publisher<RunControl>,
    pub(super) status: Subscriber<PolicyStatus>,
    pub(super) replies: Subscriber<PolicyReply>,
    pub(super) hello: PolicyHello,
    pub(super) cameras: Vec<String>,
    /// Its upper 32 bits are those of the numbers of all episodes.
    pub(super) session: u64,
    said: Publisher<SessionHello>,
    hellos: Subscriber<PolicyHello>,
    events: Events,
}

impl ExternalLink {
    /// Opens the topics `name` and waits for a policy that commands the arms of `about`.
    pub(super) fn open(name: &str, within_s: u64, about: &About<'_>) -> Result<Self, SessionError> {
        let node = TopicNode::join(name)?;
        let session = fresh_session()?;
        let control = RunControlTopic::publisher(&node, FIRST_ARM)?;
        let said = SessionHelloTopic::publisher(&node, FIRST_ARM)?;
        said.publish(&SessionHello {
            session,
            pid: u64::from(process::id()),
            arm_count: about.arms as u64,
            lockstep: u64::from(about.lockstep),
            step_ns: STEP_NS,
            frames_within_ns: about.frames_within_ms * 1_000_000,
            task: Line::new(about.task),
            instruction: Line::new(about.instruction),
        })?;
        let mut link = Self {
            hellos: PolicyHelloTopic::subscriber(&node, FIRST_ARM)?,
            name: name.to_owned(),
            within_ns: within_s * 1_000_000_000,
            control,
            status: PolicyStatusTopic::subscriber(&node, FIRST_ARM)?,
            replies: PolicyReplyTopic::subscriber(&node, FIRST_ARM)?,
            hello: PolicyHello::default(),
            cameras: Vec::new(),
            session,
            said,
            events: node.events()?,
            node,
        };
        link.hello = link.wait("appeared", |link| {
            link.hellos.newest().map_err(|error| link.topic(&error))
        })?;
        link.cameras = checked(&link.hello, about).map_err(|reason| link.refused(reason))?;
        Ok(link)
    }

    /// Looks whenever something is published until there is something. `doing` is what the policy has not done in time.
    pub(super) fn wait<T>(
        &self,
        doing: &str,
        mut look: impl FnMut(&Self) -> Result<Option<T>, PolicyError>,
    ) -> Result<T, PolicyError> {
        let clock = MonotonicClock::new();
        let mut alive = clock.now();
        while clock.now().0 < self.within_ns {
            if let Some(found) = look(self)? {
                return Ok(found);
            }
            if rt::interrupted() {
                return Err(PolicyError::Interrupted);
            }
            if clock.now().since(alive) >= ALIVE_EVERY_NS {
                alive = clock.now();
                let told = self.keep_alive().and_then(|()| self.check_alive());
                told?;
            }
            rt::wait(&self.events, LOOK_NS);
        }
        let within_s = self.within_ns / 1_000_000_000;
        Err(self.failed(format!("has not {doing} for {within_s} s")))
    }

    /// Takes note of a process that has come in the place of one that left. It must want to be shown the same.
    pub(super) fn welcome(&mut self) -> Result<(), SessionError> {
        let Some(hello) = self.hellos.newest()? else {
            return Ok(());
        };
        let wants = |hello: &PolicyHello| {
            let PolicyHello {
                arm_count,
                query_every_steps,
                history_steps,
                ..
            } = *hello;
            (arm_count, query_every_steps, history_steps)
        };
        let same = wants(&hello) == wants(&self.hello);
        if !same || hello.camera_names().as_ref() != Some(&self.cameras) {
            let who = hello.name.text();
            let reason = format!(
                "{who} (process {}) has come back as another: arms, query interval, history and cameras must be as before",
                hello.pid
            );
            return Err(SessionError::RealTime(self.failed(reason).to_string()));
        }
        self.hello = hello;
        Ok(())
    }

    pub(super) fn keep_alive(&self) -> Result<(), PolicyError> {
        let told = self.control.keep_alive();
        told.and_then(|()| self.said.keep_alive())
            .map_err(|error| self.topic(&error))
    }

    fn check_alive(&self) -> Result<(), PolicyError> {
        match self.gone() {
            Some(reason) => Err(self.failed(reason)),
            None => Ok(()),
        }
    }

    /// Why it answers no more, if its process is gone.
    pub(super) fn gone(&self) -> Option<String> {
        let PolicyHello { pid, .. } = self.hello;
        let known = pid > 0;
        (known && !self.node.is_alive(pid)).then(|| format!("{} ended", self.who()))
    }

    /// The policy by the name that it gives itself.
    pub(super) fn who(&self) -> String {
        format!("{} (process {})", self.hello.name.text(), self.hello.pid)
    }

    pub(super) fn failed(&self, reason: impl Into<String>) -> PolicyError {
        PolicyError::External {
            name: self.name.clone(),
            reason: reason.into(),
        }
    }

    fn refused(&self, reason: String) -> SessionError {
        SessionError::BadArgument(self.failed(reason).to_string())
    }

    fn topic(&self, error: &TopicError) -> PolicyError {
        self.failed(error.to_string())
    }
}

impl Drop for ExternalLink {
    fn drop(&mut self) {
        // Who no longer listens finds out by looking whether this process is there.
        let stop = RunControl::new(TimeNs(0), self.session, RunCommand::Stop);
        let _told = self.control.publish(&stop);
    }
}

/// The cameras of `hello`, which must fit what the session has.
fn checked(hello: &PolicyHello, about: &About<'_>) -> Result<Vec<String>, String> {
    let arms = about.arms as u64;
    if hello.arm_count != 0 && hello.arm_count != arms {
        return Err(format!(
            "commands {} arms, there are {arms}",
            hello.arm_count
        ));
    }
    for (what, value, least) in [
        ("query interval", hello.query_every_steps, 1),
        ("history", hello.history_steps, 0),
    ] {
        if !(least..=STEPS_MAX).contains(&value) {
            return Err(format!(
                "says a {what} of {value} steps: allowed are {least} to {STEPS_MAX}"
            ));
        }
    }
    hello
        .camera_names()
        .ok_or_else(|| format!("asks for {} cameras", hello.camera_count))
}

/// The task must have the cameras that an external policy wants.
pub(super) fn check_wanted(setup: &Setup, wanted: &[String]) -> Result<(), SessionError> {
    let available = setup.camera_names();
    match wanted.iter().find(|name| !available.contains(name)) {
        None => Ok(()),
        Some(name) => Err(SessionError::UnknownCamera {
            name: name.clone(),
            available: available.join(", "),
        }),
    }
}

/// A number that tells this session from any other that a policy may know, in its upper 32 bits.
fn fresh_session() -> Result<u64, SessionError> {
    let uuid = fs::read_to_string("/proc/sys/kernel/random/uuid")
        .map_err(|error| SessionError::RealTime(format!("naming the session failed: {error}")))?;
    let tag: String = uuid.chars().take(8).collect();
    let tag = u32::from_str_radix(&tag, 16)
        .map_err(|error| SessionError::RealTime(format!("naming the session failed: {error}")))?;
    Ok(u64::from(tag) << 32)
}

/// An external policy in lockstep: each observation is published, and time stands still until the policy has replied.
pub struct ExternalPolicy {
    link: ExternalLink,
    reports: Vec<Publisher<ArmReport>>,
    chunks: Vec<Subscriber<Chunk>>,
    /// One a camera, once its size is known.
    frames: Vec<FramePublisher>,
    episode: u64,
    /// The step that it was shown last.
    step: u64,
    /// The seed of an episode of which the policy does not know yet.
    begins: Option<u64>,
}

impl ExternalPolicy {
    /// Waits for the policy of `choice`, which commands the arms of the task of `setup` and looks through its cameras.
    ///
    /// # Errors
    /// [`SessionError::Topic`]; [`SessionError::Policy`] if it does not appear in time; [`SessionError::BadArgument`] and
    /// [`SessionError::UnknownCamera`] if it is for something else.
    pub fn connect(choice: &ExternalChoice, setup: &Setup) -> Result<Self, SessionError> {
        let arms = setup.task.arms.len();
        let about = About {
            task: &setup.task_name,
            instruction: choice.instruction_or(&setup.task_name),
            arms,
            lockstep: true,
            frames_within_ms: 0,
        };
        let link = ExternalLink::open(choice.topics(), choice.within_s, &about)?;
        check_wanted(setup, &link.cameras)?;
        let names = || ARM_NAMES.into_iter().take(arms);
        let reports = names().map(|arm| ArmStateTopic::publisher(&link.node, arm));
        let chunks = names().map(|arm| ChunkTopic::subscriber(&link.node, arm));
        Ok(Self {
            reports: reports.collect::<Result<_, _>>()?,
            chunks: chunks.collect::<Result<_, _>>()?,
            frames: Vec::new(),
            episode: link.session,
            step: 0,
            begins: Some(0),
            link,
        })
    }

    /// Names of the cameras that it looks through.
    #[must_use]
    pub fn cameras(&self) -> Vec<String> {
        self.link.cameras.clone()
    }

    /// Policy steps from one query to the next.
    #[must_use]
    pub const fn query_every_steps(&self) -> u64 {
        self.link.hello.query_every_steps
    }

    /// Shows it where an episode has ended, one step after the last that it was shown; waits for nothing.
    ///
    /// # Errors
    /// [`PolicyError::External`] if a topic fails.
    pub fn show_last(&mut self, observation: &Observation<'_>) -> Result<(), PolicyError> {
        let step = self.step + 1;
        self.publish(observation, step)
            .map_err(|error| self.link.topic(&error))
    }

    /// Tells it of an episode that has begun since, and waits until it has reset.
    fn begin(&mut self) -> Result<(), PolicyError> {
        let Some(seed) = self.begins.take() else {
            return Ok(());
        };
        self.episode += 1;
        let (episode, link) = (self.episode, &self.link);
        let control = RunControl::new(TimeNs(0), episode, RunCommand::Run { seed });
        let told = link.control.publish(&control);
        told.map_err(|error| link.topic(&error))?;
        link.wait("reset for the episode", |link| {
            let replied = link.replies.newest();
            let replied = replied.map_err(|error| link.topic(&error))?;
            if let Some(reply) = replied.filter(|reply| reply.episode == episode) {
                usable(link, &reply)?;
            }
            let status = link.status.newest();
            let status = status.map_err(|error| link.topic(&error))?;
            let reset = status.is_some_and(|status| {
                status.episode == episode && status.stage() == PolicyStage::Ready
            });
            Ok(reset.then_some(()))
        })
    }

    /// Shows it `observation` and waits for its reply.
    fn show(&mut self, observation: &Observation<'_>) -> Result<PolicyReply, PolicyError> {
        self.begin()?;
        let stamp = stamp(observation);
        let step = stamp.0 / STEP_NS;
        self.step = step;
        self.publish(observation, step)
            .map_err(|error| self.link.topic(&error))?;
        let (episode, frames, reports) = (self.episode, &self.frames, &self.reports);
        let clock = MonotonicClock::new();
        let mut alive = clock.now();
        let doing = format!("answered the observation of step {step}");
        let reply = self.link.wait(&doing, |link| {
            if clock.now().since(alive) >= ALIVE_EVERY_NS {
                alive = clock.now();
                let told = frames.iter().try_for_each(FramePublisher::keep_alive);
                let told = told.and_then(|()| reports.iter().try_for_each(Publisher::keep_alive));
                told.map_err(|error| link.topic(&error))?;
            }
            let newest = link.replies.newest();
            let newest = newest.map_err(|error| link.topic(&error))?;
            Ok(newest.filter(|reply| {
                let ended = matches!(reply.what(), Reply::Failed | Reply::Abandoned);
                reply.episode == episode && (reply.sequence == step || ended)
            }))
        })?;
        usable(&self.link, &reply)?;
        Ok(reply)
    }

    fn publish(&mut self, observation: &Observation<'_>, step: u64) -> Result<(), TopicError> {
        for frame in observation.frames.iter().skip(self.frames.len()) {
            if let Some(name) = self.link.cameras.get(self.frames.len()) {
                let pixels = frame.intrinsics.pixel_count();
                let publisher = CameraTopic::publisher(&self.link.node, name, pixels)?;
                self.frames.push(publisher);
            }
        }
        let stamp = stamp(observation);
        for (topic, frame) in self.frames.iter_mut().zip(observation.frames) {
            publish_frame(topic, frame, stamp, step)?;
        }
        for (topic, arm) in self.reports.iter().zip(observation.arms) {
            let mut report = ArmReport::new(step, &arm.state, &arm.tip_in_rcm);
            report.stamp = stamp;
            topic.publish(&report)?;
        }
        Ok(())
    }

    /// The chunk that it has published for the arm `index`, of the observation at `stamp`.
    fn chunk(&self, index: usize, stamp: TimeNs) -> Result<Chunk, PolicyError> {
        let arm = ARM_NAMES.get(index).copied().unwrap_or_default();
        let newest = match self.chunks.get(index) {
            Some(topic) => topic.newest().map_err(|error| self.link.topic(&error))?,
            None => None,
        };
        let chunk = newest.ok_or_else(|| {
            let who = self.link.who();
            self.link.failed(format!(
                "{who} says that it has answered, and there is no chunk for {arm}"
            ))
        })?;
        if chunk.observed_at != stamp {
            let who = self.link.who();
            return Err(self.link.failed(format!(
                "{who} answers with a chunk for {arm} of {} ns, the observation is of {} ns",
                chunk.observed_at.0, stamp.0
            )));
        }
        Ok(chunk)
    }
}

fn stamp(observation: &Observation<'_>) -> TimeNs {
    let first = observation.arms.first();
    first.map_or(TimeNs(0), |arm| arm.state.stamp)
}

fn publish_frame(
    topic: &mut FramePublisher,
    frame: &FrameRef<'_>,
    stamp: TimeNs,
    step: u64,
) -> Result<(), TopicError> {
    let header = FrameHeader::new(stamp, step, frame.intrinsics, &frame.camera_in_scene);
    topic.publish_with(&header, |colour, depth_m, instance| {
        colour.copy_from_slice(frame.colour);
        depth_m.copy_from_slice(frame.depth_m);
        instance.copy_from_slice(frame.instance);
    })?;
    Ok(())
}

/// A reply with which the episode goes on.
fn usable(link: &ExternalLink, reply: &PolicyReply) -> Result<(), PolicyError> {
    match reply.what() {
        Reply::Answered | Reply::Observed => Ok(()),
        Reply::Failed => {
            let text = reply.text.text();
            Err(link.failed(format!("{} failed: {text}", link.who())))
        }
        Reply::Abandoned => Err(PolicyError::Abandoned {
            name: link.name.clone(),
        }),
    }
}

impl Policy for ExternalPolicy {
    fn reset(&mut self, seed: u64) {
        self.begins = Some(seed);
    }

    fn history_steps(&self) -> u64 {
        self.link.hello.history_steps
    }

    fn observe(&mut self, observation: &Observation<'_>) -> Result<(), PolicyError> {
        self.show(observation).map(drop)
    }

    fn infer(&mut self, observation: &Observation<'_>) -> Result<Vec<Chunk>, PolicyError> {
        let reply = self.show(observation)?;
        let (said, arms) = (reply.chunk_count, observation.arms.len());
        if reply.what() != Reply::Answered || said != arms as u64 {
            let who = self.link.who();
            return Err(self.link.failed(format!(
                "{who} answers with {said} chunks for {arms} arms: expected one per arm"
            )));
        }
        let stamp = stamp(observation);
        let chunks = (0..arms).map(|index| self.chunk(index, stamp));
        let chunks: Vec<Chunk> = chunks.collect::<Result<_, _>>()?;
        let differ = |two: &[Chunk]| matches!(two, [a, b] if a.sequence != b.sequence);
        if chunks.windows(2).any(differ) {
            let who = self.link.who();
            return Err(self.link.failed(format!(
                "{who} answers with chunks of different sequence numbers for the arms"
            )));
        }
        Ok(chunks)
    }
}

#[cfg(test)]
mod tests;
