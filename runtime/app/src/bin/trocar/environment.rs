//! `trocar environment`: a seed a line on standard input, how its episode ended as a line of JSON on standard output.

use std::io::BufRead as _;

use trocar::session::environment::{EpisodeSummary, run_environment};
use trocar::session::external::ExternalChoice;
use trocar::session::{PolicyChoice, SessionError, Setup};

use crate::args::EnvironmentArgs;
use crate::commands::{Done, task_changes};
use crate::console;

/// What is said of an episode that the policy abandoned.
const ABANDONED: &str = "{\"abandoned\":true}\n";

pub(crate) fn environment(args: &EnvironmentArgs) -> Done {
    let choice = ExternalChoice {
        name: Some(args.topics.clone()),
        within_s: args.policy_timeout,
        instruction: args.instruction.clone(),
    };
    choice.check()?;
    let policy = PolicyChoice::External(choice.clone());
    let changes = task_changes(&args.set)?;
    let scene = args.vary.add_to(args.scene.options(None));
    let config = args.config.as_deref();
    let mut setup = Setup::load_with(&args.task, config, &policy, &scene, changes)?;
    if let (Some(height), Some(width)) = (args.image_height, args.image_width) {
        for camera in &mut setup.task.cameras {
            (camera.height, camera.width) = (height, width);
        }
    }
    let mut seeds = std::io::stdin().lock().lines().map(|line| {
        let line = line.map_err(|error| refused(&error.to_string()))?;
        let seed = line.trim().parse();
        seed.map_err(|_| refused(&format!("{line:?} is no seed: allowed are 0 to 2^64 - 1")))
    });
    run_environment(&setup, &choice, &mut seeds, &mut |end| match end {
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
