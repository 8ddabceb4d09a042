//! The policy of a run in real time: known at first, with the cameras that it looks through, then
//! answering.

use std::path::Path;

use trocar_nets::loaded_policy::PolicyOutline;

use super::checkpoint_files::CheckpointFiles;
use super::child::{Outside, PolicyChild, check_cameras};
use super::remote_arms::PrintLine;
use crate::session::external::{About, ExternalLink, check_wanted};
use crate::session::plan::Arms;
use crate::session::source::{ChunkSource, STEP_NS, SizedCamera, sized_cameras};
use crate::session::teleop::Teleop;
use crate::session::{Plan, PolicyChoice, SessionError};

/// A policy that does not answer yet.
pub(super) enum Opened<'a> {
    /// A checkpoint in this folder, which will have a process of its own.
    Network(Box<PolicyOutline>, &'a Path),
    /// An external policy's process, after its handshake.
    External(Box<ExternalLink>),
    /// A policy of this process.
    Local(Box<ChunkSource>),
}

impl<'a> Opened<'a> {
    /// The policy of `plan`; an external one is waited for. With `outside`, the frames come on
    /// topics of another process, and an external policy is there too.
    pub(super) fn open<S: Arms>(
        plan: &'a Plan<S>,
        outside: Option<&Outside<'_>>,
    ) -> Result<Self, SessionError> {
        let (robot, task) = (plan.setup.robot(), plan.setup.task());
        // What other cameras than the task's own show is seen when they do.
        let drawn = task.filter(|_| plan.cameras_on.is_none());
        match &plan.policy {
            PolicyChoice::Checkpoint(folder) => {
                let outline = robot.outline(folder)?;
                drawn.map_or(Ok(()), |setup| check_cameras(setup, &outline.recipe))?;
                Ok(Self::Network(Box::new(outline), folder))
            }
            PolicyChoice::External(choice) => {
                let topics = outside.map_or(Ok(choice.topics()), |it| it.topics_of(choice))?;
                let task_name = task.map_or("", |setup| &setup.task_name);
                let about = About {
                    task: task_name,
                    instruction: choice.instruction_or(task_name),
                    arms: robot.arms(),
                    lockstep: false,
                    step_ns: STEP_NS,
                    frames_within_ms: outside.map_or(0, |outside| outside.frames_within_ms),
                };
                let link = ExternalLink::open(topics, choice.within_s, &about)?;
                drawn.map_or(Ok(()), |setup| check_wanted(setup, &link.cameras))?;
                Ok(Self::External(Box::new(link)))
            }
            PolicyChoice::Teleop => Self::by_hand(plan),
            PolicyChoice::Operator(_) => Err(SessionError::BadArgument(format!(
                "policy {}: it moves simulated arms in lockstep alone (run --lockstep, eval, record --source simulated-operator)",
                plan.policy.name()
            ))),
            PolicyChoice::Expert
            | PolicyChoice::Noop
            | PolicyChoice::Random
            | PolicyChoice::Own(_) => Ok(Self::Local(Box::new(plan.source()?))),
        }
    }

    /// An operator's hands, which the console of `plan` tells of.
    fn by_hand<S: Arms>(plan: &Plan<S>) -> Result<Self, SessionError> {
        let views = plan.setup.rcms_from_view();
        let console = plan.console.as_ref().filter(|_| !views.is_empty());
        let Some(console) = console else {
            // Which says what is missing.
            return Ok(Self::Local(Box::new(plan.source()?)));
        };
        let hands = Teleop::new(&views, console.hands(), plan.demonstrates);
        Ok(Self::Local(Box::new(ChunkSource::Teleop(Box::new(hands)))))
    }

    /// The cameras that it looks through, with their sizes in pixels if it asks for some.
    pub(super) fn cameras(&self) -> Vec<SizedCamera> {
        match self {
            Self::Network(outline, _) => sized_cameras(&outline.recipe),
            Self::External(link) => {
                let names = link.cameras.iter();
                names.map(|name| (name.clone(), None)).collect()
            }
            Self::Local(_) => Vec::new(),
        }
    }

    /// Whether it answers in another process.
    pub(super) const fn is_remote(&self) -> bool {
        !matches!(self, Self::Local(_))
    }

    /// The name of its topics, if it has some already.
    pub(super) fn topics(&self) -> Option<&str> {
        match self {
            Self::External(link) => Some(link.node.run_id()),
            Self::Network(..) | Self::Local(_) => None,
        }
    }

    /// Waits until it can answer: in another process, which finds its frames `outside`, or in this
    /// one.
    pub(super) fn start<S: Arms>(
        self,
        plan: &Plan<S>,
        outside: Outside<'_>,
        say: PrintLine<'_>,
    ) -> Result<(Option<PolicyChild>, Option<ChunkSource>), SessionError> {
        let child = match self {
            Self::Local(source) => return Ok((None, Some(*source))),
            Self::Network(outline, folder) => {
                let weights = plan.setup.robot().weights_sha256.as_deref();
                let files = CheckpointFiles::read(folder, weights)?;
                let asked = (plan.seed, plan.compute);
                PolicyChild::start(&outline, files, asked, outside, say)?
            }
            Self::External(link) => {
                let arms = plan.setup.robot().arms();
                PolicyChild::external(*link, arms, plan.seed, say)?
            }
        };
        Ok((Some(child), None))
    }
}
