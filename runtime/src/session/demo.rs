//! The demonstration: the committed policy lifts a needle through every stage, and a person can look at it.

use std::path::PathBuf;

use tch::Device;

use super::run::{RunOptions, run_lockstep, write_json};
use super::summary::RunSummary;
use super::{PolicyChoice, SessionError, Setup};

/// The committed policy.
pub const COMMITTED_POLICY: &str = "config/policies/needle-lift/act-small";

/// What to show.
#[derive(Clone, Debug)]
pub struct DemoOptions {
    /// Where the log and the pictures go.
    pub out: PathBuf,
    /// The policy; the committed one if not given.
    pub policy: Option<String>,
    /// Everything random hangs on this.
    pub seed: u64,
}

/// What was shown.
#[derive(Debug)]
pub struct DemoResult {
    /// The run's summary.
    pub summary: RunSummary,
    /// The files that were written.
    pub files: Vec<PathBuf>,
}

/// Runs the needle lift in lockstep and writes `run.mcap`, `run.json`, `strip.png` and `run.gif`.
///
/// # Errors
/// As of a run.
pub fn run(options: &DemoOptions) -> Result<DemoResult, SessionError> {
    const STEP_MS: u32 = 40;
    let policy = PolicyChoice::parse(options.policy.as_deref().unwrap_or(COMMITTED_POLICY));
    let setup = Setup::load("needle-lift", None, &policy)?;
    let file = |name: &str| options.out.join(name);
    let run_options = RunOptions {
        policy,
        seed: options.seed,
        log: Some(file("run.mcap")),
        pictures: true,
        latency_ms: None,
        device: Device::Cpu,
    };
    let result = run_lockstep(&setup, &run_options)?;
    let files = vec![
        file("run.mcap"),
        file("run.json"),
        file("strip.png"),
        file("run.gif"),
    ];
    write_json(&files[1], &result.summary)?;
    result.pictures.write_strip(&files[2], 4, 2)?;
    result.pictures.write_gif(&files[3], STEP_MS)?;
    Ok(DemoResult {
        summary: result.summary,
        files,
    })
}
