//! What a session is made of: one plan for every verb, wherever its arms are.

use std::path::{Path, PathBuf};

use hal::{Arm as _, Pose, TimeNs};
use tch::Device;
use trocar_log::{LogError, Pressure, Recorder, RunHeader, Writing};
use trocar_nets::compute::Compute;
use trocar_tasks::simulation::{Rendering, Simulation};

use super::episode::Timing;
use super::latency::Latency;
use super::policy_choice::PolicyChoice;
use super::realtime::{CanOptions, PrintLine, TopicArms, run_on_can, run_on_topics, run_realtime};
use super::robot::warn_of_start;
use super::run::{RunResult, run_lockstep};
use super::source::ChunkSource;
use super::teleop::TeleopSummary;
use super::world_report::WorldName;
use super::{Robot, SessionError, Setup, pictures};
use crate::console::Console;
use crate::rt::RtProfile;

/// What stands where the arms of a task are.
#[derive(Clone, Debug)]
pub enum Backend {
    /// The simulation, in virtual time.
    Lockstep,
    /// The simulation, in real time.
    RealTime,
    /// Drives on CAN, whose world is in another process.
    Can(CanOptions),
    /// Arms that another process leads, with their world, over topics.
    Topics(TopicArms),
}

/// Whose arms they are: a robot's, or those of a task ([`Setup`]).
pub trait Arms {
    /// Limits and settings of the arms.
    fn robot(&self) -> &Robot;

    /// The task, if there is one.
    fn task(&self) -> Option<&Setup>;

    /// The axes in which an operator's hands move (x to the right, y up, z towards the viewer), as
    /// each arm's RCM frame has them; none if they are not known.
    fn rcms_from_view(&self) -> Vec<Pose>;

    /// What answers in this process.
    ///
    /// # Errors
    /// [`SessionError`] for a policy that can't.
    fn source(
        &self,
        choice: &PolicyChoice,
        seed: u64,
        compute: Compute,
    ) -> Result<ChunkSource, SessionError>;
}

/// Everything that decides a session. [`Plan::new`] has the rest of the fields for those that a
/// verb does not choose.
#[derive(Clone, Debug)]
pub struct Plan<S = Setup> {
    /// The arms with their limits, and the task if there is one.
    pub setup: S,
    /// The policy.
    pub policy: PolicyChoice,
    /// Everything random depends on this.
    pub seed: u64,
    /// Delay from observation to chunk in lockstep, ms; the policy's own if not given.
    pub latency_ms: Option<u64>,
    /// What may come on top of it, evenly from nothing to this, drawn for each chunk by the seed,
    /// ms.
    pub latency_jitter_ms: u64,
    /// Where and how the network computes.
    pub compute: Compute,
    /// What the threads of a run in real time ask of the operating system.
    pub real_time: RtProfile,
    /// The page that shows a run in real time, if there is one.
    pub console: Option<Console>,
    /// Whether the episode is a demonstration by hand: it waits for a person to start it, and is
    /// written down.
    pub demonstrates: bool,
    /// Where the log goes, if anywhere. It holds frames even if the policy needs none: see
    /// [`Setup::cameras_with`].
    pub log: Option<PathBuf>,
    /// Bytes that the log takes at most on its disk, if it has a bound; it keeps the last part.
    pub log_bytes_max: Option<u64>,
    /// Says, of the log's path, that it is open.
    pub log_opened: fn(&Path),
    /// The name of the topics on which others show what the cameras of simulated arms in real time
    /// see; without it Trocar draws that.
    pub cameras_on: Option<String>,
    /// Whether frames are drawn for the log that the policy does not need.
    pub log_frames: bool,
    /// Whether to keep pictures of the run for [`RunResult::pictures`].
    pub pictures: bool,
    /// Says at once what a person should know, from any thread.
    pub warn: fn(&str),
}

impl<S> Plan<S> {
    /// Seed 0, the policy's own latency, one thread of the processor; without log and pictures, and
    /// nobody is warned.
    pub fn new(setup: S, policy: PolicyChoice) -> Self {
        Self {
            setup,
            policy,
            seed: 0,
            latency_ms: None,
            latency_jitter_ms: 0,
            compute: Device::Cpu.into(),
            real_time: RtProfile::default(),
            console: None,
            demonstrates: false,
            log: None,
            log_bytes_max: None,
            log_opened: |_| (),
            cameras_on: None,
            log_frames: true,
            pictures: false,
            warn: |_| (),
        }
    }

