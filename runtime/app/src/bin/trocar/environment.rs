//! `trocar environment`: a seed a line on standard input, how its episode ended as a line of JSON
//! on standard output.

use std::io::BufRead as _;

use clap::Args;

use trocar::session::environment::{EpisodeSummary, run_environment};
use trocar::session::external::ExternalChoice;
use trocar::session::steps::PolicySteps;
use trocar::session::{PolicyChoice, SessionError};

use crate::args::{TaskParser, pixels};
use crate::commands::Done;
use crate::console;
use crate::policy::ExternalArgs;
use crate::scene_args::{ConfigArgs, ScenesArgs};

/// Options of the hidden environment.
#[derive(Args, Debug)]
pub(crate) struct EnvironmentArgs {
    /// The task: a built-in one by name, or the path of a folder with scene.toml and safety.toml.
    #[arg(long, value_parser = TaskParser)]
    pub(crate) task: String,
    /// The name of the topics that the policy is on.
    #[arg(long)]
    pub(crate) topics: String,
    /// How it is awaited.
    #[command(flatten)]
    pub(crate) external: ExternalArgs,
    /// Height of all images, pixels, instead of the scene's; the vertical field of view stays.
    #[arg(long, value_name = "PIXELS", requires = "image_width", value_parser = pixels())]
    pub(crate) image_height: Option<u32>,
    /// Width of all images, pixels.
    #[arg(long, value_name = "PIXELS", requires = "image_height", value_parser = pixels())]
    pub(crate) image_width: Option<u32>,
    /// How long a step is, ns.
    #[arg(long, value_name = "NS", default_value_t = PolicySteps::USUAL.step_ns())]
    pub(crate) step_ns: u64,
    /// The scenes.
    #[command(flatten)]
    pub(crate) scenes: ScenesArgs,
    /// Controller configuration and changed values.
    #[command(flatten)]
    pub(crate) config: ConfigArgs,
}

/// What is said of an episode that the policy abandoned.
const ABANDONED: &str = "{\"abandoned\":true}\n";

pub(crate) fn environment(args: &EnvironmentArgs) -> Done {
    let choice = ExternalChoice {
        name: Some(args.topics.clone()),
        within_s: args.external.policy_timeout,
        instruction: args.external.instruction.clone(),
    };
    choice.check()?;
    let policy = PolicyChoice::External(choice.clone());
    let scenes = args.scenes.options(None);
    let mut setup = args.config.setup(&args.task, &policy, &scenes)?;
    if let (Some(height), Some(width)) = (args.image_height, args.image_width) {
        for camera in &mut setup.task.cameras {
            camera.resize(width, height);
        }
    }
    let steps = PolicySteps::of_ns(args.step_ns)?;
    let mut seeds = std::io::stdin().lock().lines().map(|line| {
        let line = line.map_err(|error| refused(&error.to_string()))?;
        let seed = line.trim().parse();
        seed.map_err(|_| refused(&format!("{line:?} is no seed: allowed are 0 to 2^64 - 1")))
    });
    run_environment(&setup, &choice, steps, &mut seeds, &mut |end| match end {
        Some(end) => console::text(&said(end)),
        None => console::text(ABANDONED),
    })?;
    Ok(true)
}

fn said(end: &EpisodeSummary) -> String {
    serde_json::to_string(end).map_or_else(|_| String::new(), |text| text + "\n")
}

fn refused(reason: &str) -> SessionError {
    SessionError::BadArgument(format!("standard input: {reason}"))
}
