//! A scene file of the user's own, from the command line to the result, the log and the pictures;
//! and policies that do another task than the one of their demonstrations.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::path::{Path, PathBuf};
use std::process::Output;

use tests::{json, repository, scratch, stderr, trocar};
use trocar_log::RunLog;

const COMMITTED: &str = "config/policies/needle-lift/act-compact";

fn run(arguments: &[&str]) -> Output {
    trocar().args(arguments).output().unwrap()
}

/// Runs `trocar`, expects `code`, and gives what it said on standard error.
fn ends_with(code: i32, arguments: &[&str]) -> String {
    let output = run(arguments);
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
    message
}

/// The shipped scene of `task` with each first line that begins with one of `changes` replaced, as
/// a file in `folder`.
fn changed(task: &str, folder: &Path, changes: &[(&str, &str)]) -> PathBuf {
    let shipped = repository().join(format!("config/tasks/{task}/scene.toml"));
    let text = fs::read_to_string(shipped).unwrap();
    let mut lines: Vec<&str> = text.lines().collect();
    for (old, new) in changes {
        let place = lines.iter().position(|line| line.starts_with(old));
        lines[place.unwrap()] = new;
    }
    let path = folder.join("mine.toml");
    fs::write(&path, lines.join("\n")).unwrap();
    path
}

const SHORT: (&str, &str) = ("time_limit_s", "time_limit_s = 1.5");
const PLAIN: (&str, &str) = ("shading", "shading = \"plain\"");

/// A run in a changed scene keeps its text and can be replayed and verified.
#[test]
fn run_in_a_changed_scene_replays_and_verifies() {
    let folder = scratch("own-scene");
    let scene = changed("needle-lift", &folder, &[SHORT, PLAIN]);
    let paths = [&scene, &folder.join("run.mcap"), &folder.join("run.json")];
    let [scene_file, log, result] = paths.map(|path| path.display().to_string());
    let task = ["--task", "needle-lift", "--policy", "noop", "--lockstep"];
    let files = [
        "--scene",
        &scene_file,
        "--log",
        &log,
        "--json",
        &result,
        "--cameras",
        "wrist",
    ];
    ends_with(1, &[&["run"], &task[..], &files[..]].concat());
    let told = json(paths[2]);
    assert_eq!(told["scene"], scene_file.as_str());
    assert_eq!(told["ticks"], 1500);
    assert!(told["policy"]["trained_on"].is_null());
    let header = RunLog::open(paths[1]).unwrap().header;
    let text = fs::read_to_string(&scene).unwrap();
    assert_eq!(header.texts.get("scene.toml"), Some(&text));
    ends_with(0, &["replay", &log]);
    ends_with(0, &["verify", &log]);
}

/// A set value is for the scene that is in effect and for no other.
#[test]
fn set_value_changes_the_scene_in_effect_only() {
    let folder = scratch("own-scene-set");
    let renamed = ("[needle.N5]", "[needle.mine]");
    let scene = changed("needle-lift", &folder, &[SHORT, PLAIN, renamed]);
    let log = folder.join("run.mcap");
    let paths = [&scene, &log].map(|path| path.display().to_string());
    let task = ["run", "--task", "needle-lift", "--policy", "noop"];
    let with_scene = ["--lockstep", "--scene", &paths[0], "--set"];
    let run = [&task[..], &with_scene[..]].concat();
    let mine = ["scene.needle.mine.mass_kg=0.001", "--log", &paths[1]];
    ends_with(1, &[&run[..], &mine[..]].concat());
    let header = RunLog::open(&log).unwrap().header;
    let text = fs::read_to_string(&scene).unwrap();
    let (before, own) = text.split_once("[needle.mine]").unwrap();
    let own = own.replacen("mass_kg = 0.0015", "mass_kg = 0.001", 1);
    let expected = format!("{before}[needle.mine]{own}");
    assert_eq!(header.texts.get("scene.toml"), Some(&expected));
    // What only the task's own scene has is none of its keys.
    let message = ends_with(2, &[&run[..], &["scene.needle.N5.mass_kg=0.001"]].concat());
    assert!(
        message.contains("mine.toml") && message.contains("has no key needle.N5"),
        "{message}"
    );
}

