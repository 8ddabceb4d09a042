//! The policy's own process in a real-time run: frames and the arms in, a chunk for each arm out.

use std::os::unix::process::parent_id;
use std::path::PathBuf;
use std::time::Duration;

use hal::{ARM_NAMES, Chunk, FrameRef, Observation, Policy, SeenArm, TimeNs};
use trocar_nets::compute::Compute;
use trocar_nets::loaded_policy::LoadedPolicy;
use trocar_topics::{
    ArmReport, ArmStateTopic, CameraTopic, ChunkTopic, FrameSubscriber, FrameView, PolicyStage,
    PolicyStatus, PolicyStatusTopic, Publisher, RunCommand, RunControl, RunControlTopic,
    Subscriber, TopicNode,
};

use crate::rt::{self, MonotonicClock};
use crate::session::SessionError;
use crate::session::source::{camera_names, precedes_query};

/// The arm that the topics which all arms share are named after.
pub(super) const FIRST_ARM: &str = ARM_NAMES[0];

/// The names of a run's arms, after which their topics are called.
pub(super) fn arm_names(count: usize) -> impl Iterator<Item = &'static str> {
    ARM_NAMES.into_iter().take(count)
}

/// Time between two looks at the topics, ns.
const POLL_NS: u64 = 1_000_000;

/// Silence after which a sign of life is given all the same, in looks.
const STATUS_EVERY_POLLS: u64 = 50;

/// How long a killed parent may take to be gone: with a big memory, tens of milliseconds.
const DYING_MAX: Duration = Duration::from_secs(5);

/// What the process is started with.
#[derive(Clone, Debug)]
pub struct PolicyProcessOptions {
    /// Names the run's topics.
    pub run_id: String,
    /// The checkpoint's directory.
    pub policy: PathBuf,
    /// Where and how the network computes.
    pub compute: Compute,
    /// How far a frame of any camera but the first may be from the instant of an observation, which is the first one's, ms: 0 where cameras and arms have one clock, as in a simulation.
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
    /// One an arm, as are the reports and the chunks.
    arms: Vec<Subscriber<ArmReport>>,
    chunks: Vec<Publisher<Chunk>>,
    status: Publisher<PolicyStatus>,
    cameras: Vec<FrameSubscriber>,
    network: LoadedPolicy,
    /// Policy steps from one query to the next.
    every_steps: u64,
    /// How far a frame of any camera but the first may be from the instant of an observation, ns.
    frames_within_ns: u64,
    reports: Vec<Option<ArmReport>>,
    /// The newest frame of each camera.
    views: Vec<Option<FrameView>>,
    /// The stretch of `every_steps` steps that the last answer was for.
    answered: Option<u64>,
    /// The last step that the network was shown without being asked.
    shown: Option<u64>,
    counts: Counts,
}

impl Service {
    fn open(node: &TopicNode, options: &PolicyProcessOptions) -> Result<Self, SessionError> {
        let network = LoadedPolicy::load(&options.policy, options.compute)?;
        let cameras = camera_names(&network)
            .iter()
            .map(|camera| CameraTopic::subscriber(node, camera))
            .collect::<Result<Vec<_>, _>>()?;
        let names = || arm_names(network.recipe().arms);
        let arms = names().map(|arm| ArmStateTopic::subscriber(node, arm));
        let chunks = names().map(|arm| ChunkTopic::publisher(node, arm));
        Ok(Self {
            control: RunControlTopic::subscriber(node, FIRST_ARM)?,
            arms: arms.collect::<Result<_, _>>()?,
            chunks: chunks.collect::<Result<_, _>>()?,
            status: PolicyStatusTopic::publisher(node, FIRST_ARM)?,
            every_steps: u64::from(network.recipe().query_every_steps).max(1),
            frames_within_ns: options.frames_within_ms * 1_000_000,
            reports: names().map(|_| None).collect(),
            views: cameras.iter().map(|_| None).collect(),
            answered: None,
            shown: None,
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
                    self.shown = None;
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
        for (arm, report) in self.arms.iter().zip(&mut self.reports) {
            if let Some(newest) = arm.newest()? {
                *report = Some(newest);
            }
        }
        for (camera, view) in self.cameras.iter_mut().zip(&mut self.views) {
            if let Some(newest) = camera.newest()? {
                *view = Some(newest);
            }
        }
        let Some((stamp, sequence, arms)) = of_one_instant(&self.reports) else {
            return Ok(());
        };
        let turn = sequence / self.every_steps;
        let views: Vec<&FrameView> = self
            .views
            .iter()
            .flatten()
            .enumerate()
            .filter(|(index, view)| {
                // The arms were measured when the first camera took its frame.
                let within_ns = if *index == 0 {
                    0
                } else {
                    self.frames_within_ns
                };
                view.header().stamp.0.abs_diff(stamp.0) <= within_ns
            })
            .map(|(_, view)| view)
            .collect();
        if views.len() != self.cameras.len() {
            return Ok(());
        }
        let frames: Vec<FrameRef<'_>> = views.iter().map(|view| view.as_frame()).collect();
        let observation = Observation {
            arms: &arms,
            frames: &frames,
        };
        if self.answered == Some(turn) {
            let shown = precedes_query(sequence, self.every_steps, self.network.history_steps());
            if shown && self.shown != Some(sequence) {
                self.shown = Some(sequence);
                self.network.observe(&observation)?;
            }
            return Ok(());
        }
        self.answered = Some(turn);
        let clock = MonotonicClock::new();
        let before = clock.now();
        let chunks = self.network.infer(&observation)?;
        self.counts.infer_ns = clock.now().since(before);
        self.counts.queries += 1;
        for (publisher, chunk) in self.chunks.iter().zip(&chunks) {
            publisher.publish(chunk)?;
        }
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

/// Time and sequence of the reports and the arms in them, once there is one of each arm and all are of the same instant.
fn of_one_instant(reports: &[Option<ArmReport>]) -> Option<(TimeNs, u64, Vec<SeenArm>)> {
    let first = (*reports.first()?)?;
    let mut arms = Vec::with_capacity(reports.len());
    for report in reports {
        let report = report.as_ref()?;
        if (report.stamp, report.sequence) != (first.stamp, first.sequence) {
            return None;
        }
        arms.push(SeenArm {
            state: report.state(),
            tip_in_rcm: report.tip_in_rcm(),
        });
    }
    Some((first.stamp, first.sequence, arms))
}

#[cfg(test)]
mod tests {
    use hal::{ArmState, JointVector, Pose};

    use super::*;

    #[test]
    fn arms_are_seen_together_or_not_at_all() {
        let report = |step: u64, jaw| {
            let state = ArmState::at_rest(TimeNs(step * 40), JointVector::zeros(), jaw);
            Some(ArmReport::new(step, &state, &Pose::identity()))
        };
        let seen = of_one_instant(&[report(3, 0.1), report(3, 0.2)]);
        let (stamp, sequence, arms) = seen.unwrap();
        assert_eq!((stamp, sequence), (TimeNs(120), 3));
        let jaws: Vec<f64> = arms.iter().map(|arm| arm.state.jaw_position).collect();
        assert_eq!(jaws, [0.1, 0.2]);
        // The second arm's report is still that of the step before, or not there at all.
        assert!(of_one_instant(&[report(3, 0.1), report(2, 0.2)]).is_none());
        assert!(of_one_instant(&[report(3, 0.1), None]).is_none());
        assert!(of_one_instant(&[None, report(3, 0.1)]).is_none());
        assert!(of_one_instant(&[]).is_none());
    }
}
