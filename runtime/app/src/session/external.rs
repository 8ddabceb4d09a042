//! A policy in another process, anybody's: it takes part over topics, in lockstep as request and
//! answer.
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
//! In real time the same topics are written and read by the threads of the run, and nobody waits
//! for a reply.

use hal::{ARM_NAMES, Chunk, FrameRef, Observation, Policy, PolicyError, TimeNs, arm_names};
use trocar_topics::{
    ArmReport, ArmStateTopic, CameraTopic, ChunkTopic, FrameHeader, FramePublisher, PolicyReply,
    PolicyStage, Publisher, Reply, RunCommand, RunControl, Subscriber, TopicError,
};

use super::steps::PolicySteps;
use super::{SessionError, Setup};
use crate::rt::MonotonicClock;

mod by_hand;
mod choice;
mod link;

pub use by_hand::{ByHand, serve_by_hand};
pub use choice::{DEFAULT_NAME, DEFAULT_WITHIN_S, ExternalChoice, INSTRUCTION_BYTES_MAX};
use link::ALIVE_EVERY_NS;
pub(super) use link::{About, ExternalLink, LOOK_NS, check_wanted};

/// An external policy in lockstep: each observation is published, and time stands still until the
/// policy has replied.
pub struct ExternalPolicy {
    link: ExternalLink,
    reports: Vec<Publisher<ArmReport>>,
    chunks: Vec<Subscriber<Chunk>>,
    /// One a camera, once its size is known.
    frames: Vec<FramePublisher>,
    episode: u64,
    steps: PolicySteps,
    /// The step that it was shown last.
    step: u64,
    /// The seed of an episode of which the policy does not know yet.
    begins: Option<u64>,
}

impl ExternalPolicy {
    /// Waits for the policy of `choice`, which commands the arms of the task of `setup`, looks
    /// through its cameras and is shown them in `steps`.
    ///
    /// # Errors
    /// [`SessionError::Topic`]; [`SessionError::Policy`] if it does not appear in time;
    /// [`SessionError::BadArgument`] and [`SessionError::UnknownCamera`] if it is for something
    /// else.
    pub fn connect(
        choice: &ExternalChoice,
        setup: &Setup,
        steps: PolicySteps,
    ) -> Result<Self, SessionError> {
        let arms = setup.task.arms.len();
        let about = About {
            task: &setup.task_name,
            instruction: choice.instruction_or(&setup.task_name),
            arms,
            lockstep: true,
            step_ns: steps.step_ns(),
            frames_within_ms: 0,
        };
        let link = ExternalLink::open(choice.topics(), choice.within_s, &about)?;
        check_wanted(setup, &link.cameras)?;
        let names = || arm_names(arms);
        let reports = names().map(|arm| ArmStateTopic::publisher(&link.node, arm));
        let chunks = names().map(|arm| ChunkTopic::subscriber(&link.node, arm));
        Ok(Self {
            reports: reports.collect::<Result<_, _>>()?,
            chunks: chunks.collect::<Result<_, _>>()?,
            frames: Vec::new(),
            episode: link.session,
            steps,
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

    /// Shows it where an episode has ended, one step after the last that it was shown; waits for
    /// nothing.
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
        let step = self.steps.nearest(stamp);
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