    /// What an operator's hands did, if they are the policy, took over from it, or might have in a
    /// demonstration.
    pub(super) fn by_hand(&self) -> Option<TeleopSummary> {
        let summary = self.console.as_ref()?.hands().summary();
        let interventions = summary.interventions.as_ref();
        let took_over = interventions.is_some_and(|it| it.taken_over > 0);
        let counts = took_over || self.demonstrates || self.policy == PolicyChoice::Teleop;
        counts.then_some(summary)
    }

    /// Whether anybody but the policy wants frames.
    pub(super) const fn wants_frames(&self) -> bool {
        self.pictures || (self.log.is_some() && self.log_frames)
    }
}

impl<S: Arms> Plan<S> {
    /// The policy, if it answers in this process.
    pub(super) fn source(&self) -> Result<ChunkSource, SessionError> {
        self.setup.source(&self.policy, self.seed, self.compute)
    }

    /// Opens the log, if there is to be one: in lockstep it loses nothing, in real time it never
    /// waits.
    pub(super) fn open_log(&self, lockstep: bool) -> Result<Option<Recorder>, SessionError> {
        let Some(path) = &self.log else {
            return Ok(None);
        };
        pictures::create_parent(path)?;
        let pressure = if lockstep {
            Pressure::Block
        } else {
            Pressure::Drop
        };
        let warn = self.warn;
        let on_failure = Box::new(move |error: &LogError| {
            warn(&format!("{}; the run goes on without it", chain(error)));
        });
        let writing = Writing {
            on_failure,
            bytes_max: self.log_bytes_max,
            ..Writing::new(pressure)
        };
        let recorder = Recorder::create_with(path, &self.header(lockstep), writing)?;
        (self.log_opened)(path);
        Ok(Some(recorder))
    }

    fn header(&self, lockstep: bool) -> RunHeader {
        let (robot, task) = (self.setup.robot(), self.setup.task());
        let of_task = task.map(|setup| RunHeader {
            task: setup.task_name.clone(),
            view: setup.task.view.name().to_owned(),
            needle: setup.task.needle().map(str::to_owned),
            varied: setup
                .task
                .varied
                .iter()
                .map(|it| it.name().to_owned())
                .collect(),
            ..RunHeader::default()
        });
        RunHeader {
            policy: self.policy.name(),
            seed: self.seed,
            lockstep,
            versions: robot.versions(&self.policy),
            texts: robot.texts.by_name(),
            ..of_task.unwrap_or_default()
        }
    }
}

impl Plan {
    /// The plan for `task`, a built-in one's name or the path of a folder.
    ///
    /// # Errors
    /// Those of [`Setup::load`].
    pub fn load(task: &str, policy: PolicyChoice) -> Result<Self, SessionError> {
        Ok(Self::new(Setup::load(task, None, &policy)?, policy))
    }

    /// Runs one episode with the arms of `backend`; `say` tells what is waited for.
    ///
    /// # Errors
    /// From the configuration, the policy, the arms, the topics or the log.
    pub fn run(&self, backend: &Backend, say: PrintLine<'_>) -> Result<RunResult, SessionError> {
        match backend {
            Backend::Lockstep => run_lockstep(self),
            Backend::RealTime => run_realtime(self, say),
            Backend::Can(can) => run_on_can(self, can, say),
            Backend::Topics(arms) => run_on_topics(self, arms, say),
        }
    }

    /// The world of its episode.
    pub(super) fn world_name(&self) -> WorldName {
        WorldName {
            task: self.setup.task_name.clone(),
            scene_hash: self.setup.scene_hash(),
            seed: self.seed,
        }
    }

    /// The simulation of a run; says where its arms are beyond a boundary before they are enabled
    /// there.
    pub(super) fn simulation(&self, rendering: Rendering) -> Result<Simulation, SessionError> {
        let mut simulation = Simulation::new(&self.setup.task, self.seed, rendering)?;
        let mut states = vec![simulation.read(TimeNs(0))?];
        if let Some(mut second) = simulation.arm(1) {
            states.push(second.read(TimeNs(0))?);
        }
        warn_of_start(&self.setup.robot.control, &states, self.warn);
        Ok(simulation)
    }

    /// When the chunks of `source` arrive in lockstep in the episode of `seed`, and when it is
    /// given up.
    pub(super) fn timing(&self, seed: u64, source: &ChunkSource) -> Timing {
        Timing {
            latency: Latency {
                ticks: self.latency_ms.unwrap_or_else(|| source.latency_ticks()),
                jitter_ticks: self.latency_jitter_ms,
                seed,
            },
            tick_limit: self.setup.tick_limit(),
        }
    }
}

/// An error and what is behind it.
fn chain(error: &dyn std::error::Error) -> String {
    let causes = std::iter::successors(Some(error), |error| error.source());
    let causes: Vec<String> = causes.map(ToString::to_string).collect();
    causes.join(": ")
}
