//! The demonstration: the committed policy of a task through every stage, and a person can look at it.

use std::path::{Path, PathBuf};

use tch::Device;

use super::pictures::STEP_MS;
use super::realtime::run_realtime;
use super::run::{RunOptions, RunResult, run_lockstep, write_json};
use super::summary::RunSummary;
use super::{PolicyChoice, SessionError, Setup, policies, tasks};
use trocar_log::RunLog;
use trocar_log::replay::{ReplayResult, replay};
use trocar_log::verify::{VerifyResult, verify};

/// The committed policy of the needle lift.
pub const COMMITTED_POLICY: &str = "config/policies/needle-lift/act-small";

/// What to show.
#[derive(Clone, Debug)]
pub struct DemoOptions {
    /// Where the logs and the pictures go.
    pub out: PathBuf,
    /// The task: a built-in one's name or the path of a folder.
    pub task: String,
    /// The policy; the committed one of the task if not given.
    pub policy: Option<String>,
    /// Everything random depends on this.
    pub seed: u64,
}

/// One run of the demonstration, its log read again.
#[derive(Debug)]
pub struct Shown {
    /// The run's summary.
    pub summary: RunSummary,
    /// Every command recomputed from the log.
    pub replayed: ReplayResult,
    /// Every command checked against the limits in the log.
    pub verified: VerifyResult,
}

/// What was shown.
#[derive(Debug)]
pub struct DemoResult {
    /// In lockstep: the same each time.
    pub lockstep: Shown,
    /// In real time, the network in its own process: as the machine allows.
    pub real_time: Shown,
    /// The files that were written.
    pub files: Vec<PathBuf>,
}

/// Runs the task in lockstep and in real time, writes both logs, the summaries, and pictures of the lockstep run.
/// `on_progress` hears what comes next.
///
/// # Errors
/// As of the runs and of reading their logs; [`SessionError::Log`] if one of them could not be written whole.
pub fn run(
    options: &DemoOptions,
    on_progress: &mut dyn FnMut(&str),
) -> Result<DemoResult, SessionError> {
    let policy = match &options.policy {
        Some(policy) => PolicyChoice::parse(policy),
        None => {
            PolicyChoice::Checkpoint(policies::recommended(&tasks::files(&options.task)?.name)?)
        }
    };
    let setup = Setup::load(&options.task, None, &policy)?;
    let file = |name: &str| options.out.join(name);
    let files: Vec<PathBuf> = [
        "run.mcap",
        "run.json",
        "strip.png",
        "run.gif",
        "realtime.mcap",
        "realtime.json",
    ]
    .map(file)
    .into();
    let run_options = |log: &Path, pictures: bool| RunOptions {
        policy: policy.clone(),
        seed: options.seed,
        log: Some(log.to_path_buf()),
        log_bytes_max: None,
        pictures,
        latency_ms: None,
        latency_jitter_ms: 0,
        compute: Device::Cpu.into(),
        console: None,
        warn: |_| (),
    };
    on_progress(&format!(
        "1 of 2: {} with {} in lockstep, as fast as it goes",
        setup.task_name,
        policy.name()
    ));
    let lockstep = run_lockstep(&setup, &run_options(&files[0], true))?;
    write_json(&files[1], &lockstep.summary)?;
    lockstep.pictures.write_strip(&files[2], 4, 2)?;
    lockstep.pictures.write_gif(&files[3], STEP_MS)?;
    on_progress("2 of 2: the same in real time, the network in its own process");
    let real_time = run_realtime(&setup, &run_options(&files[4], false))?;
    write_json(&files[5], &real_time.summary)?;
    Ok(DemoResult {
        lockstep: examine(lockstep, &files[0])?,
        real_time: examine(real_time, &files[4])?,
        files,
    })
}

/// Reads the log of a run again, recomputes its commands and checks them.
fn examine(result: RunResult, log: &Path) -> Result<Shown, SessionError> {
    if let Some(failure) = result.log_failure {
        return Err(failure.into());
    }
    let log = RunLog::open(log)?;
    Ok(Shown {
        summary: result.summary,
        replayed: replay(&log)?,
        verified: verify(&log)?,
    })
}

#[cfg(test)]
mod tests {
    use trocar_log::LogError;

    use super::*;

    #[test]
    fn a_run_whose_log_is_not_whole_is_an_error_that_says_so() {
        let mut setup = Setup::load("needle-lift", None, &PolicyChoice::Noop).unwrap();
        setup.task.time_limit_s = 0.1;
        let options = RunOptions {
            policy: PolicyChoice::Noop,
            seed: 0,
            log: None,
            log_bytes_max: None,
            pictures: false,
            latency_ms: None,
            latency_jitter_ms: 0,
            compute: Device::Cpu.into(),
            console: None,
            warn: |_| (),
        };
        let log = PathBuf::from("run.mcap");
        let failure = LogError::WriterDied { path: log.clone() };
        let told = failure.to_string();
        let result = RunResult {
            log_failure: Some(failure),
            ..run_lockstep(&setup, &options).unwrap()
        };
        let error = examine(result, &log).unwrap_err();
        assert_eq!(error.to_string(), told);
        assert!(!error.is_bad_input());
    }
}
