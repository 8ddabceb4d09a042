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

use std::fs;
use std::io::{BufRead as _, BufReader};
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::sync::{Arc, Mutex};
use std::thread;

use hal::{Chunk, TimeNs};
use matrix::{Taken, newest_tick, row, row_at_rest};
use performer::{Asks, CHUNK_TICKS, Manner, Performer};
use tests::{alone, child_of, json, scratch, trocar};
use trocar::rt::{MonotonicClock, sleep_ns};
use trocar::session::operator::{Ask, Command as Operator, ask};
use trocar_control::OperatorEvent;
use trocar_control::kinematics::forward;
use trocar_log::replay::replay;
use trocar_log::verify::verify;
use trocar_log::{LoggedTick, RunLog};

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

/// How far a target that ends a hold may be from the arm, mm: the gate's own limit.
const RESUME_MM: f64 = 10.0;

/// The log's ticks from the one that ends the run's hold, which began with an arm that came to
/// rest. Nothing is given to the arm that answers an observation from before the hold.
fn after_hold(log: &RunLog) -> Vec<(&LoggedTick, Option<&Chunk>)> {
    let asked = |event: OperatorEvent| {
        let mut ticks = log.ticks();
        ticks.position(|(tick, _)| tick.arms.first.operator == Some(event))
    };
    let held = asked(OperatorEvent::Pause).unwrap();
    let goes_on = asked(OperatorEvent::GoOn).unwrap();
    let (held, _) = log.ticks().nth(held).unwrap();
    let after: Vec<_> = log
        .ticks()
        .skip(goes_on)
        .map(|(tick, chunk)| (tick, chunk.first))
        .collect();
    let rests = after[0].0.arms.first.command;
    assert!(rests.velocity.amax() <= 1e-3, "{rests:?}");
    for chunk in after.iter().filter_map(|(_, chunk)| *chunk) {
        assert!(chunk.observed_at > held.now, "{chunk:?}");
    }
    after
}

/// How far the target of `chunk` that is due is from the tip that is commanded, mm.
fn away_mm(tick: &LoggedTick, chunk: &Chunk) -> f64 {
    let age = TimeNs(tick.now.since(chunk.observed_at));
    let due = usize::try_from(age.0 / chunk.step_ns).unwrap();
    let due = chunk.valid_targets().get(due).unwrap().tip_in_rcm();
    let tip = forward(&tick.arms.first.command.position);
    (due.translation.vector - tip.translation.vector).norm() * 1e3
}

/// How an arm went on after it was held: the distance of the first target that it was given to
/// where it was, mm, which the gate limits.
fn resumed_mm(log: &RunLog) -> f64 {
    let after = after_hold(log);
    let mut given = after
        .iter()
        .filter_map(|(tick, chunk)| Some((tick, (*chunk)?)));
    let (tick, chunk) = given.next().unwrap();
    let away_mm = away_mm(tick, chunk);
    assert!(away_mm <= RESUME_MM, "{away_mm}");
    let fastest = after
        .iter()
        .map(|(tick, _)| tick.arms.first.command.velocity.amax());
    assert!(fastest.fold(0.0, f64::max) > 0.01, "it moves again");
    away_mm
}

/// How far the nearest of the targets was that moved nothing after a hold, mm.
fn refused_mm(log: &RunLog) -> f64 {
    let rests = |tick: &LoggedTick| tick.arms.first.command.velocity.amax() <= 1e-3;
    let after = after_hold(log);
    let at_rest = after.iter().take_while(|(tick, _)| rests(tick));
    let given = at_rest.filter_map(|(tick, chunk)| Some(away_mm(tick, (*chunk)?)));
    let given: Vec<f64> = given.collect();
    // The last one is followed.
    let refused = given.split_last().unwrap().1;
    refused.iter().copied().fold(f64::INFINITY, f64::min)
}

/// A row of a process that was restarted: the arm, which went on from where it was, says when.
fn row_restarted(name: &str, (fault, seen): (&str, &str), log: &RunLog, injected: u64) {
    let taken = Taken::stops(log, injected);
    let (again, away_mm) = (taken.again.unwrap(), resumed_mm(log));
    let then = format!(
        "restarted; the arm goes on {again} ticks after its rest, from a target {away_mm:.1} mm away"
    );
    row(name, fault, &format!("`{}`", seen.trim()), &taken, &then);
}

/// Our own policy process is killed, and hangs: the arm holds until it is there again, and goes on
/// from where it is.
#[test]
fn dead_or_hung_policy_is_restarted_and_the_arm_goes_on() {
    let _turn = alone();
    for (signal, name, fault, seen) in [
        (
            "-KILL",
            "policy-killed",
            "policy process killed, `restarts = 2`",
            "the policy process ended: signal: 9",
        ),
        (
            "-STOP",
            "policy-hangs",
            "policy process hangs (SIGSTOP), `restarts = 2`",
            "the policy process has sent no heartbeat for ",
        ),
    ] {
        let mut run = Run::start("faults-restart", CHECKPOINT, 2, None);
        let injected = run.tick();
        send(signal, run.policy_process());
        run.stops();
        run.hears(seen);
        run.hears("the arms stop and hold; it is started again in 0.2 s (1 of 2)");
        run.until("it goes on", |seen| seen.enabled && seen.moves);
        run.hears("the policy process is ready again");
        let (log, result) = run.interrupted();
        assert_eq!(result["policy"]["restarts"], 1);
        for told in [
            seen,
            "ready again",
            "the policy answers again; its hold of the arms ends",
        ] {
            assert!(
                log.events.iter().any(|event| event.contains(told)),
                "{told}"
            );
        }
        row_restarted(name, (fault, seen), &log, injected);
    }
}

