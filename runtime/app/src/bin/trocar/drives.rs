//! The verb `drives`.

use std::path::PathBuf;

use clap::Args;

use hal::config::Source;
use trocar::session::changes::{Change, Changes, ConfigFile};
use trocar::session::drives::{DEFAULT_TOPICS, DrivesOptions, InjectedFault, Moved, run_drives};
use trocar::session::run::write_json;
use trocar::session::{Plan, PolicyChoice, SessionError, Setup};
use trocar_canopen::master::CanConfig;

use crate::args::TaskParser;
use crate::commands::Done;
use crate::console;
use crate::page::{FoxgloveArgs, PageArgs};
use crate::scene_args::{Inputs, SceneArgs};

/// Options of `drives`.
#[derive(Args, Debug)]
pub(crate) struct DrivesArgs {
    /// Nodes and interfaces instead of the built-in config/can.toml.
    #[arg(long, value_name = "FILE")]
    pub(crate) config: Option<PathBuf>,
    /// The task whose arms these are, and whose world they move in: a built-in one by name, or the
    /// path of a folder.
    #[arg(long, value_parser = TaskParser, default_value = "needle-lift")]
    pub(crate) task: String,
    /// Stand in for the real drives of a robot of one arm, or of two: the motors follow their
    /// set-points, there is no task, no scene and no camera.
    #[arg(long, value_name = "ARMS", num_args = 0..=1, default_missing_value = "1", value_parser = clap::value_parser!(u8).range(1..=2))]
    #[arg(conflicts_with_all = ["task", "scene", "needle", "view", "cameras", "topics", "seed"])]
    pub(crate) no_world: Option<u8>,
    /// Random seed of the scene.
    #[arg(long, default_value_t = 0)]
    pub(crate) seed: u64,
    /// The scene.
    #[command(flatten)]
    pub(crate) scene: SceneArgs,
    /// Cameras whose frames are shown to other processes: `single`, `multi`, or names with commas
    /// between them; none if not given.
    #[arg(long, value_name = "single|multi|NAMES")]
    pub(crate) cameras: Option<String>,
    /// Names the topics on which scene, verdict and frames are shown.
    #[arg(long, value_name = "NAME", default_value = DEFAULT_TOPICS)]
    pub(crate) topics: String,
    /// Inject a fault: kind=KIND,node=N and, if wanted, at=2s (after all drives were first enabled)
    /// and for=100ms. Kinds: pull, reboot, emcy (with code=0x4310), following-error, slack,
    /// silence, late, short, garbage, no-heartbeat, wrong-identity, bus-off, foreign-master. May be
    /// given several times.
    #[arg(long, value_name = "kind=KIND,node=N,...")]
    pub(crate) fault: Vec<InjectedFault>,
    /// Override one configuration value: FILE.KEY=VALUE, where FILE is control, safety, scene or
    /// can. May be given several times.
    #[arg(long, value_name = "FILE.KEY=VALUE")]
    pub(crate) set: Vec<Change>,
    /// Where they are shown.
    #[command(flatten)]
    pub(crate) page: PageArgs,
    /// Where they are shown in Foxglove.
    #[command(flatten)]
    pub(crate) viewers: FoxgloveArgs,
    /// Write what happened as JSON at the end, to standard output if it is `-`; parent folders are
    /// made.
    #[arg(long, value_name = "FILE")]
    pub(crate) json: Option<PathBuf>,
}

/// Nodes and buses of `file`, or of the built-in configuration.
pub(crate) fn can_source(file: Option<&PathBuf>) -> Result<Source, SessionError> {
    Ok(match file {
        Some(path) => Source::read(&path.display().to_string())?,
        None => CanConfig::shipped(),
    })
}

pub(crate) fn drives(args: &DrivesArgs) -> Done {
    Inputs::new([
        ("--config", args.config.as_ref()),
        ("--scene", args.scene.scene.as_ref()),
    ])
    .and_tasks([&args.task])
    .check(&[("--json", args.json.as_deref())])?;
    let changes = Changes(args.set.clone());
    let can = changes.apply(ConfigFile::Can, can_source(args.config.as_ref())?)?;
    let can = CanConfig::load(&can)?;
    let plan;
    let moved = match args.no_world {
        Some(arms) => {
            changes.only(&[ConfigFile::Can])?;
            Moved::Arms(usize::from(arms))
        }
        None => {
            let scene = args.scene.options(args.cameras.as_deref());
            let expert = PolicyChoice::Expert;
            let setup = Setup::load_with(&args.task, None, &expert, &scene, changes)?;
            plan = Plan {
                seed: args.seed,
                ..Plan::new(setup, expert)
            };
            Moved::Task(&plan)
        }
    };
    let page = args.page.open(args.viewers.foxglove)?;
    let options = DrivesOptions {
        topics: args.topics.clone(),
        cameras: args.cameras.is_some(),
        faults: args.fault.clone(),
        console: page.clone(),
    };
    let summary = run_drives(moved, &can, &options, &mut |line| console::note(line));
    if let Some(page) = page {
        match &summary {
            Ok(summary) => page.close(summary.success, "the drives are gone"),
            Err(error) => page.close(Some(false), &error.to_string()),
        }
    }
    let summary = summary?;
    let stops = summary.stops.len();
    console::result(&format!(
        "{}: {} after {:.2} s of the drives' time; {stops} stops of drives",
        summary.task.as_deref().unwrap_or("no world"),
        summary.outcome.as_deref().unwrap_or("ended"),
        summary.seconds
    ));
    for bus in &summary.buses {
        console::result(&format!(
            "  {}: {} frames, busy {:.1} %",
            bus.interface,
            bus.frames,
            bus.busy_share * 100.0
        ));
    }
    console::result(&format!(
        "  a look at the buses and the world: p50 {:.0} us, p99 {:.0} us, max {:.0} us",
        summary.turn_us.p50, summary.turn_us.p99, summary.turn_us.max
    ));
    if summary.stalled_s > 0.0 {
        console::result(&format!(
            "  this machine kept the drives waiting for {:.3} s, which did not pass for them",
            summary.stalled_s
        ));
    }
    if let Some(path) = &args.json {
        write_json(path, &summary)?;
    }
    Ok(true)
}
