//! Runs that are interrupted again and again: until the arm rests a second signal does no more than
//! the first, and a third one ends the run at once; after that the second one does.

use std::os::unix::process::ExitStatusExt as _;
use std::path::Path;
use std::process::{Child, Command, Stdio};

use tests::{alone, scratch, trocar};
use trocar::rt::{interrupt_process, sleep_ns};
use trocar_log::RunLog;

/// Waits until the log at `path` of the run `child` says that.
fn wait_for(path: &Path, child: &mut Child, says: impl Fn(RunLog) -> bool) {
    while !RunLog::open(path).is_ok_and(&says) {
        assert_eq!(child.try_wait().unwrap(), None, "it ended too early");
        sleep_ns(50_000_000);
    }
}

/// A run whose arm is enabled, as its log says.
fn enabled(run: &[&str], log: &Path, result: &Path) -> Child {
    let mut command = trocar();
    command.args(run).arg("--log").arg(log);
    command.arg("--json").arg(result).stdout(Stdio::null());
    let mut child = command.spawn().unwrap();
    let enabled = "psm1: DISABLED to ENABLED";
    wait_for(log, &mut child, |log| {
        log.events.iter().any(|event| event == enabled)
    });
    child
}

/// A run that is signalled once its arm is enabled, and again after each of these pauses, ms; its
/// exit code and its result.
fn interrupted(run: &[&str], name: &str, again: &[u64]) -> (Option<i32>, serde_json::Value) {
    let folder = scratch(name);
    let (log, result) = (folder.join("a.mcap"), folder.join("a.json"));
    let mut child = enabled(run, &log, &result);
    for pause in [&[0], again].concat() {
        sleep_ns(pause * 1_000_000);
        interrupt_process(child.id()).unwrap();
    }
    let code = child.wait().unwrap().code();
    let log = RunLog::open(&log).unwrap();
    assert!(log.cut().is_none(), "{:?}", log.cut());
    assert_eq!(log.outcome.as_ref().unwrap().reason, "interrupted");
    let events = log.events.join("; ");
    assert!(events.ends_with("the run ended: interrupted"), "{events}");
    assert!(trocar_log::verify::verify(&log).unwrap().ok);
    (code, tests::json(&result))
}

#[test]
fn a_run_in_lockstep_that_is_interrupted_closes_its_log() {
    let _turn = alone();
    let run = [
        "run",
        "--task",
        "needle-handover",
        "--policy",
        "noop",
        "--lockstep",
    ];
    let (code, result) = interrupted(&run, "realtime-lockstep", &[]);
    assert_eq!((code, &result["reason"]), (Some(1), &"interrupted".into()));
}

#[test]
fn two_signals_at_once_lead_the_arm_to_rest_as_one_does() {
    let _turn = alone();
    let (code, result) = interrupted(&MOVING, "realtime-twice", &[20]);
    assert_eq!((code, &result["reason"]), (Some(1), &"interrupted".into()));
}

/// A run whose arm never rests by itself.
const MOVING: [&str; 5] = ["run", "--task", "needle-lift", "--policy", "random"];

/// The run is ended by a signal, within a minute.
fn expect_ended_by_signal(child: &mut Child) {
    let ended = (0..1200).any(|_| {
        sleep_ns(50_000_000);
        child.try_wait().unwrap().is_some()
    });
    if !ended {
        child.kill().unwrap();
    }
    let status = child.wait().unwrap();
    assert_eq!(status.signal(), Some(libc::SIGINT), "{status}");
}

/// Until the arm rests, half a second after it stands, the third signal ends the run at once:
/// nothing closes its log.
#[test]
fn a_third_signal_in_motion_ends_the_run_at_once() {
    let _turn = alone();
    let folder = scratch("realtime-thrice");
    let (log, result) = (folder.join("a.mcap"), folder.join("a.json"));
    let mut child = enabled(&MOVING, &log, &result);
    for _ in 0..3 {
        interrupt_process(child.id()).unwrap();
        sleep_ns(5_000_000);
    }
    expect_ended_by_signal(&mut child);
    let log = RunLog::open(&log).unwrap();
    assert!(log.cut().is_some() && log.outcome.is_none());
    assert!(!result.exists());
}

/// Once the arm rests the second signal ends the run at once, whatever it waits for: here for a
/// reader of its result.
#[test]
fn a_second_signal_after_rest_ends_the_run_at_once() {
    let _turn = alone();
    let folder = scratch("realtime-after-rest");
    let (log, result) = (folder.join("a.mcap"), folder.join("result"));
    let made = Command::new("mkfifo").arg(&result).status();
    assert!(made.unwrap().success());
    let mut child = enabled(&MOVING, &log, &result);
    interrupt_process(child.id()).unwrap();
    wait_for(&log, &mut child, |log| log.outcome.is_some());
    interrupt_process(child.id()).unwrap();
    expect_ended_by_signal(&mut child);
    assert_eq!(RunLog::open(&log).unwrap().cut(), None);
}
