//! Many seeded trials in lockstep.

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use hal::Chunk;
use trocar_nets::compute::Compute;
use trocar_tasks::cameras::SceneCameras;
use trocar_tasks::simulation::{Rendering, Simulation};
use trocar_tasks::task::Outcome;

use super::episode::{Episode, EpisodeEnd, Plan, StepView, Watcher};
use super::keep::{Keep, Keeper, Kept};
use super::latency::Latency;
use super::run::RunOptions;
use super::source::{ChunkSource, PolicyChoice};
use super::summary::{EvalSummary, TrialSummary};
use super::{SessionError, Setup, outputs, parallel};
use trocar_log::TickRecord;

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
    /// Trials whose log and pictures are kept, if any.
    pub keep: Option<Keep>,
}

/// Runs the trials; `on_trial` hears of each in order. Once `stop` says so, those in progress are abandoned, and the summary is
/// that of the ones that were done.
///
/// # Errors
/// The first error of any trial; [`SessionError::BadArgument`] if trials are to be kept in a folder that is not empty.
pub fn evaluate(
    setup: &Setup,
    options: &EvalOptions,
    stop: &(dyn Fn() -> bool + Sync),
    on_trial: &mut dyn FnMut(&TrialSummary),
) -> Result<EvalSummary, SessionError> {
    if let Some(keep) = &options.keep {
        outputs::new_folder("--keep", &keep.folder)?;
    }
    let mut episodes = Vec::new();
    let workers = AtomicUsize::new(0);
    parallel::in_order_until(
        options.trials,
        options.jobs,
        usize::MAX,
        stop,
        || {
            let index = workers.fetch_add(1, Ordering::Relaxed);
            TrialWorker::new(setup, options, stop, index).map(TrialWorker::into_job)
        },
        &mut |_, trial: Option<TrialSummary>| {
            if let Some(trial) = trial {
                on_trial(&trial);
                episodes.push(trial);
            }
            Ok(())
        },
    )?;
    let interrupted = episodes.len() < options.trials;
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
        weights_sha256: setup.weights_sha256.clone(),
        trials_asked: options.trials,
        interrupted,
        ..summary
    })
}

/// What one thread keeps from trial to trial: the network, or the connection to an external policy, and the cameras, which are slow to
/// make.
struct TrialWorker<'a> {
    setup: &'a Setup,
    options: &'a EvalOptions,
    stop: &'a (dyn Fn() -> bool + Sync),
    network: Option<ChunkSource>,
    cameras: Option<SceneCameras>,
}

impl<'a> TrialWorker<'a> {
    fn new(
        setup: &'a Setup,
        options: &'a EvalOptions,
        stop: &'a (dyn Fn() -> bool + Sync),
        index: usize,
    ) -> Result<Self, SessionError> {
        let network = match options.policy {
            PolicyChoice::Checkpoint(_) | PolicyChoice::External(_) => {
                let policy = options.policy.of_job(index, options.jobs);
                Some(setup.source(&policy, options.seed, options.compute)?)
            }
            PolicyChoice::Expert
            | PolicyChoice::Noop
            | PolicyChoice::Random
            | PolicyChoice::Own(_) => None,
        };
        Ok(Self {
            setup,
            options,
            stop,
            network,
            cameras: None,
        })
    }

    /// The job of one thread: a trial, none if it was abandoned.
    fn into_job(mut self) -> impl FnMut(usize) -> Result<Option<TrialSummary>, SessionError> {
        move |index| match self.trial(self.options.seed.wrapping_add(index as u64)) {
            Err(SessionError::Interrupted) => Ok(None),
            result => result.map(Some),
        }
    }

