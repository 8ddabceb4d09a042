//! `trocar eval` as CI and papers need it: exit codes by the rate, an interrupt that loses nothing,
//! logs of what was lost.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};

use tests::{json, repository, scratch, stderr, trocar};

/// The needle lift with a second to do it in.
fn hasty_scene(folder: &Path) -> PathBuf {
    let scene = repository().join("config/tasks/needle-lift/scene.toml");
    let text = fs::read_to_string(scene).unwrap();
    assert!(text.contains("time_limit_s = 12.0"));
    let path = folder.join("hasty.toml");
    let text = text.replace("time_limit_s = 12.0", "time_limit_s = 1.0");
    fs::write(&path, text).unwrap();
    path
}

fn eval(policy: &str, arguments: &[&str]) -> Command {
    let mut command = trocar();
    command.args(["eval", "--task", "needle-lift", "--policy", policy]);
    command.args(arguments);
    command
}

fn code(output: &Output) -> i32 {
    output.status.code().unwrap()
}

#[test]
fn rate_and_interval_decide_the_exit_code() {
    let folder = scratch("min-rate");
    let scene = hasty_scene(&folder).display().to_string();
    let noop = |more: &[&str]| {
        let arguments = [&["--trials", "2", "--jobs", "2", "--scene", &scene], more].concat();
        eval("noop", &arguments).output().unwrap()
    };
    assert_eq!(code(&noop(&[])), 0, "the rate is asked for by nobody");
    assert_eq!(code(&noop(&["--min-rate", "0", "--min-wilson", "0"])), 0);
    let below = noop(&["--min-rate", "0.5"]);
    assert_eq!(code(&below), 1);
    let said = stderr(&below);
    assert!(
        said.contains("success rate 0.0000 is below --min-rate 0.5"),
        "{said}"
    );
    // A line a trial, in order, where there is no terminal.
    assert!(
        said.contains("trial 1 of 2, seed 1000000: ")
            && said.contains("trial 2 of 2, seed 1000001: "),
        "{said}"
    );

    // Of 2 successes of 2 Wilson's interval begins at 0.342.
    let expert = |more: &[&str]| {
        let arguments = [&["--trials", "2", "--jobs", "2"], more].concat();
        eval("expert", &arguments).output().unwrap()
    };
    let enough = expert(&["--min-rate", "1", "--min-wilson", "0.34"]);
    assert_eq!(code(&enough), 0, "{}", stderr(&enough));
    let below = expert(&["--min-rate", "1", "--min-wilson", "0.35"]);
    assert_eq!(code(&below), 1);
    assert!(stderr(&below).contains("0.3424 is below --min-wilson 0.35"));
}

#[test]
fn what_cannot_be_asked_for_is_refused() {
    for (option, value) in [
        ("--min-rate", "1.5"),
        ("--min-rate", "nan"),
        ("--min-wilson", "-1"),
        ("--min-wilson", "half"),
    ] {
        let output = eval("noop", &[&format!("{option}={value}")])
            .output()
            .unwrap();
        assert_eq!(code(&output), 2, "{option} {value}");
        assert!(stderr(&output).contains("expected a number in [0, 1]"));
    }
    let full = scratch("keep-full");
    fs::write(full.join("precious"), "data").unwrap();
    let full = full.display().to_string();
    for (choice, reason) in [
        ("failures", "not an empty folder"),
        ("some", "failures or all"),
    ] {
        let output = eval("noop", &["--keep", choice, &full]).output().unwrap();
        assert_eq!(code(&output), 2);
        assert!(stderr(&output).contains(reason), "{}", stderr(&output));
    }
}

/// Names of the files in `folder`, sorted.
fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries
        .map(|entry| entry.unwrap().file_name().into_string().unwrap())
        .collect();
    names.sort();
    names
}

fn reads(verb: &str, log: &Path) {
    let output = trocar().arg(verb).arg(log).output().unwrap();
    assert_eq!(code(&output), 0, "{verb}: {}", stderr(&output));
}