/// A sheet of a plain scene is another picture and needs one task.
#[test]
fn sheet_of_a_plain_scene_needs_one_task() {
    let folder = scratch("plain-sheet");
    let scene = changed("needle-lift", &folder, &[PLAIN]);
    let scene = scene.display().to_string();
    let task = ["--task", "needle-lift"];
    let draw = |name: &str, more: &[&str]| {
        let file = folder.join(name);
        let path = file.display().to_string();
        let sheet = ["sheet", "--width", "24", "--at", "0.05", "--out", &path];
        ends_with(0, &[&sheet[..], &task[..], more].concat());
        fs::read(file).unwrap()
    };
    let full = draw("full.png", &[]);
    let plain = draw("plain.png", &["--scene", &scene]);
    assert!(full != plain);
    assert!(plain == draw("again.png", &["--scene", &scene]));

    let out = folder.join("none.png").display().to_string();
    let sheet = ["sheet", "--out", &out, "--scene", &scene];
    let two = ["--task", "needle-lift", "--task", "suture-pad"];
    for tasks in [&[][..], &two[..]] {
        let message = ends_with(2, &[&sheet[..], tasks].concat());
        assert!(message.contains("name that one with --task"), "{message}");
    }
    let twice = ["sheet", "--out", &out, "--task", "suture-pad", "--task"];
    let message = ends_with(2, &[&twice[..], &["suture-pad"]].concat());
    assert!(message.contains("suture-pad is named twice"), "{message}");
    let needle = ["sheet", "--out", &out, "--needle", "N2", "--task"];
    let message = ends_with(2, &[&needle[..], &["suture-pad"]].concat());
    assert!(message.contains("no choice of needles"), "{message}");
    assert!(!Path::new(&out).exists());
}

#[test]
fn evaluations_and_recordings_take_a_scene_and_tell_it() {
    let folder = scratch("own-scene-eval");
    let scene = changed("needle-lift", &folder, &[SHORT])
        .display()
        .to_string();
    let result = folder.join("eval.json");
    let path = result.display().to_string();
    let eval = ["eval", "--task", "needle-lift", "--policy", "expert"];
    let more = ["--trials", "1", "--json", &path, "--scene", &scene];
    ends_with(0, &[&eval[..], &more[..]].concat());
    let told = json(&result);
    // The expert needs longer than this scene gives it.
    assert_eq!(told["successes"], 0);
    assert_eq!(told["episodes"][0]["seconds"], 1.5);
    assert_eq!(told["scene"], scene.as_str());

    let scene = changed("needle-lift", &folder, &[PLAIN])
        .display()
        .to_string();
    let result = folder.join("record.json");
    let (out, path) = (folder.join("demos"), result.display().to_string());
    let out = out.display().to_string();
    let record = ["record", "--task", "needle-lift", "--episodes", "1"];
    let more = ["--out", &out, "--json", &path, "--scene", &scene];
    ends_with(0, &[&record[..], &more[..]].concat());
    assert_eq!(json(&result)["scene"], scene.as_str());
}

