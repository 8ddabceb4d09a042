//! Real-time runs: what they write replays and verifies, and whatever ends them, the arm ends at
//! rest and nothing is left.
//!
//! Behaviour is checked here, never the clock: a busy machine makes these runs slower, not wrong.
//! Runs of two arms are in a file of their own.
#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

#[path = "realtime/arms_on_topics.rs"]
mod arms_on_topics;
#[path = "realtime/by_hand.rs"]
mod by_hand;
#[path = "realtime/interrupted.rs"]
mod interrupted;
#[path = "realtime/others_cameras.rs"]
mod others_cameras;
#[path = "realtime/two_arms.rs"]
mod two_arms;

use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};

use hal::TimeNs;
use tests::{alone, child_of, json, scratch, trocar};
use trocar::rt::{MonotonicClock, sleep_ns};
use trocar::session::operator::{Ask, Command as Operator, ask};
use trocar_log::replay::replay;
use trocar_log::verify::verify;
use trocar_log::{LoggedArm, RunLog};

const CHECKPOINT: &str = "config/policies/needle-lift/act-compact";

const MS_NS: u64 = 1_000_000;

/// Anything takes less time than this, ns.
const PATIENCE_NS: u64 = 180_000 * MS_NS;

/// A real-time run in a process of its own, ended with the test.
struct Run {
    process: Child,
    log: PathBuf,
    result: PathBuf,
}

impl Run {
    fn start(test: &str, policy: &str, seed: u64) -> Self {
        Self::start_task(test, "needle-lift", policy, seed)
    }

    /// A run whose task is not done before something else ends it: the needle would have to be held
    /// up for so long.
    fn unfinished(test: &str, policy: &str) -> Self {
        let hold = ["--set", "scene.success.hold_s=10"];
        Self::start_with(test, "needle-lift", policy, 1, &hold)
    }

    fn start_task(test: &str, task: &str, policy: &str, seed: u64) -> Self {
        Self::start_with(test, task, policy, seed, &[])
    }

