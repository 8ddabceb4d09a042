//! Faults of runs in real time, each done for real: how it is seen, when the arm rests, whether
//! limits hold, whether the run goes on.
//!
//! Each test keeps its rows of the fault matrix, with times from the log of the run:
//! `tests/scripts/fault_matrix.py` makes the table in `runtime/SAFETY.md` of them. The controller's
//! ticks from a fault's detection until the arm rests are bounded; other times are reported.
#![expect(
    clippy::unwrap_used,
    clippy::print_stdout,
    reason = "a test that fails to set up has failed; one that is skipped says so"
)]

#[path = "faults/cameras.rs"]
mod cameras;
#[path = "faults/configured.rs"]
mod configured;
#[path = "faults/held_up.rs"]
mod held_up;
#[path = "faults/kept.rs"]
mod kept;
#[path = "faults/matrix.rs"]
mod matrix;
#[path = "faults/performer.rs"]
mod performer;
#[path = "faults/policies.rs"]
mod policies;

use std::fs;
use std::io::{BufRead as _, BufReader};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;

use hal::TimeNs;
use matrix::{Taken, newest_tick, row, row_at_rest};
use performer::{Asks, Performer};
use policies::row_restarted;
use tests::{alone, child_of, json, scratch, trocar};
use trocar::rt::{MonotonicClock, sleep_ns};
use trocar::session::operator::{Ask, Command as Operator, ask};
use trocar_control::OperatorEvent;
use trocar_log::RunLog;
use trocar_log::replay::replay;
use trocar_log::verify::verify;

const CHECKPOINT: &str = "config/policies/needle-lift/act-compact";
const MS_NS: u64 = 1_000_000;
/// Anything takes less time than this, ns.
const PATIENCE_NS: u64 = 180_000 * MS_NS;

/// A run in real time whose policy may be restarted, ended with the test.
struct Run {
    process: Child,
    folder: PathBuf,
    log: PathBuf,
    said: Arc<Mutex<Vec<String>>>,
}

/// What the arm does, as an operator sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Seen {
    enabled: bool,
    faulty: bool,
    moves: bool,
}

impl Run {
    fn start(test: &str, policy: &str, restarts: u32, log: Option<&Path>) -> Self {
        Self::start_with(test, policy, restarts, log, &[])
    }

    /// With these options besides.
    fn start_with(
        test: &str,
        policy: &str,
        restarts: u32,
        log: Option<&Path>,
        more: &[&str],
    ) -> Self {
        let folder = scratch(test);
        let log = log.map_or_else(|| folder.join("run.mcap"), Path::to_path_buf);
        let mut process = trocar()
            .args(["run", "--task", "needle-lift", "--policy", policy])
            .args(["--seed", "1", "--set", "scene.episode.time_limit_s=300"])
            .args(["--set", &format!("control.policy.restarts={restarts}")])
            // A network that is started anew must not be done before it is seen to go on.
            .args(["--set", "scene.success.hold_s=10"])
            .args(["--set", "control.policy.backoff_s=0.2"])
            .args(more)
            .arg("--log")
            .arg(&log)
            .arg("--json")
            .arg(folder.join("run.json"))
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let said = Arc::new(Mutex::new(Vec::new()));
        let lines = BufReader::new(process.stderr.take().unwrap()).lines();
        let hears = Arc::clone(&said);
        thread::spawn(move || {
            for line in lines.map_while(Result::ok) {
                hears.lock().unwrap().push(line);
            }
        });
        let mut run = Self {
            process,
            folder,
            log,
            said,
        };
        run.until("the arm moves", |seen| seen.enabled && seen.moves);
        run
    }

    fn status(&self) -> Option<Seen> {
        let of = Ask {
            run: Some(self.process.id().to_string()),
            json: true,
        };
        let (answer, _) = ask(Operator::Status, &of).ok()?;
        let answer: serde_json::Value = serde_json::from_str(&answer).ok()?;
        let arm = answer["arms"].get(0)?;
        Some(Seen {
            enabled: arm["state"] == "ENABLED",
            faulty: arm["state"] == "FAULT",
            moves: arm["busy"] == true,
        })
    }

    /// Waits until an operator sees that.
    fn until(&mut self, what: &str, holds: impl Fn(Seen) -> bool) {
        let clock = MonotonicClock::new();
        while !self.status().is_some_and(&holds) {
            let ended = self.process.try_wait().unwrap();
            assert_eq!(ended, None, "waiting until {what}: {:?}", self.said());
            assert!(clock.now().0 < PATIENCE_NS, "waited in vain until {what}");
            sleep_ns(2 * MS_NS);
        }
    }

    /// Waits until an operator sees the arm paused and at rest.
    fn stops(&mut self) {
        self.until("it is paused", |seen| !seen.enabled);
        self.until("it rests", |seen| !seen.moves);
    }

    /// Its newest tick: what is done to it next is later.
    fn tick(&self) -> u64 {
        newest_tick(self.process.id())
    }

    fn said(&self) -> Vec<String> {
        self.said.lock().unwrap().clone()
    }

    fn has_said(&self, text: &str) -> bool {
        self.said().iter().any(|line| line.contains(text))
    }

    /// Waits until it has said that.
    fn hears(&self, text: &str) {
        let clock = MonotonicClock::new();
        while !self.has_said(text) {
            assert!(clock.now().0 < PATIENCE_NS, "{text}: {:?}", self.said());
            sleep_ns(2 * MS_NS);
        }
    }

    fn send(&self, signal: &str) {
        send(signal, self.process.id());
    }

