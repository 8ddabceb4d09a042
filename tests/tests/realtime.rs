//! Real-time runs: what they write replays and verifies, and whatever ends them, the arm ends at rest and nothing is left.
//!
//! Behaviour is checked here, never the clock: a busy machine makes these runs slower, not wrong.
#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::collections::BTreeSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Mutex, MutexGuard, PoisonError};

use runtime::log::RunLog;
use runtime::replay::replay;
use runtime::rt::{MonotonicClock, sleep_ns};
use runtime::verify::verify;
use tests::{Profile, json, scratch, trocar};

const CHECKPOINT: &str = "config/policies/needle-lift/act-small";

const MS_NS: u64 = 1_000_000;

/// Anything takes less time than this, ns.
const PATIENCE_NS: u64 = 180_000 * MS_NS;

/// A run wants the machine to itself: one at a time.
fn alone() -> MutexGuard<'static, ()> {
    static TURN: Mutex<()> = Mutex::new(());
    TURN.lock().unwrap_or_else(PoisonError::into_inner)
}

/// A real-time run in a process of its own, ended with the test.
struct Run {
    process: Child,
    log: PathBuf,
    result: PathBuf,
}

impl Run {
    fn start(test: &str, policy: &str, seed: u64) -> Self {
        let folder = scratch(test);
        let (log, result) = (folder.join("run.mcap"), folder.join("run.json"));
        let process = trocar(Profile::Debug)
            .args(["run", "--task", "needle-lift", "--policy", policy])
            .args(["--seed", &seed.to_string(), "--log"])
            .arg(&log)
            .arg("--json")
            .arg(&result)
            .stdout(Stdio::null())
            .spawn()
            .unwrap();
        Self {
            process,
            log,
            result,
        }
    }

    /// Waits until the arm has been following the policy for a while.
    fn wait_until_under_way(&mut self) {
        // The log is opened when everything else is ready; with its frames it grows by more than a megabyte a second.
        until("the run is under way", || {
            assert_eq!(self.process.try_wait().unwrap(), None, "ended too early");
            fs::metadata(&self.log).is_ok_and(|log| log.len() > 2_000_000)
        });
    }

    fn send(&self, signal: &str) {
        send(signal, self.process.id());
    }

    /// The process that runs the policy.
    fn policy_process(&self) -> u32 {
        let parent = self.process.id();
        let children =
            fs::read_to_string(format!("/proc/{parent}/task/{parent}/children")).unwrap();
        children.trim().parse().unwrap()
    }

    /// The exit code and the result.
    fn end(mut self) -> (Option<i32>, serde_json::Value) {
        let mut code = None;
        until("the run ends", || {
            code = self.process.try_wait().unwrap();
            code.is_some()
        });
        (code.and_then(|status| status.code()), json(&self.result))
    }
}

impl Drop for Run {
    fn drop(&mut self) {
        let _gone = self.process.kill();
        let _reaped = self.process.wait();
    }
}

fn send(signal: &str, process: u32) {
    let status = Command::new("kill")
        .args([signal, &process.to_string()])
        .status()
        .unwrap();
    assert!(status.success());
}

fn until(what: &str, mut holds: impl FnMut() -> bool) {
    let clock = MonotonicClock::new();
    while !holds() {
        assert!(clock.now().0 < PATIENCE_NS, "waited in vain until {what}");
        sleep_ns(20 * MS_NS);
    }
}

/// What the transport keeps in shared memory and in its folder for nodes and topics.
fn shared_things() -> BTreeSet<PathBuf> {
    ["/dev/shm", "/tmp/iceoryx2/nodes", "/tmp/iceoryx2/services"]
        .iter()
        .filter_map(|folder| fs::read_dir(folder).ok())
        .flatten()
        .map(|entry| entry.unwrap().path())
        // One small lock for the whole machine, made by the first process ever and kept.
        .filter(|path| !path.to_string_lossy().ends_with(".global_mgmt"))
        .collect()
}

fn expect_nothing_new(before: &BTreeSet<PathBuf>) {
    until("shared memory is clean", || {
        shared_things().difference(before).next().is_none()
    });
}

/// The log is whole, replays to the bit, breaks no limit and says `reason`; gives it back.
fn checked_log(path: &Path, result: &serde_json::Value) -> RunLog {
    let log = RunLog::open(path).unwrap();
    assert_eq!(log.cut(), None);
    let replayed = replay(&log).unwrap();
    assert!(replayed.identical, "{:?}", replayed.first_difference);
    assert_eq!(Some(replayed.ticks), result["ticks"].as_u64());
    let verified = verify(&log).unwrap();
    assert!(verified.ok, "{:?}", verified.violations);
    let outcome = log.outcome.clone().unwrap();
    assert_eq!(result["success"].as_bool(), Some(outcome.success));
    assert_eq!(result["reason"].as_str(), Some(outcome.reason.as_str()));
    assert_eq!(
        result["command_hash"].as_str(),
        Some(outcome.command_hash.as_str())
    );
    log
}

