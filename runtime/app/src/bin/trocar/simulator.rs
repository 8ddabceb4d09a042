//! The verb `simulator`.

use std::path::PathBuf;

use clap::Args;

use trocar::session::changes::Change;
use trocar::session::drives::DEFAULT_TOPICS;
use trocar::session::run::write_json;
use trocar::session::simulator::{SimulatorOptions, run_simulator};
use trocar::session::{Plan, PolicyChoice, Setup};

use crate::args::TaskParser;
use crate::commands::{Done, task_changes};
use crate::console;
use crate::page::{FoxgloveArgs, PageArgs};
use crate::scene_args::{Inputs, SceneArgs};

/// Options of `simulator`.
#[derive(Args, Debug)]
pub(crate) struct SimulatorArgs {
    /// The task whose arms and world these are: a built-in one by name, or the path of a folder.
    /// The run's must be the same.
    #[arg(long, value_parser = TaskParser, default_value = "needle-lift")]
    pub(crate) task: String,
    /// Random seed of the scene; the run's must be the same.
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    /// The scene.
    #[command(flatten)]
    pub(crate) scene: SceneArgs,
    /// Cameras whose frames are shown to other processes: `single`, `multi`, or names with commas
    /// between them; none if not given.
    #[arg(long, value_name = "single|multi|NAMES")]
    pub(crate) cameras: Option<String>,
    /// Names the topics on which the arms are commanded, and scene, verdict and frames are shown.
    #[arg(long, value_name = "NAME", default_value = DEFAULT_TOPICS)]
    pub(crate) topics: String,
    /// Override one configuration value: FILE.KEY=VALUE, where FILE is safety or scene. May be
    /// given several times.
    #[arg(long, value_name = "FILE.KEY=VALUE")]
    pub(crate) set: Vec<Change>,
    /// Where the world is shown.
    #[command(flatten)]
    pub(crate) page: PageArgs,
    /// Where it is shown in Foxglove.
    #[command(flatten)]
    pub(crate) viewers: FoxgloveArgs,
    /// Write what happened as JSON at the end, to standard output if it is `-`; parent folders are
    /// made.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
}

pub(crate) fn simulator(args: &SimulatorArgs) -> Done {
    Inputs::new([("--scene", args.scene.scene.as_ref())])
        .and_tasks([&args.task])
        .check(&[("--json", args.json.as_deref())])?;
    let scene = args.scene.options(args.cameras.as_deref());
    let changes = task_changes(&args.set)?;
    let setup = Setup::load_with(&args.task, None, &PolicyChoice::Expert, &scene, changes)?;
    let plan = Plan {
        seed: args.seed,
        warn: console::warning,
        ..Plan::new(setup, PolicyChoice::Expert)
    };
    let page = args.page.open(args.viewers.foxglove)?;
    let options = SimulatorOptions {
        topics: args.topics.clone(),
        cameras: args.cameras.is_some(),
        console: page.clone(),
    };
    let summary = run_simulator(&plan, &options, &mut |line| console::note(line));
    if let Some(page) = page {
        match &summary {
            Ok(summary) => page.close(Some(summary.success), "the simulator has ended"),
            Err(error) => page.close(Some(false), &error.to_string()),
        }
    }
    let summary = summary?;
    console::result(&format!(
        "{}: {} after {:.2} s; a period of arms and world: p50 {:.0} us, p99 {:.0} us, max {:.0} us, late for {}",
        summary.task,
        summary.outcome,
        summary.seconds,
        summary.period_us.p50,
        summary.period_us.p99,
        summary.period_us.max,
        summary.periods_late
    ));
    if let Some(path) = &args.json {
        write_json(path, &summary)?;
    }
    Ok(true)
}