#[test]
fn kept_failures_replay_and_are_the_trials_that_were_counted() {
    let folder = scratch("keep-failures");
    let scene = hasty_scene(&folder).display().to_string();
    let (kept, result) = (folder.join("kept"), folder.join("result.json"));
    let arguments = [
        "--trials", "2", "--jobs", "2", "--seed", "5", "--scene", &scene,
    ];
    let run = |keep: &[&str]| {
        let mut command = eval("random", &[&arguments[..], keep].concat());
        let output = command.arg("--json").arg(&result).output().unwrap();
        assert_eq!(code(&output), 0, "{}", stderr(&output));
        json(&result)
    };
    let with = run(&["--keep", "failures", &kept.display().to_string()]);
    let files = ["seed-5.gif", "seed-5.mcap", "seed-6.gif", "seed-6.mcap"];
    assert_eq!(names(&kept), files);
    for (episode, seed) in with["episodes"].as_array().unwrap().iter().zip([5, 6]) {
        let log = kept.join(format!("seed-{seed}.mcap"));
        assert_eq!(episode["log"], log.display().to_string());
        let gif = fs::read(episode["pictures"].as_str().unwrap()).unwrap();
        assert!(
            gif.starts_with(b"GIF89a") && gif.len() > 20_000,
            "{}",
            gif.len()
        );
        reads("replay", &log);
        reads("verify", &log);
    }
    let without = run(&[]);
    for index in 0..2 {
        let (one, other) = (&with["episodes"][index], &without["episodes"][index]);
        assert_eq!(one["command_hash"], other["command_hash"]);
        assert!(other.get("log").is_none());
    }
    assert_eq!(with["interrupted"], false);
    assert_eq!(
        (&with["trials"], &with["trials_asked"]),
        (&2.into(), &2.into())
    );

    let none = folder.join("none");
    let keep = [
        "--trials",
        "1",
        "--keep",
        "failures",
        &none.display().to_string(),
    ];
    assert_eq!(code(&eval("expert", &keep).output().unwrap()), 0);
    assert_eq!(names(&none), [""; 0], "nothing was lost");
}

#[test]
fn an_interrupted_evaluation_writes_what_is_done() {
    let folder = scratch("eval-interrupted");
    let scene = hasty_scene(&folder).display().to_string();
    let (kept, result) = (folder.join("kept"), folder.join("result.json"));
    let arguments = [
        "--trials", "100000", "--jobs", "2", "--scene", &scene, "--keep", "all",
    ];
    let mut child = eval("noop", &arguments)
        .arg(&kept)
        .arg("--json")
        .arg(&result)
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut lines = BufReader::new(child.stderr.take().unwrap()).lines();
    let second = lines.find(|line| line.as_ref().unwrap().starts_with("trial 2 of"));
    assert!(second.is_some());
    let sent = Command::new("kill")
        .args(["-INT", &child.id().to_string()])
        .status()
        .unwrap();
    assert!(sent.success());
    let said: Vec<String> = lines.map(|line| line.unwrap()).collect();
    let said = said.join("\n");
    assert_eq!(child.wait().unwrap().code(), Some(1), "{said}");
    assert!(said.contains("trials were done"), "{said}");
    let result = json(&result);
    let episodes = result["episodes"].as_array().unwrap();
    assert_eq!(result["interrupted"], true);
    assert_eq!(result["trials_asked"], 100_000);
    assert_eq!(result["trials"], episodes.len());
    assert!((2..100).contains(&episodes.len()), "{}", episodes.len());
    // Each trial that counts has its log, and what was abandoned has none.
    let mut expected: Vec<String> = episodes
        .iter()
        .flat_map(|episode| ["gif", "mcap"].map(|kind| format!("seed-{}.{kind}", episode["seed"])))
        .collect();
    expected.sort();
    assert_eq!(names(&kept), expected);
    for episode in episodes {
        reads("replay", Path::new(episode["log"].as_str().unwrap()));
    }
}

#[test]
fn a_demo_of_a_task_without_a_policy_names_those_with_one() {
    let folder = scratch("demo").display().to_string();
    let mut command = trocar();
    command.args(["demo", "--out", &folder, "--task"]);
    let task = scratch("demo-task").join("my-own-task");
    fs::create_dir_all(&task).unwrap();
    for file in ["scene.toml", "safety.toml"] {
        let built_in = repository().join("config/tasks/needle-lift").join(file);
        fs::copy(built_in, task.join(file)).unwrap();
    }
    let output = command.arg(&task).output().unwrap();
    assert_eq!(code(&output), 2);
    let said = stderr(&output);
    assert!(
        said.contains("my-own-task has no committed policy") && said.contains("needle-lift"),
        "{said}"
    );
}