/// A restart that fails as often as is allowed ends the run with the arm at rest.
#[test]
fn the_last_restart_ends_the_run_at_rest() {
    let _turn = alone();
    let mut run = Run::start("faults-last", CHECKPOINT, 1, None);
    send("-KILL", run.policy_process());
    run.stops();
    run.until("it goes on", |seen| seen.enabled && seen.moves);
    let injected = run.tick();
    send("-KILL", run.policy_process());
    let (code, result) = run.end();
    let result = result.unwrap();
    let reason = result["reason"].as_str().unwrap();
    assert!(
        reason.starts_with("the policy process ended: signal: 9"),
        "{reason}"
    );
    assert_eq!((code, &result["policy"]["restarts"]), (Some(1), &1.into()));
    row(
        "policy-killed-last",
        "policy process killed, no restart left",
        "`the policy process ended: signal: 9`",
        &Taken::stops(&run.checked_log(), injected),
        "the run ends, exit code 1",
    );
}

/// What an external policy says wrong has no effect: the arm rests when its last good chunk ends,
/// and goes on with the next good one.
#[test]
fn bad_answers_bring_the_arm_to_rest_until_a_good_one_comes() {
    let _turn = alone();
    for (manner, name, fault) in [
        (Manner::NotFinite, "chunks-nan", "chunks with NaN"),
        (
            Manner::Replays,
            "chunks-old",
            "an old chunk again and again",
        ),
        (Manner::Slow, "chunks-late", "chunks 2.5 s late"),
    ] {
        let topics = format!("faults-{}-{manner:?}", std::process::id());
        let performer = Performer::appear(&topics);
        let mut run = Run::start("faults-bad", &format!("external:{topics}"), 0, None);
        // Some answers have been judged before.
        sleep_ns(1500 * MS_NS);
        let injected = run.tick();
        performer.behave(manner);
        run.until("it rests", |seen| !seen.moves);
        // None of them moves the arm, which is not paused.
        sleep_ns(3000 * MS_NS);
        run.until("it is seen", |seen| {
            assert!(seen.enabled && !seen.moves, "{manner:?}");
            true
        });
        performer.behave(Manner::Good);
        run.until("it goes on", |seen| seen.moves);
        let (log, result) = run.interrupted();
        assert!(
            result["policy"]["refused"].as_u64().unwrap() > 0,
            "{result}"
        );
        let taken = Taken::refuses(&log, injected, CHUNK_TICKS);
        let then = "the arm, which is not paused, goes on with the next good chunk";
        row(name, fault, "refused by the gate", &taken, then);
    }
}

/// A policy that comes back and asks for what is 30 mm away is refused by name and moves nothing,
/// until it begins where the arm is.
#[test]
fn a_policy_that_comes_back_elsewhere_is_refused() {
    let _turn = alone();
    let topics = format!("faults-{}-elsewhere", std::process::id());
    let performer = Performer::appear(&topics);
    let mut run = Run::start("faults-elsewhere", &format!("external:{topics}"), 1, None);
    let injected = run.tick();
    drop(performer);
    run.stops();
    let performer = Performer::appear(&topics);
    performer.behave(Manner::Elsewhere);
    run.until("it is no longer held", |seen| seen.enabled);
    sleep_ns(1500 * MS_NS);
    run.until("it is seen", |seen| {
        assert!(seen.enabled && !seen.moves);
        true
    });
    performer.behave(Manner::Good);
    run.until("it goes on", |seen| seen.enabled && seen.moves);
    let (log, result) = run.interrupted();
    assert!(result["policy"]["refused"].as_u64().unwrap() > 0);
    let named = "psm1: chunks are refused: they do not start where the arm was held";
    let told = log.events.iter().filter(|event| event.contains(named));
    assert_eq!(told.count(), 1, "{:?}", log.events);
    let nearest_mm = refused_mm(&log);
    assert!(nearest_mm > 1.5 * RESUME_MM, "{nearest_mm}");
    row(
        "policy-elsewhere",
        "external policy leaves, comes back and asks for what is 30 mm away, `restarts = 1`",
        "`they do not start where the arm was held`",
        &Taken::stops(&log, injected),
        "nothing moves until a chunk starts where the arm is, which is followed",
    );
}

/// An external policy that leaves may come back, and the arm goes on from where it is; without
/// restarts the run ends.
#[test]
fn an_external_policy_may_leave_and_come_back() {
    let _turn = alone();
    let topics = format!("faults-{}-leaves", std::process::id());
    for restarts in [1, 0] {
        let performer = Performer::appear(&topics);
        let mut run = Run::start(
            "faults-leaves",
            &format!("external:{topics}"),
            restarts,
            None,
        );
        let injected = run.tick();
        drop(performer);
        if restarts == 0 {
            let (code, result) = run.end();
            let result = result.unwrap();
            let reason = result["reason"].as_str().unwrap();
            assert!(
                reason.contains("ended") && reason.contains("swings"),
                "{reason}"
            );
            assert_eq!(code, Some(1));
            run.checked_log();
            continue;
        }
        run.stops();
        run.hears("it may come back within 30.0 s (1 of 1)");
        let performer = Performer::appear(&topics);
        run.until("it goes on", |seen| seen.enabled && seen.moves);
        let (log, result) = run.interrupted();
        drop(performer);
        assert_eq!(result["policy"]["restarts"], 1);
        assert_eq!(result["policy"]["refused"], 0, "{result}");
        let (taken, away_mm) = (Taken::stops(&log, injected), resumed_mm(&log));
        let again = taken.again.unwrap();
        let then = format!(
            "it comes back as another process; the arm goes on {again} ticks after its rest, from a target {away_mm:.1} mm away"
        );
        let fault = "external policy leaves, `restarts = 1`";
        row("policy-leaves", fault, "`ended`", &taken, &then);
    }
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
