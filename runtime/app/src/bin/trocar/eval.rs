//! `trocar eval`: trials in lockstep, their rate as exit code, and progress that a person or a log
//! can follow.

use std::path::PathBuf;

use clap::Args;
use indicatif::ProgressBar;

use trocar::rt;
use trocar::session::eval::{self, EvalOptions};
use trocar::session::keep::{Keep, KeepChoice};
use trocar::session::run::write_json;
use trocar::session::score::{Demand, Score};
use trocar::session::summary::TrialSummary;
use trocar::session::{Plan, SessionError};

use crate::args::{ComputeArgs, TaskParser, count, delay, share, threads};
use crate::commands::{Done, compute, note_awaited, warn_of_transfer};
use crate::console;
use crate::policy::ExternalArgs;
use crate::scene_args::{ConfigArgs, Inputs, ScenesArgs};

/// Options of `eval`.
#[derive(Args, Debug)]
pub(crate) struct EvalArgs {
    /// The task: a built-in one by name, or the path of a folder with scene.toml and safety.toml.
    #[arg(long, value_parser = TaskParser)]
    pub(crate) task: String,
    /// `expert`, `noop`, `random`, `simulated-operator`, a checkpoint's directory, or `external`: a
    /// process of yours on the topics `external`, or on others with `external:NAME`, such as one of
    /// the Python package in policy/python. With --jobs N: one a job, on `NAME-1` to `NAME-N`.
    #[arg(long)]
    pub(crate) policy: String,
    /// How an external policy is awaited.
    #[command(flatten)]
    pub(crate) external: ExternalArgs,
    /// How many trials.
    #[arg(long, default_value_t = 50, value_parser = count())]
    pub(crate) trials: usize,
    /// Seed of the first trial; trial i has seed + i, which wraps around past 2^64 - 1.
    #[arg(long, default_value_t = 1_000_000)]
    pub(crate) seed: u64,
    /// Trials at a time.
    #[arg(long, default_value_t = 1, value_parser = threads())]
    pub(crate) jobs: usize,
    /// The scenes.
    #[command(flatten)]
    pub(crate) scenes: ScenesArgs,
    /// Controller configuration and changed values.
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
    /// Write the result as JSON, also when the evaluation is interrupted, to standard output if it
    /// is `-`; parent folders are made.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
    /// Exit with 1 if the success rate is below this, 0 to 1.
    #[arg(long, value_name = "RATE", value_parser = share)]
    pub(crate) min_rate: Option<f64>,
    /// Exit with 1 if the lower end of Wilson's 95 % interval of the success rate is below this, 0
    /// to 1. With 50 of 50 it is 0.928.
    #[arg(long, value_name = "RATE", value_parser = share)]
    pub(crate) min_wilson: Option<f64>,
    /// Keep log and animation of trials, those that were lost or all, as seed-SEED.mcap and
    /// seed-SEED.gif in a new or an empty folder.
    #[arg(long, num_args = 2, value_names = ["failures|all", "DIR"])]
    pub(crate) keep: Vec<PathBuf>,
    /// Delay from observation to chunk, ms, up to 10000.
    #[arg(long, value_name = "MS", value_parser = delay())]
    pub(crate) latency_ms: Option<u64>,
    /// Uniform latency jitter, 0 to this, drawn for each chunk from the seed, ms, up to 10000.
    #[arg(long, value_name = "MS", default_value_t = 0, value_parser = delay())]
    pub(crate) latency_jitter_ms: u64,
    /// Where and how the network computes.
    #[command(flatten)]
    pub(crate) compute: ComputeArgs,
}

