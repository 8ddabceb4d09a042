//! `trocar record`: demonstrations until there are enough, or until a signal.

use std::path::PathBuf;

use clap::builder::NonEmptyStringValueParser;
use clap::{Args, ValueEnum};
use indicatif::ProgressBar;

use trocar::rt;
use trocar::session::record::{self, RecordOptions, RecordSummary};
use trocar::session::run::write_json;
use trocar::session::teleop::OperatorFigures;
use trocar::session::{Plan, PolicyChoice, SessionError, Setup};
use trocar_data::dataset::Totals;

use crate::args::{TaskParser, Video, count, share_above_0, threads};
use crate::commands::{Done, codec};
use crate::console;
use crate::page::{DeskArgs, FoxgloveArgs, PageArgs};
use crate::policy::SimulatedArgs;
use crate::scene_args::{ConfigArgs, Inputs, ScenesArgs};

/// Source of the demonstrations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub(crate) enum Demonstrator {
    /// The task's scripted expert.
    Expert,
    /// A simulated operator in lockstep: with visual delay and hand tremor, through teleoperation,
    /// as a person's do.
    SimulatedOperator,
    /// A person's hands, in real time over --console or from --hands.
    Teleop,
    /// The policy of --policy in real time, from which a person takes over where it fails, over
    /// --console or from --hands (DAgger). The dataset's column `intervention` says who drove in
    /// each frame.
    Intervention,
}

impl Demonstrator {
    /// Whether a person demonstrates, in real time.
    const fn is_a_person(self) -> bool {
        matches!(self, Self::Teleop | Self::Intervention)
    }
}

/// Options of `record`.
#[derive(Args, Debug)]
pub(crate) struct RecordArgs {
    /// The task: a built-in one by name, or the path of a folder with scene.toml and safety.toml.
    #[arg(long, value_parser = TaskParser)]
    pub(crate) task: String,
    /// How many successful episodes there shall be in the dataset.
    #[arg(long, value_parser = count())]
    pub(crate) episodes: usize,
    /// Source of the demonstrations.
    #[arg(long, value_enum, default_value = "expert")]
    pub(crate) source: Demonstrator,
    /// With --source simulated-operator: what it is like.
    #[command(flatten)]
    pub(crate) operator: SimulatedArgs,
    /// With --source intervention: the policy that drives, as `trocar run` takes it.
    #[arg(long, value_name = "POLICY")]
    pub(crate) policy: Option<String>,
    /// Where the recording is shown; with --source teleop and intervention a person starts, does,
    /// keeps and discards the episodes there.
    #[command(flatten)]
    pub(crate) page: PageArgs,
    /// Where it is shown in Foxglove.
    #[command(flatten)]
    pub(crate) viewers: FoxgloveArgs,
    /// Two eyes: a right one 5 mm beside the endoscope, which is the left one, recorded as the
    /// camera `endoscope_right` and shown in a headset. Not with --vary views.
    #[arg(long)]
    pub(crate) stereo: bool,
    /// What moves the arms besides.
    #[command(flatten)]
    pub(crate) desk: DeskArgs,
    /// The dataset's directory; a new or an empty one, but for --resume.
    #[arg(long)]
    pub(crate) out: PathBuf,
    /// Go on with the recording in the dataset's directory, until it has that many episodes in all.
    /// What it was recorded with must be given as it was, its seed too; --jobs and --episodes may
    /// be others.
    #[arg(long)]
    pub(crate) resume: bool,
    /// Keep attempts that failed too, as a dataset of their own in this directory, a new or an
    /// empty one; each one's reason is noted. Of a person's those that are discarded.
    /// Open-H-Embodiment's split `failure` is made from it: `trocar export open-h --failures`.
    #[arg(long, value_name = "DIR", conflicts_with = "resume")]
    pub(crate) failures: Option<PathBuf>,
    /// Seed of the first attempt; attempt i has seed + i, which wraps around past 2^64 - 1.
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    /// Episodes at a time. They are written in order: a recording that is cut off loses no more
    /// than these, which are in progress or wait for an earlier one.
    #[arg(long, default_value_t = 1, value_parser = threads())]
    pub(crate) jobs: usize,
    /// The scenes.
    #[command(flatten)]
    pub(crate) scenes: ScenesArgs,
    /// Disturb this share of the demonstrations, above 0, up to 1 (0.5 if no number is given):
    /// offset commands, missed grasps, slips, or the thing slides away, and the expert recovers.
    /// The recorded action is the expert's, not the disturbed one. They may take twice the task's
    /// time limit.
    #[arg(long, value_name = "SHARE", num_args = 0..=1, default_missing_value = "0.5", value_parser = share_above_0)]
    pub(crate) disturb: Option<f64>,
    /// What the demonstrations do in words, for policies that read it: the dataset's `task`, in the
    /// place of the task's name.
    #[arg(long, value_name = "TEXT", value_parser = NonEmptyStringValueParser::new())]
    pub(crate) instruction: Option<String>,
    /// Cameras whose frames are recorded: `single` (the one that the paper gives the task's
    /// policies), `multi` (that one and the wrists), or names with commas between them. A camera
    /// that is not named is not drawn.
    #[arg(long, value_name = "single|multi|NAMES", default_value = "endoscope")]
    pub(crate) cameras: String,
    /// Keep colour as video instead of as PNG: far smaller, but lossy. Needs
    /// ffmpeg 5.1 or newer, here and where the dataset is read.
    #[arg(long, value_enum, value_name = "CODEC")]
    pub(crate) video: Option<Video>,
    /// Keep depth (rounded to 0.02 mm, up to 1.31 m) and instance ids of these cameras too, which
    /// point clouds are made from.
    #[arg(long)]
    pub(crate) depth: bool,
    /// Controller configuration and changed values.
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
    /// Write what was recorded, attempt by attempt, as JSON, to standard output if it is `-`;
    /// parent folders are made.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
}