    fn trial(&mut self, seed: u64) -> Result<TrialSummary, SessionError> {
        let mut source = self.source(seed)?;
        let mut simulation = self.simulation(seed, &source)?;
        let mut controller = self.setup.controller()?;
        let latency = self.options.latency_ms;
        let plan = Plan {
            latency: Latency {
                ticks: latency.unwrap_or_else(|| source.latency_ticks()),
                jitter_ticks: self.options.latency_jitter_ms,
                seed,
            },
            tick_limit: self.setup.tick_limit(),
        };
        let mut watcher = TrialWatcher {
            stop: self.stop,
            keeper: self.keeper(seed)?,
        };
        let episode = Episode {
            simulation: &mut simulation,
            controller: &mut controller,
            source: &mut source,
        };
        let end = episode.run(&plan, &mut watcher)?;
        self.cameras = simulation.into_cameras();
        let kept = self.finish(seed, watcher.keeper, &end, &source)?;
        if matches!(source, ChunkSource::Policy(_)) {
            self.network = Some(source);
        }
        let name = |of: fn(&Kept) -> &PathBuf| kept.as_ref().map(|it| of(it).display().to_string());
        Ok(TrialSummary {
            seed,
            success: matches!(end.outcome, Outcome::Success),
            invalid: matches!(end.outcome, Outcome::Invalid(_)),
            reason: end.reason(),
            seconds: hal::TimeNs::from_tick(end.tally.ticks()).seconds(),
            command_hash: end.tally.command_hash(),
            tissue: end.tissue,
            log: name(|kept| &kept.log),
            pictures: name(|kept| &kept.pictures),
        })
    }

    /// The policy at the start of the trial `seed`.
    fn source(&mut self, seed: u64) -> Result<ChunkSource, SessionError> {
        if let Some(mut network) = self.network.take() {
            network.reset(seed);
            return Ok(network);
        }
        if matches!(self.options.policy, PolicyChoice::External(_)) {
            // An earlier trial of this thread has failed, which ends the evaluation; nobody is waited for again.
            return Err(SessionError::Interrupted);
        }
        self.setup
            .source(&self.options.policy, seed, self.options.compute)
    }

    fn simulation(&mut self, seed: u64, source: &ChunkSource) -> Result<Simulation, SessionError> {
        let task = &self.setup.task;
        Ok(match self.cameras.take() {
            Some(cameras) => Simulation::with_cameras(task, seed, cameras),
            None if source.cameras().is_empty() => Simulation::new(task, seed, Rendering::Off)?,
            None => Simulation::new(task, seed, Rendering::On)?,
        })
    }

    fn keeper(&self, seed: u64) -> Result<Option<Keeper<'a>>, SessionError> {
        let Some(keep) = &self.options.keep else {
            return Ok(None);
        };
        let run = RunOptions {
            policy: self.options.policy.clone(),
            seed,
            log: None,
            log_bytes_max: None,
            pictures: true,
            latency_ms: self.options.latency_ms,
            latency_jitter_ms: self.options.latency_jitter_ms,
            compute: self.options.compute,
            console: None,
            warn: |_| (),
        };
        Keeper::begin(keep, self.setup, &run).map(Some)
    }

    /// Ends what `keeper` wrote of the trial.
    fn finish(
        &mut self,
        seed: u64,
        keeper: Option<Keeper<'_>>,
        end: &EpisodeEnd,
        source: &ChunkSource,
    ) -> Result<Option<Kept>, SessionError> {
        let Some(keeper) = keeper else {
            return Ok(None);
        };
        let names = self.setup.cameras_with(source.cameras());
        keeper.finish(end, &names, &mut self.cameras, &|| {
            let mut cameras = SceneCameras::new(&self.setup.task)?;
            cameras.begin_episode(&self.setup.task, seed);
            Ok(cameras)
        })
    }
}

/// Abandons a trial when it is asked to, and keeps what is to be kept of it.
struct TrialWatcher<'a> {
    stop: &'a (dyn Fn() -> bool + Sync),
    keeper: Option<Keeper<'a>>,
}

impl Watcher for TrialWatcher<'_> {
    fn step(&mut self, view: &StepView<'_>) -> Result<(), SessionError> {
        match &mut self.keeper {
            Some(keeper) => keeper.step(view),
            None => Ok(()),
        }
    }

    fn chunk(&mut self, arm: usize, chunk: &Chunk) {
        if let Some(keeper) = &mut self.keeper {
            keeper.chunk(arm, chunk);
        }
    }

    fn tick(&mut self, record: &TickRecord) {
        if let Some(keeper) = &mut self.keeper {
            keeper.tick(record);
        }
    }

    fn wants_stop(&self) -> bool {
        (self.stop)()
    }
}