/// The arm was moved, and at the end it was held still.
fn expect_a_stop(log: &RunLog) {
    let fastest = log
        .ticks()
        .map(|(tick, _)| tick.command.velocity.amax())
        .fold(0.0, f64::max);
    assert!(fastest > 0.01, "the arm never moved: {fastest}");
    let (last, _) = log.ticks().last().unwrap();
    assert!(last.command.enabled, "the arm was let go");
    assert!(last.command.velocity.amax() <= 0.0, "{:?}", last.command);
    assert!(last.command.jaw_velocity.abs() <= 0.0, "{:?}", last.command);
}

#[test]
fn the_expert_lifts_the_needle_and_the_log_replays_and_verifies() {
    let _turn = alone();
    // A machine that is busy enough can make any one run fail, but not three.
    let lifted = (1..=3).any(|seed| {
        let run = Run::start("realtime-expert", "expert", seed);
        let path = run.log.clone();
        let (code, result) = run.end();
        let log = checked_log(&path, &result);
        assert!(result["real_time"]["wake_p99_us"].as_f64().unwrap() > 0.0);
        expect_a_stop(&log);
        let success = result["success"] == true;
        assert_eq!(code, Some(i32::from(!success)), "{result}");
        success
    });
    assert!(lifted);
}

#[test]
fn the_network_lifts_the_needle_from_its_own_process() {
    let _turn = alone();
    let before = shared_things();
    let lifted = (1..=3).any(|seed| {
        let run = Run::start("realtime-network", CHECKPOINT, seed);
        let path = run.log.clone();
        let (code, result) = run.end();
        let log = checked_log(&path, &result);
        let policy = &result["policy"];
        let chunks = log.ticks().filter(|(_, chunk)| chunk.is_some()).count();
        assert_eq!(policy["queries"].as_u64(), u64::try_from(chunks).ok());
        let inference_ms = policy["inference_ms"]["p50"].as_f64().unwrap();
        let latency_ms = policy["latency_ms"]["p50"].as_f64().unwrap();
        assert!(inference_ms > 0.0 && latency_ms > inference_ms, "{policy}");
        let success = result["success"] == true;
        assert_eq!(code, Some(i32::from(!success)), "{result}");
        success
    });
    assert!(lifted);
    expect_nothing_new(&before);
}

#[test]
fn a_policy_process_that_dies_or_hangs_ends_the_run_with_the_arm_at_rest() {
    let _turn = alone();
    let before = shared_things();
    for (signal, expected) in [
        ("-KILL", "the policy process ended: signal: 9"),
        ("-STOP", "the policy process has been silent"),
    ] {
        let mut run = Run::start("realtime-no-policy", CHECKPOINT, 1);
        let path = run.log.clone();
        run.wait_until_under_way();
        send(signal, run.policy_process());
        let (code, result) = run.end();
        assert_eq!(code, Some(1));
        let reason = result["reason"].as_str().unwrap();
        assert!(reason.starts_with(expected), "{reason}");
        expect_a_stop(&checked_log(&path, &result));
        expect_nothing_new(&before);
    }
}

#[test]
fn a_signal_is_a_controlled_stop() {
    let _turn = alone();
    let before = shared_things();
    for (signal, policy) in [("-INT", "expert"), ("-TERM", CHECKPOINT)] {
        let mut run = Run::start("realtime-signal", policy, 1);
        let path = run.log.clone();
        run.wait_until_under_way();
        run.send(signal);
        let (code, result) = run.end();
        assert_eq!(code, Some(1));
        assert_eq!(result["reason"], "interrupted");
        expect_a_stop(&checked_log(&path, &result));
        expect_nothing_new(&before);
    }
}

#[test]
fn a_policy_whose_parent_is_killed_goes_and_cleans_up_and_the_log_is_good_up_to_the_cut() {
    let _turn = alone();
    let before = shared_things();
    let mut run = Run::start("realtime-killed", CHECKPOINT, 1);
    run.wait_until_under_way();
    let policy = run.policy_process();
    run.send("-KILL");
    until("the policy process has gone", || {
        !Path::new(&format!("/proc/{policy}")).exists()
    });
    expect_nothing_new(&before);
    let log = RunLog::open(&run.log).unwrap();
    assert!(log.cut().is_some() && log.tick_count() > 100);
    let replayed = replay(&log).unwrap();
    assert!(replayed.identical, "{:?}", replayed.first_difference);
    assert!(verify(&log).unwrap().ok);
}

#[test]
fn a_bad_checkpoint_is_refused_before_anything_starts() {
    let folder = scratch("realtime-bad");
    let log = folder.join("run.mcap");
    let output = trocar(Profile::Debug)
        .args(["run", "--task", "needle-lift", "--policy"])
        .arg(&folder)
        .arg("--log")
        .arg(&log)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", tests::stderr(&output));
    assert!(!log.exists());
}