impl RecordArgs {
    /// `setup` with as many eyes as are recorded.
    fn eyes(&self, setup: Setup) -> Result<Setup, SessionError> {
        if self.stereo {
            setup.with_recorded_stereo()
        } else {
            Ok(setup)
        }
    }
}

pub(crate) fn record(args: &RecordArgs) -> Done {
    check_source(args)?;
    Inputs::new([
        ("--config", args.config.config.as_ref()),
        ("--scene", args.scenes.scene.scene.as_ref()),
        ("--out", Some(&args.out)),
        ("--failures", args.failures.as_ref()),
    ])
    .and_tasks([&args.task])
    .check(&[("--json", args.json.as_deref())])?;
    let demonstrator = demonstrator(args)?;
    let scenes = args.scenes.options(Some(&args.cameras));
    let setup = args.config.setup(&args.task, &demonstrator, &scenes)?;
    let mut setup = args.eyes(setup)?;
    setup.task.time_limit_s *= demonstrator.time_factor();
    let page = args.page.open(args.viewers.foxglove)?;
    let page = args.desk.take_hands(page)?;
    let plan = Plan {
        seed: args.seed,
        warn: console::warning,
        console: page.clone(),
        ..Plan::new(setup, demonstrator)
    };
    let options = RecordOptions {
        disturb: args.disturb,
        episodes: args.episodes,
        out: args.out.clone(),
        resume: args.resume,
        jobs: args.jobs,
        depth: args.depth,
        video: args.video.map(codec),
        instruction: args.instruction.clone(),
        failures: args.failures.clone(),
    };
    let by_hand = page.as_ref().filter(|_| args.source.is_a_person());
    if by_hand.is_none() {
        rt::catch_interrupts().map_err(SessionError::signals)?;
    }
    let bar = bar(args);
    let mut on_attempt = |attempt: &record::Attempt| {
        if attempt.kept {
            bar.inc(1);
        } else {
            bar.suspend(|| {
                console::note(&format!(
                    "seed {}: not kept: {}",
                    attempt.seed, attempt.reason
                ))
            });
        }
    };
    let summary = match by_hand {
        Some(page) => record::record_by_hand(&plan, &options, page, &mut on_attempt),
        None => record::record(&plan, &options, &rt::interrupted, &mut on_attempt),
    };
    if let Some(page) = &page {
        let said = summary.as_ref().map_or_else(ToString::to_string, said);
        page.close(None, &said);
    }
    let summary = summary?;
    bar.finish_and_clear();
    report(&summary, args);
    if let Some(path) = &args.json {
        write_json(path, &summary)?;
    }
    Ok(!summary.interrupted)
}

