//! `trocar policy`: a checkpoint in a process that a person starts, for sessions in lockstep and in
//! real time.

use std::io::{BufRead as _, BufReader};
use std::process::{Child, ChildStderr, Command, Stdio};

use tests::{alone, json, scratch, trocar};

use super::{CHECKPOINT, checked_log, expect_a_stop, expect_nothing_left, moves, send, until};

/// A policy by hand, ended with the test.
struct ByHand {
    process: Child,
    said: BufReader<ChildStderr>,
}

impl ByHand {
    /// Starts it and waits until it is on its topics.
    fn start(name: &str, more: &[&str]) -> Self {
        let mut process = trocar()
            .args(["policy", "--policy", CHECKPOINT, "--name", name])
            .args(more)
            .stderr(Stdio::piped())
            .spawn()
            .unwrap();
        let said = BufReader::new(process.stderr.take().unwrap());
        let mut by_hand = Self { process, said };
        by_hand.hear("is on topics");
        by_hand
    }

    /// Reads on to the line that has `words` in it.
    fn hear(&mut self, words: &str) -> String {
        let mut line = String::new();
        while !line.contains(words) {
            line.clear();
            let read = self.said.read_line(&mut line).unwrap();
            assert!(read > 0, "ended without saying {words:?}");
        }
        line
    }

    fn end(&mut self) -> Option<i32> {
        let mut code = None;
        until("the policy ends", || {
            code = self.process.try_wait().unwrap();
            code.is_some()
        });
        code.and_then(|status| status.code())
    }
}

impl Drop for ByHand {
    fn drop(&mut self) {
        let _gone = self.process.kill();
        let _reaped = self.process.wait();
    }
}

fn topics(test: &str) -> String {
    format!("test-{}-{test}", std::process::id())
}

fn run(policy: &str, more: &[&str]) -> Command {
    let mut command = trocar();
    command
        .args(["run", "--task", "needle-lift", "--policy", policy])
        .args(["--set", "control.aggregation.mode=newest"])
        .args(more)
        .stdout(Stdio::null());
    command
}

/// Two sessions in lockstep, one after another: each has the command hash of the policy inside the
/// session's process.
#[test]
fn by_hand_a_policy_has_the_hash_of_its_own_runs() {
    let folder = scratch("by-hand-lockstep");
    let hash = |policy: &str, name: &str| {
        let result = folder.join(name);
        let lockstep = ["--lockstep", "--seed", "3", "--json"];
        let short = ["--set", "scene.episode.time_limit_s=2"];
        let status = run(policy, &short).args(lockstep).arg(&result).status();
        assert_eq!(status.unwrap().code(), Some(1));
        let result = json(&result);
        assert_eq!(result["policy"]["queries"], 2, "{result}");
        result["command_hash"].clone()
    };
    let name = topics("lockstep");
    let mut by_hand = ByHand::start(&name, &["--sessions", "2"]);
    let external = format!("external:{name}");
    let served = [
        hash(&external, "first.json"),
        hash(&external, "second.json"),
    ];
    assert!(by_hand.hear("task").contains("\"needle-lift\""));
    assert_eq!(by_hand.end(), Some(0));
    let own = hash(CHECKPOINT, "own.json");
    assert_eq!(served, [own.clone(), own]);
}

/// A supervised run waits for a policy that is killed, and goes on with the one that is started in
/// its place.
#[test]
fn by_hand_a_policy_joins_and_rejoins_a_run() {
    let _turn = alone();
    let folder = scratch("by-hand-realtime");
    let (log, result) = (folder.join("run.mcap"), folder.join("run.json"));
    let name = topics("realtime");
    let supervised = [
        "--set",
        "control.policy.restarts=1",
        "--set",
        "scene.episode.time_limit_s=300",
    ];
    // The run is there before the policy.
    let mut session = run(&format!("external:{name}"), &supervised)
        .arg("--log")
        .arg(&log)
        .arg("--json")
        .arg(&result)
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut first = ByHand::start(&name, &[]);
    first.hear("session of process");
    until("the run is under way", || moves(&log));
    first.process.kill().unwrap();
    first.process.wait().unwrap();
    let mut second = ByHand::start(&name, &["--sessions", "1"]);
    second.hear("session of process");
    let before = std::fs::metadata(&log).unwrap().len();
    until("the run goes on", || {
        std::fs::metadata(&log).unwrap().len() > before + 1_000_000
            || session.try_wait().unwrap().is_some()
    });
    if session.try_wait().unwrap().is_none() {
        send("-INT", session.id());
    }
    let mut code = None;
    until("the run ends", || {
        code = session.try_wait().unwrap();
        code.is_some()
    });
    let result = json(&result);
    assert_eq!(result["policy"]["restarts"], 1, "{result}");
    assert_eq!(result["success"], code.unwrap().success());
    expect_a_stop(&checked_log(&log, &result));
    assert_eq!(second.end(), Some(0));
    expect_nothing_left(&[session.id(), first.process.id(), second.process.id()]);
}

/// What is told to a session that is waited for by nobody, a signal, and what is no checkpoint.
#[test]
fn by_hand_a_policy_ends_on_a_signal_and_refuses_others() {
    let mut by_hand = ByHand::start(&topics("signal"), &[]);
    send("-INT", by_hand.process.id());
    by_hand.hear("0 sessions served");
    assert_eq!(by_hand.end(), Some(0));
    for (policy, name, said) in [
        ("expert", "lab", "a checkpoint's folder is wanted"),
        ("no/such/folder", "lab", "there is no such folder"),
        (CHECKPOINT, "a/b", "cannot name a topic"),
    ] {
        let output = trocar()
            .args(["policy", "--policy", policy, "--name", name])
            .output()
            .unwrap();
        let stderr = tests::stderr(&output);
        assert_eq!(output.status.code(), Some(2), "{stderr}");
        assert!(stderr.contains(said), "{stderr}");
    }
}