    fn start_with(test: &str, task: &str, policy: &str, seed: u64, more: &[&str]) -> Self {
        let folder = scratch(test);
        let (log, result) = (folder.join("run.mcap"), folder.join("run.json"));
        let process = trocar()
            .args(["run", "--task", task, "--policy", policy])
            .args(more)
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

    /// Waits until the arm follows the policy.
    fn wait_until_under_way(&mut self) {
        until("the run is under way", || {
            assert_eq!(self.process.try_wait().unwrap(), None, "ended too early");
            moves(&self.log)
        });
    }

    fn send(&self, signal: &str) {
        send(signal, self.process.id());
    }

    /// The process that runs the policy, as soon as there is one.
    fn policy_process(&self) -> Option<u32> {
        child_of(self.process.id(), "policy-process")
    }

    /// The cameras' process, as soon as there is one.
    fn cameras_process(&self) -> Option<u32> {
        child_of(self.process.id(), "cameras")
    }

    /// The run's process, its policy's and its cameras', which all use shared memory.
    fn processes(&self) -> [u32; 3] {
        let (policy, cameras) = (self.policy_process(), self.cameras_process());
        let all = [self.process.id(), policy.unwrap(), cameras.unwrap()];
        for process in all {
            assert!(!shared_things(&[process]).is_empty());
        }
        all
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

/// Whether the arms have moved, as far as the log of a run that goes on says.
fn moves(log: &Path) -> bool {
    let fast = |arm: &LoggedArm| arm.command.velocity.amax() > 0.01;
    RunLog::open(log).is_ok_and(|log| log.ticks().any(|(tick, _)| tick.arms.iter().all(fast)))
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
        sleep_ns(5 * MS_NS);
    }
}

/// What the transport keeps for these processes in shared memory and in its folders for nodes and
/// topics.
fn shared_things(processes: &[u32]) -> Vec<PathBuf> {
    let folders = [
        "/dev/shm",
        "/tmp/iceoryx2",
        "/tmp/iceoryx2/nodes",
        "/tmp/iceoryx2/services",
    ];
    folders
        .iter()
        .filter_map(|folder| fs::read_dir(folder).ok())
        .flatten()
        .map(|entry| entry.unwrap().path())
        .filter(|path| processes.iter().any(|&process| belongs(path, process)))
        .collect()
}

/// Names hold the ids of nodes, ports and services; a topic's own file is named after a hash and
/// says whose run it is for.
fn belongs(path: &Path, process: u32) -> bool {
    let name = path.file_name().unwrap().to_string_lossy();
    if name.ends_with(".service") {
        let run = format!("trocar/run-{process}-");
        return fs::read_to_string(path).is_ok_and(|text| text.contains(&run));
    }
    name.split(['_', '.'])
        .any(|part| maker(part) == Some(process))
}

/// The process that made an id: 32 of its 128 bits.
fn maker(id: &str) -> Option<u32> {
    let id: u128 = id.parse().ok()?;
    u32::try_from((id >> 64) & u128::from(u32::MAX)).ok()
}

fn expect_nothing_left(processes: &[u32]) {
    until("shared memory is clean", || {
        shared_things(processes).is_empty()
    });
}

fn expect_an_end(process: u32) {
    until("the process has gone", || {
        // A dead process that nobody has waited for has no command line.
        fs::read(format!("/proc/{process}/cmdline")).map_or(true, |command| command.is_empty())
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
    assert_eq!(result["success"].as_bool(), outcome.success);
    assert_eq!(result["reason"].as_str(), Some(outcome.reason.as_str()));
    assert_eq!(
        result["command_hash"].as_str(),
        Some(outcome.command_hash.as_str())
    );
    log
}

/// Every arm was moved, and at the end it was held still.
fn expect_a_stop(log: &RunLog) {
    let (last, _) = log.ticks().last().unwrap();
    for (arm, last) in last.arms.iter().enumerate() {
        let fastest = log
            .ticks()
            .filter_map(|(tick, _)| Some(tick.arms.get(arm)?.command.velocity.amax()))
            .fold(0.0, f64::max);
        assert!(fastest > 0.01, "arm {arm} never moved: {fastest}");
        let told = last.command;
        assert!(!told.enabled, "arm {arm} has torque");
        assert!(told.velocity.amax() <= 0.0, "arm {arm}: {told:?}");
        assert!(told.jaw_velocity.abs() <= 0.0, "arm {arm}: {told:?}");
    }
}

/// How many durations the histogram of `what` holds.
fn counted(real_time: &serde_json::Value, what: &str) -> u64 {
    let histogram = &real_time["histograms"][what];
    let [ends, counts] = ["ends_us", "counts"].map(|list| histogram[list].as_array().unwrap());
    assert_eq!(ends.len(), counts.len());
    counts.iter().map(|count| count.as_u64().unwrap()).sum()
}

/// The expert lifts the needle and the log replays and verifies.
#[test]
fn expert_lifts_the_needle_and_the_log_verifies() {
    let _turn = alone();
    // A machine that is busy enough can make any one run fail, but not three.
    let lifted = (1..=3).any(|seed| {
        let run = Run::start("realtime-expert", "expert", seed);
        let path = run.log.clone();
        let (code, result) = run.end();
        let log = checked_log(&path, &result);
        let real_time = &result["real_time"];
        assert!(real_time["wake_us"]["p99"].as_f64().unwrap() > 0.0);
        let ticks = result["ticks"].as_u64().unwrap();
        assert_eq!(counted(real_time, "tick"), ticks);
        assert_eq!(counted(real_time, "wake"), counted(real_time, "period") + 1);
        assert_eq!(real_time["thread"]["allocations"], 0, "{result}");
        expect_a_stop(&log);
        let success = result["success"] == true;
        assert_eq!(code, Some(i32::from(!success)), "{result}");
        success
    });
    assert!(lifted);
}

/// A run that nobody asked to keep a log keeps it, and one that is refused leaves nothing.
#[test]
fn a_simulated_run_keeps_its_log_unasked() {
    let _turn = alone();
    let folder = scratch("realtime-unasked");
    let run = |more: &[&str]| {
        let mut run = trocar();
        run.env("XDG_STATE_HOME", &folder);
        run.args(["run", "--task", "needle-lift", "--policy", "random"]);
        run.args(["--set", "scene.episode.time_limit_s=1"]);
        let output = run.args(more).output().unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.code(), said)
    };
    let kept = folder.join("trocar/black-box/simulation.mcap");
    let (code, said) = run(&[
        "--set",
        "realtime.strict=true",
        "--set",
        "realtime.control.cpu=1000",
    ]);
    assert_eq!((code, kept.exists()), (Some(1), false), "{said}");
    assert!(!said.contains("simulation.mcap"), "{said}");
    let (code, said) = run(&["--no-log"]);
    assert_eq!((code, kept.exists()), (Some(1), false), "{said}");
    let (code, said) = run(&[]);
    assert_eq!(code, Some(1), "{said}");
    assert!(
        said.contains("simulation.mcap; --log FILE keeps all of it"),
        "{said}"
    );
    let log = RunLog::open(&kept).unwrap();
    assert!(log.cut().is_none() && log.tick_count() > 500, "{said}");
    assert!(replay(&log).unwrap().identical && verify(&log).unwrap().ok);
    // While another run has this name, a log of its own.
    let other = fs::File::open(kept.with_file_name("simulation.lock")).unwrap();
    other.lock().unwrap();
    let (before, second) = (fs::read(&kept).unwrap(), "simulation.2.mcap");
    let (code, said) = run(&[]);
    assert!(code == Some(1) && said.contains(second), "{said}");
    let log = RunLog::open(&kept.with_file_name(second)).unwrap();
    assert!(verify(&log).unwrap().ok);
    assert_eq!(fs::read(&kept).unwrap(), before);
    fs::remove_dir_all(folder).unwrap();
}

/// A run that insists on a core that is not there ends before it begins, and one that does not says
/// what it went without.
#[test]
fn only_a_strict_run_ends_where_the_system_refuses() {
    let _turn = alone();
    let run = |more: &[&str]| {
        let result = scratch("realtime-strict").join("run.json");
        let output = trocar()
            .args(["run", "--task", "needle-lift", "--policy", "noop"])
            .args(["--set", "scene.episode.time_limit_s=1"])
            .args(["--set", "realtime.control.cpu=1000"])
            .args(more)
            .arg("--json")
            .arg(&result)
            .output()
            .unwrap();
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        (output.status.code(), said, result)
    };
    let (code, said, result) = run(&["--set", "realtime.strict=true"]);
    assert_eq!(code, Some(1), "{said}");
    assert!(said.contains("core refused"), "{said}");
    assert!(!result.exists());
    let (_, said, result) = run(&[]);
    let granted = &json(&result)["real_time"]["thread"]["granted"];
    assert!(granted["cpu"]["refused"].is_string(), "{granted} {said}");
}

#[test]
fn the_network_lifts_the_needle_from_its_own_process() {
    let _turn = alone();
    let lifted = (1..=3).any(|seed| {
        let mut run = Run::start("realtime-network", CHECKPOINT, seed);
        let path = run.log.clone();
        run.wait_until_under_way();
        let processes = run.processes();
        let (code, result) = run.end();
        let log = checked_log(&path, &result);
        let policy = &result["policy"];
        let chunks = log
            .ticks()
            .filter(|(_, chunk)| chunk.first.is_some())
            .count();
        assert_eq!(policy["queries"].as_u64(), u64::try_from(chunks).ok());
        let inference_ms = policy["inference_ms"]["p50"].as_f64().unwrap();
        let latency_ms = policy["latency_ms"]["p50"].as_f64().unwrap();
        assert!(inference_ms > 0.0 && latency_ms > inference_ms, "{policy}");
        expect_nothing_left(&processes);
        let success = result["success"] == true;
        assert_eq!(code, Some(i32::from(!success)), "{result}");
        success
    });
    assert!(lifted);
}

/// A policy process that dies or hangs ends the run with the arm at rest.
#[test]
fn dead_or_hung_policy_ends_the_run_at_rest() {
    let _turn = alone();
    for (signal, expected) in [
        ("-KILL", "the policy process ended: signal: 9"),
        ("-STOP", "the policy process has sent no heartbeat"),
    ] {
        let mut run = Run::unfinished("realtime-no-policy", CHECKPOINT);
        let path = run.log.clone();
        run.wait_until_under_way();
        let processes = run.processes();
        send(signal, processes[1]);
        let (code, result) = run.end();
        assert_eq!(code, Some(1));
        let reason = result["reason"].as_str().unwrap();
        assert!(reason.starts_with(expected), "{reason}");
        expect_a_stop(&checked_log(&path, &result));
        expect_nothing_left(&processes);
    }
}

#[test]
fn a_signal_is_a_controlled_stop() {
    let _turn = alone();
    for (signal, policy) in [("-INT", "expert"), ("-TERM", CHECKPOINT)] {
        let mut run = Run::unfinished("realtime-signal", policy);
        let path = run.log.clone();
        run.wait_until_under_way();
        let processes = (policy == CHECKPOINT).then(|| run.processes());
        run.send(signal);
        let (code, result) = run.end();
        assert_eq!(code, Some(1));
        assert_eq!(result["reason"], "interrupted");
        expect_a_stop(&checked_log(&path, &result));
        // The expert thinks in the run's own process and shares nothing.
        expect_nothing_left(processes.as_ref().map_or(&[], |both| both));
    }
}

/// A policy whose parent is killed goes and cleans up and the log is good up to the cut.
#[test]
fn killed_parent_ends_the_policy_and_cuts_the_log() {
    let _turn = alone();
    let mut run = Run::unfinished("realtime-killed", CHECKPOINT);
    run.wait_until_under_way();
    let processes = run.processes();
    run.send("-KILL");
    expect_an_end(processes[1]);
    expect_nothing_left(&processes);
    let log = RunLog::open(&run.log).unwrap();
    assert!(log.cut().is_some() && log.tick_count() > 100);
    let replayed = replay(&log).unwrap();
    assert!(replayed.identical, "{:?}", replayed.first_difference);
    let verified = verify(&log).unwrap();
    let found = (verified.ok, verified.violation_count);
    assert_eq!(found, (false, 0), "what is there is good, but not whole");
}

/// A policy whose parent is killed before the run begins goes and cleans up.
#[test]
fn policy_ends_with_a_parent_killed_before_the_run() {
    let _turn = alone();
    // Before the policy process can look at anything, and while it loads.
    for joined in [false, true] {
        let run = Run::unfinished("realtime-killed-early", CHECKPOINT);
        let mut policy = None;
        until("the policy process is there", || {
            policy = run.policy_process();
            policy.is_some_and(|policy| !joined || !shared_things(&[policy]).is_empty())
        });
        let processes = [run.process.id(), policy.unwrap()];
        assert!(!shared_things(&processes[..1]).is_empty());
        run.send("-KILL");
        expect_an_end(processes[1]);
        expect_nothing_left(&processes);
        assert!(!run.log.exists());
    }
}

#[test]
fn a_delay_in_real_time_is_refused() {
    let output = trocar()
        .args(["run", "--task", "needle-lift", "--policy", "expert"])
        .args(["--latency-ms", "40"])
        .output()
        .unwrap();
    let stderr = tests::stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("--lockstep"), "{stderr}");
}

#[test]
fn a_bad_checkpoint_is_refused_before_anything_starts() {
    let folder = scratch("realtime-bad");
    let log = folder.join("run.mcap");
    let output = trocar()
        .args(["run", "--task", "needle-lift", "--policy"])
        .arg(&folder)
        .arg("--log")
        .arg(&log)
        .output()
        .unwrap();
    assert_eq!(output.status.code(), Some(2), "{}", tests::stderr(&output));
    assert!(!log.exists());
}

/// A run that is killed where nothing can be caught leaves its log up to the last moments: whoever
/// looks for what happened finds it.
#[test]
fn a_killed_run_leaves_a_log_that_can_be_read() {
    let _turn = alone();
    let mut run = Run::start("killed", "random", 5);
    let mut before = 0;
    until("two seconds are in the log", || {
        before = RunLog::open(&run.log).map_or(0, |log| log.tick_count());
        before > 2000
    });
    let of = Ask {
        run: Some(run.process.id().to_string()),
        json: true,
    };
    let (status, _) = ask(Operator::Status, &of).unwrap();
    let status: serde_json::Value = serde_json::from_str(&status).unwrap();
    run.process.kill().unwrap();
    run.process.wait().unwrap();
    let log = RunLog::open(&run.log).unwrap();
    assert!(log.cut().is_some() && log.outcome.is_none());
    assert!(log.tick_count() >= before);
    // A quarter of a second may be lost; a busy machine's writer is later.
    let (last, _) = log.ticks().last().unwrap();
    let (at_s, first) = (
        status["seconds"].as_f64().unwrap(),
        log.ticks().next().unwrap().0,
    );
    let logged_s = TimeNs(last.now.since(first.now)).seconds();
    assert!(logged_s > at_s - 1.0, "{logged_s} s of {at_s} s");
    assert!(
        log.events
            .iter()
            .any(|told| told == "psm1: DISABLED to ENABLED")
    );
    let replayed = replay(&log).unwrap();
    assert!(replayed.identical, "{:?}", replayed.first_difference);
    assert_eq!(usize::try_from(replayed.ticks).unwrap(), log.tick_count());
    let verified = verify(&log).unwrap();
    assert!(verified.violations.is_empty(), "{:?}", verified.violations);
    assert!(!verified.ok && verified.cut.is_some());
    assert!(!run.result.exists());
}