/// `trocar eval`. Trials run in lockstep, `--jobs` at a time, and come in the order of their seeds
/// whatever the order in which they end: of a policy in this process the result does not depend on
/// `--jobs`.
///
/// Ctrl-C abandons the trials under way: the result of those that were done is written, and the
/// exit code is 1, as it is if `--min-rate` or `--min-wilson` is not met.
pub(crate) fn eval(args: &EvalArgs) -> Done {
    let keep = keep(args)?;
    Inputs::new([
        ("--config", args.config.config.as_ref()),
        ("--scene", args.scenes.scene.scene.as_ref()),
        ("--keep", keep.as_ref().map(|keep| &keep.folder)),
    ])
    .and_tasks([&args.task])
    .and_policy(&args.policy)
    .check(&[("--json", args.json.as_deref())])?;
    let policy = args.external.policy(&args.policy)?;
    let scenes = args.scenes.options(None);
    let mut setup = args.config.setup(&args.task, &policy, &scenes)?;
    setup.task.time_limit_s *= policy.time_factor();
    warn_of_transfer(&setup);
    note_awaited(&policy, args.jobs.min(args.trials));
    let plan = Plan {
        seed: args.seed,
        latency_ms: args.latency_ms,
        latency_jitter_ms: args.latency_jitter_ms,
        compute: compute(&args.compute)?,
        ..Plan::new(setup, policy)
    };
    let options = EvalOptions {
        trials: args.trials,
        jobs: args.jobs,
        keep,
    };
    rt::catch_interrupts().map_err(SessionError::signals)?;
    let mut progress = Progress::new(args.trials);
    let summary = eval::evaluate(&plan, &options, &rt::interrupted, &mut |trial| {
        progress.trial(trial);
    })?;
    progress.bar.finish_and_clear();
    let score = summary.score();
    console::result(&format!("{}, {}: {score}", summary.task, summary.policy));
    if let Some(path) = &args.json {
        write_json(path, &summary)?;
    }
    if summary.interrupted {
        let (done, asked) = (summary.episodes.len(), summary.trials_asked);
        console::note(&format!(
            "trocar: interrupted: {done} of {asked} trials were done"
        ));
    }
    let demand = Demand {
        rate: args.min_rate,
        wilson: args.min_wilson,
    };
    let unmet = demand.unmet(score);
    if let Some(unmet) = &unmet {
        console::note(&format!("trocar: {unmet}"));
    }
    Ok(!summary.interrupted && unmet.is_none())
}

/// Which trials are to be kept, as it was typed.
///
/// # Errors
/// `BadArgument` if `--keep` is given twice, or its first word is neither `failures` nor `all`.
fn keep(args: &EvalArgs) -> Result<Option<Keep>, SessionError> {
    let (choice, folder) = match &args.keep[..] {
        [] => return Ok(None),
        [choice, folder] => (choice, folder),
        _ => {
            let reason = "--keep: given twice".to_owned();
            return Err(SessionError::BadArgument(reason));
        }
    };
    let choice = match choice.to_str() {
        Some("failures") => KeepChoice::Failures,
        Some("all") => KeepChoice::All,
        _ => {
            let reason = format!(
                "--keep {}: expected failures or all, then a folder",
                choice.display()
            );
            return Err(SessionError::BadArgument(reason));
        }
    };
    let folder = folder.clone();
    Ok(Some(Keep { choice, folder }))
}

/// Says how far an evaluation is: a bar on a terminal, elsewhere a line a trial.
struct Progress {
    bar: ProgressBar,
    /// Trials in all.
    asked: usize,
    /// How those ended that are done; invalid ones are counted apart.
    score: Score,
    done: usize,
}

impl Progress {
    fn new(asked: usize) -> Self {
        Self {
            bar: console::progress(asked as u64, "trials"),
            asked,
            score: Score::default(),
            done: 0,
        }
    }

    /// Takes in a trial that has ended. On a terminal only those that were lost are named, above
    /// the bar.
    fn trial(&mut self, trial: &TrialSummary) {
        self.done += 1;
        self.score.add(trial);
        let rate = self.score.rate();
        let TrialSummary {
            seed,
            reason,
            seconds,
            ..
        } = trial;
        if self.bar.is_hidden() {
            let (done, asked) = (self.done, self.asked);
            console::note(&format!(
                "trial {done} of {asked}, seed {seed}: {reason} after {seconds:.2} s; rate {rate:.2}"
            ));
        } else if !trial.success {
            self.bar.suspend(|| {
                console::note(&format!("seed {seed}: {reason} after {seconds:.2} s"));
            });
        }
        self.bar.set_message(format!("trials, rate {rate:.2}"));
        self.bar.inc(1);
    }
}
