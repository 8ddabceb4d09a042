//! The demonstration: the committed policy of a task through every stage, and a person can look at
//! it.

use std::path::{Path, PathBuf};

use super::pictures::STEP_MS;
use super::realtime::run_realtime;
use super::run::{RunResult, run_lockstep, write_json};
use super::summary::RunSummary;
use super::{Plan, PolicyChoice, SessionError, policies, tasks};
use trocar_log::RunLog;
use trocar_log::replay::{ReplayResult, replay};
use trocar_log::verify::{VerifyResult, verify};

/// The committed policy of the needle lift.
pub const COMMITTED_POLICY: &str = "config/policies/needle-lift/act-compact";

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

/// The plan for `task`, a built-in one's name or the path of a folder, with the committed policy of
/// the task unless another one is given.
///
/// # Errors
/// Those of [`Plan::load`]; [`SessionError::BadArgument`] if no policy is committed for the task.
pub fn plan(task: &str, policy: Option<&str>, seed: u64) -> Result<Plan, SessionError> {
    let policy = match policy {
        Some(policy) => PolicyChoice::parse(policy),
        None => PolicyChoice::Checkpoint(policies::recommended(&tasks::files(task)?.name)?),
    };
    Ok(Plan {
        seed,
        ..Plan::load(task, policy)?
    })
}

/// Runs `plan` in lockstep and in real time, writes both logs, the summaries, and pictures of the
/// lockstep run into the folder `out`. Calls `on_progress` with what comes next.
///
/// # Errors
/// As of the runs and of reading their logs; [`SessionError::Log`] if one of them could not be
/// written whole.
pub fn run(
    plan: &Plan,
    out: &Path,
    on_progress: &mut dyn FnMut(&str),
) -> Result<DemoResult, SessionError> {
    let files: Vec<PathBuf> = [
        "run.mcap",
        "run.json",
        "strip.png",
        "run.gif",
        "realtime.mcap",
        "realtime.json",
    ]
    .map(|name| out.join(name))
    .into();
    let with_log = |log: &Path, pictures: bool| Plan {
        log: Some(log.to_path_buf()),
        pictures,
        ..plan.clone()
    };
    on_progress(&format!(
        "1 of 2: {} with {} in lockstep, as fast as it goes",
        plan.setup.task_name,
        plan.policy.name()
    ));
    let lockstep = run_lockstep(&with_log(&files[0], true))?;
    write_json(&files[1], &lockstep.summary)?;
    lockstep.pictures.write_strip(&files[2], 4, 2)?;
    lockstep.pictures.write_gif(&files[3], STEP_MS)?;
    on_progress("2 of 2: the same in real time, the network in its own process");
    let real_time = run_realtime(&with_log(&files[4], false), &|_| ())?;
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
        let mut plan = Plan::load("needle-lift", PolicyChoice::Noop).unwrap();
        plan.setup.task.time_limit_s = 0.1;
        let log = PathBuf::from("run.mcap");
        let failure = LogError::WriterDied { path: log.clone() };
        let told = failure.to_string();
        let result = RunResult {
            log_failure: Some(failure),
            ..run_lockstep(&plan).unwrap()
        };
        let error = examine(result, &log).unwrap_err();
        assert_eq!(error.to_string(), told);
        assert!(!error.is_bad_input());
    }
}