    /// The process that runs the policy.
    fn policy_process(&self) -> u32 {
        child_of(self.process.id(), "policy-process").unwrap()
    }

    /// The process that draws the cameras.
    fn cameras_process(&self) -> u32 {
        child_of(self.process.id(), "cameras").unwrap()
    }

    /// The exit code and the result, if there is one.
    fn end(&mut self) -> (Option<i32>, Option<serde_json::Value>) {
        let clock = MonotonicClock::new();
        let mut code = None;
        while code.is_none() {
            code = self.process.try_wait().unwrap();
            assert!(clock.now().0 < PATIENCE_NS, "the run does not end");
            sleep_ns(5 * MS_NS);
        }
        let result = self.folder.join("run.json");
        let result = result.exists().then(|| json(&result));
        (code.and_then(|status| status.code()), result)
    }

    /// Ends the run a little later as a person would, and gives back its log, which breaks no
    /// limit.
    fn interrupted(mut self) -> (RunLog, serde_json::Value) {
        sleep_ns(1000 * MS_NS);
        self.send("-INT");
        let (code, result) = self.end();
        let result = result.unwrap();
        assert_eq!((code, &result["reason"]), (Some(1), &"interrupted".into()));
        (self.checked_log(), result)
    }

    fn checked_log(&self) -> RunLog {
        let log = RunLog::open(&self.log).unwrap();
        assert_eq!(log.cut(), None);
        let replayed = replay(&log).unwrap();
        assert!(replayed.identical, "{:?}", replayed.first_difference);
        let verified = verify(&log).unwrap();
        assert!(verified.ok, "{:?}", verified.violations);
        expect_rest(&log);
        log
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let _gone = self.process.kill();
        let _reaped = self.process.wait();
    }
}

/// The log ends with an arm at rest that has no torque; its drive lost it while it rested, unless
/// the arm holds with a fault.
fn expect_rest(log: &RunLog) {
    let (last, _) = log.ticks().last().unwrap();
    let told = last.arms.first.command;
    assert!(told.velocity.amax() <= 0.0, "{told:?}");
    let mut changes = log
        .events
        .iter()
        .filter(|event| event.contains("psm1: ") && event.contains(" to "));
    let last = changes.next_back().unwrap();
    let faulty = last.contains(" to FAULT");
    assert!(
        faulty || last.contains("psm1: PAUSED to DISABLED"),
        "{last}"
    );
    assert_eq!(told.enabled, faulty, "{told:?}");
}

fn send(signal: &str, process: u32) {
    let sent = Command::new("kill")
        .args([signal, &process.to_string()])
        .status();
    assert!(sent.unwrap().success());
}

#[test]
fn signals_bring_the_arm_to_rest() {
    let _turn = alone();
    for signal in ["-TERM", "-INT"] {
        let mut run = Run::start("faults-signal", "random", 0, None);
        let injected = run.tick();
        run.send(signal);
        let (code, result) = run.end();
        assert_eq!(
            (code, &result.unwrap()["reason"]),
            (Some(1), &"interrupted".into())
        );
        let (name, fault) = (format!("signal{signal}"), format!("SIG{}", &signal[1..]));
        let taken = Taken::stops(&run.checked_log(), injected);
        let then = "at rest its drives lose torque; the run ends, exit code 1";
        row(&name, &fault, "`interrupted`", &taken, then);
    }
}

/// A small file system of its own, unmounted with the test.
struct SmallDisk(PathBuf);

impl SmallDisk {
    /// None where this user, who is not root, may not mount one.
    fn mount() -> Option<Self> {
        let folder = scratch("faults-disk-full");
        let place = folder.to_str()?;
        let tmpfs = ["-t", "tmpfs", "-o", "size=2m", "tmpfs", place];
        granted("mount", &tmpfs).then_some(Self(folder))
    }
}

/// Whether a command that needs root succeeds; where the user is root, it does or the test fails.
fn granted(program: &str, arguments: &[&str]) -> bool {
    let output = Command::new(program).args(arguments).output();
    let done = output.as_ref().is_ok_and(|it| it.status.success());
    let root = fs::metadata("/proc/self").unwrap().uid() == 0;
    assert!(done || !root, "{program} {arguments:?}: {output:?}");
    done
}

impl Drop for SmallDisk {
    fn drop(&mut self) {
        let _gone = Command::new("umount").arg("-l").arg(&self.0).status();
    }
}

/// The disk of the log is full: the run goes on without it and says so at once and at the end.
#[test]
fn a_full_disk_costs_the_log_and_not_the_run() {
    let _turn = alone();
    let Some(disk) = SmallDisk::mount() else {
        println!("skipped: only root may mount a small file system");
        return;
    };
    let log = disk.0.join("run.mcap");
    let mut run = Run::start("faults-disk", "random", 0, Some(&log));
    run.hears("the run goes on without it");
    let detected = run.tick();
    sleep_ns(500 * MS_NS);
    run.until("it moves on", |seen| seen.enabled && seen.moves);
    run.send("-INT");
    let (code, _) = run.end();
    assert_eq!(code, Some(1), "{:?}", run.said());
    let log = RunLog::open(&run.log).unwrap();
    assert!(log.cut().is_some() && log.tick_count() > 100);
    let verified = verify(&log).unwrap();
    assert!(verified.violations.is_empty(), "{:?}", verified.violations);
    // The last tick that there was room for, until the operator's next one.
    let (last, _) = log.ticks().last().unwrap();
    row(
        "disk-full",
        "the log's disk is full",
        "`the run goes on without it`",
        &Taken::goes_on(&log, Some(detected.saturating_sub(last.tick))),
        "exit code 1 at the end",
    );
}