/// A scene that is not the task's is refused with file line and key.
#[test]
fn scene_of_another_task_is_refused_by_line() {
    let folder = scratch("wrong-scene");
    let run = ["run", "--policy", "expert", "--lockstep", "--task"];
    let refused = |task: &str, path: &Path| {
        let path = path.display().to_string();
        ends_with(2, &[&run[..], &[task, "--scene", &path]].concat())
    };
    let line_of = |path: &Path, start: &str| {
        let text = fs::read_to_string(path).unwrap();
        let place = text.lines().position(|line| line.starts_with(start));
        place.unwrap() + 1
    };
    let other = changed("suture-pad", &folder, &[]);
    let message = refused("needle-lift", &other);
    let place = format!(
        "mine.toml:{}: task.kind = suture-pad",
        line_of(&other, "kind =")
    );
    assert!(
        message.contains(&place) && message.contains("needle-lift"),
        "{message}"
    );
    for (key, value) in [
        ("rcm_in_scene_m", "[0.01, 0.0, 0.15]"),
        ("rcm_in_scene_rpy_rad", "[0.0, 0.1, 0.0]"),
        ("joints", "[0.0, 0.0, 9.0, 0.0, 0.0, 0.0]"),
        ("shading", "\"glossy\""),
        ("time_limit_s", "\"soon\""),
    ] {
        let line = format!("{key} = {value}");
        let moved = changed("needle-lift", &folder, &[(key, &line)]);
        let message = refused("needle-lift", &moved);
        let place = format!("mine.toml:{}: ", line_of(&moved, key));
        assert!(
            message.contains(&place) && message.contains(&format!(".{key}")),
            "{message}"
        );
    }
    let unknown = changed("needle-lift", &folder, &[("shading", "shadows = 1")]);
    assert!(refused("needle-lift", &unknown).contains("shadows"));
    let message = refused("needle-lift", &folder.join("nowhere.toml"));
    assert!(
        message.contains("nowhere.toml: cannot be read"),
        "{message}"
    );

    let scene = changed("needle-lift", &folder, &[]);
    let (text, path) = (
        fs::read_to_string(&scene).unwrap(),
        scene.display().to_string(),
    );
    let both = ["needle-lift", "--scene", &path, "--json", &path];
    let message = ends_with(2, &[&run[..], &both[..]].concat());
    assert!(message.contains("--scene names the same"), "{message}");
    assert_eq!(fs::read_to_string(scene).unwrap(), text);
}

/// What `sha256sum` says of a file of the repository.
fn sha256(file: &str) -> String {
    let mut sum = std::process::Command::new("sha256sum");
    let output = sum.arg(repository().join(file)).output().unwrap();
    let told = String::from_utf8(output.stdout).unwrap();
    told.split_once(' ').unwrap().0.to_owned()
}

/// Warnings in `said`, but for that of a slow clock.
fn warnings(said: &str) -> usize {
    let lines = said.lines().filter(|line| line.contains("warning"));
    lines
        .filter(|line| !line.contains("TROCAR_SLOW_MOTION"))
        .count()
}

/// A policy of another task runs with a warning and is known by its weights.
#[test]
fn policy_of_another_task_runs_with_a_warning() {
    let folder = scratch("transfer");
    let result = folder.join("result.json");
    let path = result.display().to_string();
    let log = folder.join("run.mcap");
    let log_path = log.display().to_string();
    let weights = sha256(&format!("{COMMITTED}/model.safetensors"));
    for (task, other) in [("tissue-retraction", true), ("needle-lift", false)] {
        let scene = changed(task, &folder, &[("time_limit_s", "time_limit_s = 1.0")]);
        let scene = scene.display().to_string();
        let choice = ["--task", task, "--policy", COMMITTED, "--scene", &scene];
        let counts = ["eval", "--trials", "1", "--json", &path];
        let said = ends_with(0, &[&counts[..], &choice[..]].concat());
        let warning =
            format!("trocar: warning: the policy was trained on task needle-lift, not on {task}\n");
        assert_eq!(said.contains(&warning), other, "{said}");
        assert_eq!(warnings(&said), usize::from(other), "{said}");
        let told = json(&result);
        assert_eq!(told["trained_on"], "needle-lift");
        assert_eq!(told["weights_sha256"], weights.as_str());
        let run = ["run", "--lockstep", "--json", &path, "--log", &log_path];
        let said = ends_with(1, &[&run[..], &choice[..]].concat());
        assert_eq!(warnings(&said), usize::from(other), "{said}");
        let policy = &json(&result)["policy"];
        assert_eq!(policy["trained_on"], "needle-lift");
        assert_eq!(policy["weights_sha256"], weights.as_str());
        let versions = RunLog::open(&log).unwrap().header.versions;
        assert_eq!(versions.get("weights_sha256"), Some(&weights));
    }
}
