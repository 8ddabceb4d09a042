//! Episodes one after another for an external policy that steps through them, as a Gymnasium
//! environment does.
//!
//! Episodes are those of `session::episode` and the protocol on topics is that of
//! `session::external`; the program on the policy's side turns both into `reset` and `step`.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use hal::{Arm as _, CameraFrame, Chunk, FrameRef, Observation, Policy, PolicyError, TimeNs};
use serde::Serialize;
use trocar_tasks::cameras::SceneCameras;
use trocar_tasks::simulation::Simulation;
use trocar_tasks::task::{Outcome, Reason};

use super::episode::{Episode, EpisodeEnd, NoObserver, Timing};
use super::external::{ExternalChoice, ExternalPolicy};
use super::latency::Latency;
use super::run::next_simulation;
use super::source::{ChunkSource, seen_arm};
use super::steps::PolicySteps;
use super::summary::TrialSummary;
use super::{SessionError, Setup};

/// How an episode ended.
#[derive(Clone, Debug, Serialize)]
pub struct EpisodeSummary {
    /// The episode as a trial.
    ///
    /// Seed, verdict and counts, as `eval` has them.
    #[serde(flatten)]
    pub trial: TrialSummary,
    /// Whether it was the time that ran out.
    ///
    /// What Gymnasium calls truncated, apart from terminated.
    pub time_limit: bool,
}

/// Hears how an episode ended; none if it was abandoned.
pub type OnEnd<'a> = &'a mut dyn FnMut(Option<&EpisodeSummary>);

/// Runs the episodes of `seeds` in lockstep, in `steps`, with the external policy of `choice`,
/// whose chunks are there at once.
///
/// After an episode's verdict `on_end` hears of it, and then the policy is shown where it has
/// ended, one step after the last. An episode that the policy abandons is over.
///
/// `seeds` may block until the next episode is asked for; the environment ends when it ends, and an
/// `Err` of it ends it at once. The cameras are kept from episode to episode, since a renderer is
/// slow to make.
///
/// # Errors
/// From the configuration, the policy or the simulation.
pub fn run_environment(
    setup: &Setup,
    choice: &ExternalChoice,
    steps: PolicySteps,
    seeds: &mut dyn Iterator<Item = Result<u64, SessionError>>,
    on_end: OnEnd<'_>,
) -> Result<(), SessionError> {
    let policy = ExternalPolicy::connect(choice, setup, steps)?;
    let names = policy.cameras();
    let every = policy.query_every_steps();
    let shared = Shared(Arc::new(Mutex::new(policy)));
    let source = ChunkSource::policy(Box::new(shared.clone()), names.clone(), every);
    let mut source = source.in_steps(steps);
    let mut cameras: Option<SceneCameras> = None;
    for seed in seeds {
        let seed = seed?;
        source.reset(seed);
        let task = &setup.task;
        let mut simulation = next_simulation(task, seed, cameras.take(), !names.is_empty())?;
        let timing = Timing {
            latency: Latency::fixed(0),
            tick_limit: setup.tick_limit(),
        };
        let episode = Episode {
            simulation: &mut simulation,
            controller: &mut setup.controller()?,
            source: &mut source,
        };
        match episode.run(&timing, &mut NoObserver) {
            Ok(end) => {
                on_end(Some(&summary(seed, &end)));
                show_end(&shared, &mut simulation, &names, &end)?;
            }
            Err(SessionError::Policy(PolicyError::Abandoned { .. })) => on_end(None),
            Err(error) => return Err(error),
        }
        cameras = simulation.into_cameras();
    }
    Ok(())
}

/// An episode that is still running when its ticks are over counts as out of time as well.
fn summary(seed: u64, end: &EpisodeEnd) -> EpisodeSummary {
    let trial = TrialSummary::new(seed, end);
    let time_limit = matches!(
        end.outcome,
        Outcome::Running | Outcome::Failure(Reason::TimeLimit { .. })
    );
    EpisodeSummary { trial, time_limit }
}

/// Shows the policy where the episode has ended.
///
/// No query comes after the verdict, and a final observation is wanted all the same. Arms are
/// measured anew and every camera of the policy is drawn.
fn show_end(
    shared: &Shared,
    simulation: &mut Simulation,
    names: &[String],
    end: &EpisodeEnd,
) -> Result<(), SessionError> {
    let now = TimeNs::from_tick(end.tally.ticks());
    let mut arms = Vec::with_capacity(simulation.arm_count());
    for index in 0..simulation.arm_count() {
        if let Some(mut arm) = simulation.arm(index) {
            arms.push(seen_arm(&arm.read(now)?));
        }
    }
    let mut frames: Vec<CameraFrame> = Vec::with_capacity(names.len());
    if !names.is_empty() {
        let cameras = simulation.cameras()?;
        let indices: Vec<usize> = names.iter().filter_map(|name| cameras.find(name)).collect();
        for &index in &indices {
            frames.push(cameras.blank_frame(index)?);
        }
        simulation.render_all(&indices, &mut frames)?;
    }
    let frames: Vec<FrameRef<'_>> = frames.iter().map(CameraFrame::as_frame).collect();
    let observation = Observation {
        arms: &arms,
        frames: &frames,
    };
    Ok(shared.policy().show_last(&observation)?)
}

/// The policy, both where chunks come from and here.
///
/// The lock is never contended: both ends are on this thread, one after the other.
#[derive(Clone)]
struct Shared(Arc<Mutex<ExternalPolicy>>);

impl Shared {
    fn policy(&self) -> MutexGuard<'_, ExternalPolicy> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Policy for Shared {
    fn reset(&mut self, seed: u64) {
        self.policy().reset(seed);
    }

    fn history_steps(&self) -> u64 {
        self.policy().history_steps()
    }

    fn observe(&mut self, observation: &Observation<'_>) -> Result<(), PolicyError> {
        self.policy().observe(observation)
    }

    fn infer(&mut self, observation: &Observation<'_>) -> Result<Vec<Chunk>, PolicyError> {
        self.policy().infer(observation)
    }
}
