//! Many seeded trials in lockstep.

use policy::compute::Compute;
use sim_backend::cameras::SceneCameras;
use sim_backend::simulation::{Rendering, Simulation};
use sim_backend::task::Outcome;

use super::episode::{Episode, Nobody, Plan};
use super::latency::Latency;
use super::source::{ChunkSource, PolicyChoice};
use super::summary::{EvalSummary, TrialSummary};
use super::{SessionError, Setup, parallel};

/// What to evaluate.
#[derive(Clone, Debug)]
pub struct EvalOptions {
    /// The policy.
    pub policy: PolicyChoice,
    /// How many trials.
    pub trials: usize,
    /// Seed of the first trial; trial i has `seed + i`, which wraps.
    pub seed: u64,
    /// Trials at a time.
    pub jobs: usize,
    /// Delay from observation to chunk, ms; the policy's own if not given.
    pub latency_ms: Option<u64>,
    /// What may come on top of it, evenly from nothing to this, drawn for each chunk by the trial's seed, ms.
    pub latency_jitter_ms: u64,
    /// Where and how the network computes.
    pub compute: Compute,
}

/// Runs the trials; `on_trial` hears of each in order.
///
/// # Errors
/// The first error of any trial.
pub fn evaluate(
    setup: &Setup,
    options: &EvalOptions,
    on_trial: &mut dyn FnMut(&TrialSummary),
) -> Result<EvalSummary, SessionError> {
    let mut episodes = Vec::new();
    parallel::in_order(
        options.trials,
        options.jobs,
        usize::MAX,
        || TrialWorker::new(setup, options).map(TrialWorker::into_job),
        &mut |_, trial| {
            on_trial(&trial);
            episodes.push(trial);
            Ok(())
        },
    )?;
    let summary = EvalSummary::new(
        &setup.task_name,
        setup.task.needle(),
        setup.task.view.name(),
        &options.policy.name(),
        episodes,
    );
    Ok(EvalSummary {
        scene: setup.scene_file.clone(),
        needle: setup.needle().map(str::to_owned),
        varied: setup.task.varied.clone(),
        trained_on: setup.trained_on.clone(),
        ..summary
    })
}

/// What one thread keeps from trial to trial: the network and the cameras, which are slow to make.
struct TrialWorker<'a> {
    setup: &'a Setup,
    options: &'a EvalOptions,
    network: Option<ChunkSource>,
    cameras: Option<SceneCameras>,
}

impl<'a> TrialWorker<'a> {
    fn new(setup: &'a Setup, options: &'a EvalOptions) -> Result<Self, SessionError> {
        let network = match options.policy {
            PolicyChoice::Checkpoint(_) => {
                Some(setup.source(&options.policy, options.seed, options.compute)?)
            }
            PolicyChoice::Expert | PolicyChoice::Noop | PolicyChoice::Random => None,
        };
        Ok(Self {
            setup,
            options,
            network,
            cameras: None,
        })
    }

    fn into_job(mut self) -> impl FnMut(usize) -> Result<TrialSummary, SessionError> {
        move |index| self.trial(self.options.seed.wrapping_add(index as u64))
    }

    fn trial(&mut self, seed: u64) -> Result<TrialSummary, SessionError> {
        let mut source = match self.network.take() {
            Some(ChunkSource::Network(mut network)) => {
                hal::Policy::reset(network.as_mut(), seed);
                ChunkSource::Network(network)
            }
            _ => self
                .setup
                .source(&self.options.policy, seed, self.options.compute)?,
        };
        let mut simulation = match self.cameras.take() {
            Some(cameras) => Simulation::with_cameras(&self.setup.task, seed, cameras),
            None if source.cameras().is_empty() => {
                Simulation::new(&self.setup.task, seed, Rendering::Off)?
            }
            None => Simulation::new(&self.setup.task, seed, Rendering::On)?,
        };
        let mut controller = self.setup.controller()?;
        let plan = Plan {
            latency: Latency {
                ticks: self
                    .options
                    .latency_ms
                    .unwrap_or_else(|| source.latency_ticks()),
                jitter_ticks: self.options.latency_jitter_ms,
                seed,
            },
            tick_limit: self.setup.tick_limit(),
        };
        let episode = Episode {
            simulation: &mut simulation,
            controller: &mut controller,
            source: &mut source,
        };
        let end = episode.run(&plan, &mut Nobody)?;
        self.cameras = simulation.into_cameras();
        if matches!(source, ChunkSource::Network(_)) {
            self.network = Some(source);
        }
        Ok(TrialSummary {
            seed,
            success: matches!(end.outcome, Outcome::Success),
            reason: end.reason(),
            seconds: hal::TimeNs::from_tick(end.tally.ticks()).seconds(),
            command_hash: end.tally.command_hash(),
            tissue: end.tissue,
        })
    }
}
