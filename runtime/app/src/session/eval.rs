//! Many seeded trials in lockstep.

use std::path::PathBuf;
use std::sync::atomic::{AtomicUsize, Ordering};

use hal::Chunk;
use trocar_tasks::cameras::SceneCameras;

use super::episode::{Episode, EpisodeEnd, EpisodeObserver, StepView};
use super::keep::{Keep, Keeper, Kept};
use super::policy_choice::PolicyChoice;
use super::run::next_simulation;
use super::source::{ChunkSource, MakeSource};
use super::summary::{EvalSummary, TrialSummary};
use super::{Plan, SessionError, outputs, parallel};
use trocar_log::TickRecord;

/// How many trials, and what is kept of them.
#[derive(Clone, Debug)]
pub struct EvalOptions {
    /// How many trials; trial i has the plan's seed + i, which wraps.
    pub trials: usize,
    /// Trials at a time.
    pub jobs: usize,
    /// Trials whose log and pictures are kept, if any.
    pub keep: Option<Keep>,
}

/// Runs the trials of `plan`; `on_trial` hears of each in order. Once `stop` says so, those in
/// progress are abandoned, and the summary is that of the ones that were done.
///
/// # Errors
/// The first error of any trial; [`SessionError::BadArgument`] if trials are to be kept in a folder
/// that is not empty.
pub fn evaluate(
    plan: &Plan,
    options: &EvalOptions,
    stop: &(dyn Fn() -> bool + Sync),
    on_trial: &mut dyn FnMut(&TrialSummary),
) -> Result<EvalSummary, SessionError> {
    trials(plan, options, None, stop, on_trial)
}

/// The same with policies of the caller's; that of `plan` only names them. Jobs are threads of this
/// process: `make` makes the policy of each in its thread, which keeps it from trial to trial and
/// resets it with the seed of each.
///
/// # Errors
/// Those of [`evaluate`] and of `make`.
pub fn evaluate_with(
    plan: &Plan,
    options: &EvalOptions,
    make: MakeSource<'_>,
    stop: &(dyn Fn() -> bool + Sync),
    on_trial: &mut dyn FnMut(&TrialSummary),
) -> Result<EvalSummary, SessionError> {
    trials(plan, options, Some(make), stop, on_trial)
}

fn trials(
    plan: &Plan,
    options: &EvalOptions,
    make: Option<MakeSource<'_>>,
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
            TrialWorker::new(plan, options, (make, stop), index).map(TrialWorker::into_job)
        },
        &mut |_, trial: Option<TrialSummary>| {
            if let Some(trial) = trial {
                on_trial(&trial);
                episodes.push(trial);
            }
            Ok(())
        },
    )?;
    Ok(EvalSummary::new(plan, options.trials, episodes))
}

/// What one thread keeps from trial to trial: the network, the caller's policy or the connection to
/// an external one, and the cameras, which are slow to make.
struct TrialWorker<'a> {
    plan: &'a Plan,
    keep: Option<&'a Keep>,
    /// Makes the caller's policy, if it is one of theirs.
    make: Option<MakeSource<'a>>,
    stop: &'a (dyn Fn() -> bool + Sync),
    network: Option<ChunkSource>,
    cameras: Option<SceneCameras>,
}

impl<'a> TrialWorker<'a> {
    fn new(
        plan: &'a Plan,
        options: &'a EvalOptions,
        (make, stop): (Option<MakeSource<'a>>, &'a (dyn Fn() -> bool + Sync)),
        index: usize,
    ) -> Result<Self, SessionError> {
        let network = match plan.policy {
            PolicyChoice::Checkpoint(_) | PolicyChoice::External(_) if make.is_none() => {
                let policy = plan.policy.of_job(index, options.jobs);
                Some(plan.setup.source(&policy, plan.seed, plan.compute)?)
            }
            PolicyChoice::Expert
            | PolicyChoice::Noop
            | PolicyChoice::Random
            | PolicyChoice::Teleop
            | PolicyChoice::Operator(_)
            | PolicyChoice::Checkpoint(_)
            | PolicyChoice::Own(_)
            | PolicyChoice::External(_) => None,
        };
        Ok(Self {
            plan,
            keep: options.keep.as_ref(),
            make,
            stop,
            network,
            cameras: None,
        })
    }

    /// The job of one thread: a trial, none if it was abandoned.
    fn into_job(mut self) -> impl FnMut(usize) -> Result<Option<TrialSummary>, SessionError> {
        move |index| match self.trial(self.plan.seed.wrapping_add(index as u64)) {
            Err(SessionError::Interrupted) => Ok(None),
            result => result.map(Some),
        }
    }

    fn trial(&mut self, seed: u64) -> Result<TrialSummary, SessionError> {
        let mut source = self.source(seed)?;
        let setup = &self.plan.setup;
        let draws = !source.cameras().is_empty();
        let mut simulation = next_simulation(&setup.task, seed, self.cameras.take(), draws)?;
        let mut controller = setup.controller()?;
        let timing = self.plan.timing(seed, &source);
        let keeper = self.keep.map(|keep| Keeper::begin(keep, self.plan, seed));
        let mut watcher = TrialWatcher {
            stop: self.stop,
            keeper: keeper.transpose()?,
        };
        let episode = Episode {
            simulation: &mut simulation,
            controller: &mut controller,
            source: &mut source,
        };
        let end = episode.run(&timing, &mut watcher)?;
        self.cameras = simulation.into_cameras();
        let kept = self.finish(seed, watcher.keeper, &end, &source)?;
        if matches!(source, ChunkSource::Policy(_)) {
            self.network = Some(source);
        }
        let name = |of: fn(&Kept) -> &PathBuf| kept.as_ref().map(|it| of(it).display().to_string());
        Ok(TrialSummary {
            log: name(|kept| &kept.log),
            pictures: name(|kept| &kept.pictures),
            ..TrialSummary::new(seed, &end)
        })
    }

    /// The policy at the start of the trial `seed`.
    fn source(&mut self, seed: u64) -> Result<ChunkSource, SessionError> {
        if let Some(mut network) = self.network.take() {
            network.reset(seed);
            return Ok(network);
        }
        if let Some(make) = self.make {
            let mut source = make()?;
            source.reset(seed);
            return Ok(source);
        }
        if matches!(self.plan.policy, PolicyChoice::External(_)) {
            // An earlier trial of this thread has failed, which ends the evaluation; nobody is
            // waited for again.
            return Err(SessionError::Interrupted);
        }
        let Plan {
            setup,
            policy,
            compute,
            ..
        } = self.plan;
        setup.source(policy, seed, *compute)
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
        let setup = &self.plan.setup;
        let names = setup.cameras_with(source.cameras());
        keeper.finish(end, &names, &mut self.cameras, &|| {
            let mut cameras = SceneCameras::new(&setup.task)?;
            cameras.begin_episode(&setup.task, seed);
            Ok(cameras)
        })
    }
}

/// Abandons a trial when it is asked to, and keeps what is to be kept of it.
struct TrialWatcher<'a> {
    stop: &'a (dyn Fn() -> bool + Sync),
    keeper: Option<Keeper<'a>>,
}

impl EpisodeObserver for TrialWatcher<'_> {
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