/// A bar of the episodes that are wanted, with those that are there.
fn bar(args: &RecordArgs) -> ProgressBar {
    let bar = console::progress(args.episodes as u64, "episodes");
    if let (true, Ok(there)) = (args.resume, Totals::read(&args.out)) {
        bar.set_position(there.episodes as u64);
        bar.reset_eta();
    }
    bar
}

/// Who moves the arms.
fn demonstrator(args: &RecordArgs) -> Result<PolicyChoice, SessionError> {
    let choice = match (args.source, &args.policy) {
        (Demonstrator::Expert, _) => PolicyChoice::Expert,
        (Demonstrator::SimulatedOperator, _) => PolicyChoice::Operator(OperatorFigures::default()),
        (Demonstrator::Intervention, Some(policy)) => PolicyChoice::parse(policy),
        (Demonstrator::Teleop, _) | (Demonstrator::Intervention, None) => PolicyChoice::Teleop,
    };
    let choice = args.operator.operated(choice)?;
    choice.check_exists()?;
    Ok(choice)
}

/// A person does one episode at a time, is not disturbed, and is seen by the console.
fn check_source(args: &RecordArgs) -> Result<(), SessionError> {
    let by_hand = args.source.is_a_person();
    let intervention = args.source == Demonstrator::Intervention;
    let at_desk = args.desk.is_given();
    let wrong = match (by_hand, args.page.console.is_some() || at_desk) {
        _ if at_desk && !by_hand => "--hands needs --source teleop or intervention",
        (true, false) => {
            "--source teleop and intervention: the operator's hands come over --console, or from --hands"
        }
        (true, true) if args.jobs > 1 => "--jobs: a person does one episode at a time",
        _ if args.disturb.is_some() && args.source != Demonstrator::Expert => {
            "--disturb needs --source expert"
        }
        _ => match args.policy.as_deref() {
            None if intervention => {
                "--source intervention needs --policy: what the person takes over from"
            }
            Some("teleop") => "--policy teleop: that is --source teleop",
            Some(_) if !intervention => "--policy needs --source intervention",
            _ => return Ok(()),
        },
    };
    Err(SessionError::BadArgument(wrong.to_owned()))
}

/// What pages are told at the end.
fn said(summary: &RecordSummary) -> String {
    format!("{} episodes are recorded", summary.episodes)
}

fn report(summary: &RecordSummary, args: &RecordArgs) {
    let (episodes, before) = (summary.episodes, summary.episodes_before);
    let out = args.out.display();
    let there = match before {
        0 => String::new(),
        _ if before >= args.episodes => "; all were there before, nothing was recorded".to_owned(),
        _ => format!("; {before} were there before"),
    };
    console::result(&format!(
        "{episodes} episodes, {} steps in {out}{there}",
        summary.steps
    ));
    if let (Some(failures), Some(dir)) = (summary.failures, &args.failures) {
        let dir = dir.display();
        console::result(&format!("{failures} attempts that failed in {dir}"));
    }
    if args.source == Demonstrator::SimulatedOperator {
        let (kept, attempts) = (episodes - before, summary.attempts.len());
        console::result(&format!("{kept} of {attempts} attempts succeeded"));
    }
    if let Some(disturbed) = &summary.disturbed {
        console::result(&format!(
            "disturbed: {} of {} kept, {} with another attempt at a grasp",
            disturbed.kept, disturbed.attempts, disturbed.retried
        ));
    }
    if summary.interrupted {
        let asked = args.episodes;
        let how = match args.failures {
            Some(_) => "--resume in place of --failures",
            None => "--resume",
        };
        console::note(&format!(
            "trocar: interrupted: {episodes} of {asked} episodes are in {out}; the same command with {how} goes on"
        ));
    }
}
