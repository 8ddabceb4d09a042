//! What the command line says of itself and of its configuration, and where it puts results.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use tests::{repository, scratch, trocar};
use trocar_log::RunLog;

fn run(arguments: &[&str]) -> Output {
    trocar().args(arguments).output().unwrap()
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8(bytes.to_vec()).unwrap()
}

/// Standard output of a command that succeeds.
fn printed(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert!(output.status.success(), "{}", text(&output.stderr));
    text(&output.stdout)
}

/// What a command says that refuses its arguments.
fn refused(arguments: &[&str]) -> String {
    let output = run(arguments);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}");
    assert!(output.stdout.is_empty(), "{}", text(&output.stdout));
    text(&output.stderr)
}

/// The configuration is shown with every layer and is one that can be read again.
#[test]
fn shown_configuration_can_be_read_again() {
    let folder = scratch("command_line_config");
    let plain = printed(&["config", "show", "control"]);
    let set = ["--set", "control.limits.tip_speed_m_s=0.05"];
    let changed = printed(&[&["config", "show", "control"], &set[..]].concat());
    let lines = plain.lines().zip(changed.lines());
    let differing: Vec<_> = lines.filter(|(before, after)| before != after).collect();
    assert_eq!(
        differing,
        [("tip_speed_m_s = 0.08", "tip_speed_m_s = 0.05")]
    );
    let file = folder.join("control.toml");
    fs::write(&file, &changed).unwrap();
    let again = printed(&[
        "config",
        "show",
        "control",
        "--config",
        file.to_str().unwrap(),
    ]);
    assert_eq!(again, changed);
    for (name, file) in [
        ("safety", "config/tasks/suture-pad/safety.toml"),
        ("scene", "config/tasks/suture-pad/scene.toml"),
        ("can", "config/can.toml"),
    ] {
        let shown = printed(&["config", "show", name, "--task", "suture-pad"]);
        assert_eq!(shown, fs::read_to_string(repository().join(file)).unwrap());
    }
}

/// A set value changes the run as a changed file would and is in its log.
#[test]
fn set_value_acts_like_a_changed_file() {
    let folder = scratch("command_line_set");
    let log = folder.join("a.mcap");
    let run = [
        "run",
        "--task",
        "needle-lift",
        "--policy",
        "noop",
        "--lockstep",
    ];
    let set = [
        "--set",
        "scene.episode.time_limit_s=2",
        "--set",
        "safety.forbidden.0.name=artery",
    ];
    let output = run_with(&run, &set, &["--log", log.to_str().unwrap(), "--json", "-"]);
    assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
    let result: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let seconds = result["seconds"].as_f64().unwrap();
    assert!((1.9..2.1).contains(&seconds), "{result}");
    let log = RunLog::open(&log).unwrap();
    let scene = log.text("scene.toml").unwrap();
    assert!(scene.contains("time_limit_s = 2\n"), "{scene}");
    let safety = log.text("safety.toml").unwrap();
    assert!(safety.contains("name = \"artery\""), "{safety}");
}

fn run_with(run_arguments: &[&str], set: &[&str], more: &[&str]) -> Output {
    run(&[run_arguments, set, more].concat())
}

#[test]
fn a_value_that_cannot_be_set_is_refused_with_what_can() {
    let run = [
        "run",
        "--task",
        "needle-lift",
        "--policy",
        "noop",
        "--lockstep",
        "--set",
    ];
    for (set, why) in [
        (
            "control.limits.tip_sped=1",
            "has no key limits.tip_sped; there are",
        ),
        (
            "control.limits.tip_speed_m_s=9",
            "limits.tip_speed_m_s = 9 is outside",
        ),
        (
            "can.cycle_us=4000",
            "no can.toml is read here, only control, safety, scene",
        ),
        ("cycle_us", "FILE.KEY=VALUE"),
        (
            "robot.a=1",
            "there are control, safety, scene, can, realtime",
        ),
        (
            "realtime.control.priority=80",
            "no realtime.toml is read here, only control, safety, scene",
        ),
    ] {
        let told = refused(&[&run[..], &[set]].concat());
        assert!(told.contains(why), "{set}: {told}");
    }
}

#[test]
fn with_json_on_standard_output_nothing_else_is_there() {
    let arguments = [
        "eval",
        "--task",
        "needle-lift",
        "--policy",
        "noop",
        "--trials",
        "1",
    ];
    let output = run(&[&arguments[..], &["--json", "-"]].concat());
    let result: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(result["trials"], 1);
    assert!(text(&output.stderr).contains("needle-lift, noop: "));
    assert!(!std::path::Path::new("-").exists());
}

#[test]
fn completions_are_scripts_of_their_shells_and_know_the_tasks() {
    for shell in ["bash", "zsh", "fish"] {
        let script = printed(&["completions", shell]);
        for word in [
            "needle-handover",
            "verify",
            "--lockstep".trim_start_matches('-'),
        ] {
            assert!(script.contains(word), "{shell}: {word}");
        }
    }
    let mut bash = Command::new("bash")
        .arg("-n")
        .stdin(Stdio::piped())
        .spawn()
        .unwrap();
    let script = printed(&["completions", "bash"]);
    let mut input = bash.stdin.take().unwrap();
    input.write_all(script.as_bytes()).unwrap();
    drop(input);
    assert!(bash.wait().unwrap().success());
}

#[test]
fn there_is_a_man_page_for_each_verb() {
    let folder = scratch("command_line_man");
    printed(&["man", folder.to_str().unwrap()]);
    let page = |name: &str| fs::read_to_string(folder.join(name)).unwrap();
    assert!(page("trocar.1").contains("trocar\\-run"));
    for verb in [
        "run",
        "eval",
        "record",
        "import-lerobot",
        "import-log",
        "export-open-h",
        "train",
        "drives",
        "replay",
        "config-show",
    ] {
        assert!(
            page(&format!("trocar-{verb}.1")).starts_with(".ie"),
            "{verb}"
        );
    }
}

/// Each way in and out has examples, under the verb and under each layout.
#[test]
fn imports_and_exports_have_examples() {
    for (arguments, expected) in [
        (
            &["import", "--help"][..],
            "trocar import lerobot FOLDER --mapping open-h-dvrk",
        ),
        (
            &["import", "act", "--help"],
            "Example: trocar import act FOLDER",
        ),
        (&["import", "lerobot", "--help"], "--mapping my.toml"),
        (
            &["import", "log", "--help"],
            "Example: trocar import log runs/a.mcap runs/b.mcap",
        ),
        (&["export", "--help"], "Example: trocar export open-h"),
        (&["export", "open-h", "--help"], "--tools"),
    ] {
        let told = printed(arguments);
        assert!(told.contains(expected), "{arguments:?}: {told}");
    }
}

/// An instruction is the dataset's task and the simulator's is kept beside it.
#[test]
fn instruction_is_the_datasets_task() {
    let folder = scratch("command_line_instruction").join("demos");
    let words = "Pick the needle up and hold it.";
    let recorded = run(&[
        "record",
        "--task",
        "needle-lift",
        "--episodes",
        "1",
        "--source",
        "expert",
        "--set",
        "scene.rendering.shading=plain",
        "--instruction",
        words,
        "--out",
        folder.to_str().unwrap(),
    ]);
    assert!(recorded.status.success(), "{}", text(&recorded.stderr));
    let dataset = trocar_data::dataset::Dataset::open(&folder).unwrap();
    assert_eq!(dataset.spec().task, words);
    assert_eq!(dataset.task(), "needle-lift");
}

#[test]
fn what_would_fail_late_is_refused_at_once_with_what_helps() {
    let folder = scratch("command_line_refusals");
    let sheet = folder.join("sheet.xyz");
    let told = refused(&["sheet", "--out", sheet.to_str().unwrap()]);
    assert!(told.contains("a sheet is FILE.png"), "{told}");
    fs::write(folder.join("config.json"), "{\"type\": \"act\"}").unwrap();
    let folder = folder.to_str().unwrap();
    let told = refused(&[
        "eval",
        "--task",
        "needle-lift",
        "--trials",
        "1",
        "--policy",
        folder,
    ]);
    assert!(
        told.contains("trocar.json: file is missing") && told.contains("lerobot_recipe.py"),
        "{told}"
    );
    let told = refused(&["run", "--policy", "noop"]);
    assert!(
        told.contains("--task NAME") && told.contains("--safety FILE"),
        "{told}"
    );
    let told = refused(&[
        "run",
        "--policy",
        "noop",
        "--backend",
        "can",
        "--safety",
        "a.toml",
        "--view",
        "view2",
    ]);
    assert!(told.contains("--view"), "{told}");
}

const SHORT: [&str; 8] = [
    "run",
    "--task",
    "needle-lift",
    "--policy",
    "noop",
    "--lockstep",
    "--set",
    "scene.episode.time_limit_s=1",
];

#[test]
fn a_standard_output_that_is_full_or_closed_loses_no_result() {
    let folder = scratch("command_line_stdout");
    let file = folder.join("a.json");
    let full = fs::OpenOptions::new()
        .write(true)
        .open("/dev/full")
        .unwrap();
    let mut command = trocar();
    command.args(SHORT).arg("--json").arg(&file).stdout(full);
    let output = command.output().unwrap();
    let told = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(told.contains("standard output can't be written"), "{told}");
    assert_eq!(tests::json(&file)["task"], "needle-lift");
    // A reader that has gone away.
    let (reader, writer) = std::io::pipe().unwrap();
    drop(reader);
    let mut command = trocar();
    let file = folder.join("b.json");
    command.args(SHORT).arg("--json").arg(&file).stdout(writer);
    let output = command.output().unwrap();
    assert!(!text(&output.stderr).contains("panicked"));
    assert_eq!(tests::json(&file)["task"], "needle-lift");
}

/// A log that cannot be written ends in an error and loses no result.
#[test]
fn unwritable_log_is_an_error_with_its_result() {
    let folder = scratch("command_line_full");
    let (log, file) = (folder.join("a.mcap"), folder.join("a.json"));
    // No file may be larger than 60 KiB, which a write then tells as an error.
    let limited = "trap '' XFSZ; ulimit -f 60; exec \"$@\"";
    let output = Command::new("bash")
        .args(["-c", limited, "limited"])
        .arg(trocar().get_program())
        .args(SHORT)
        .arg("--log")
        .arg(&log)
        .arg("--json")
        .arg(&file)
        .output()
        .unwrap();
    let told = text(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{told}");
    assert!(
        told.contains("a.mcap: the log could not be written"),
        "{told}"
    );
    // It is said at once, not only at the end.
    let at_once = told.find("the run goes on without it");
    assert!(
        at_once.is_some_and(|at| at < told.rfind("trocar: error").unwrap_or(0)),
        "{told}"
    );
    assert!(text(&output.stdout).contains("command hash"), "{told}");
    assert!(
        text(&output.stdout).contains("measured clearance: "),
        "{told}"
    );
    assert_eq!(tests::json(&file)["task"], "needle-lift");
}

#[test]
fn of_a_cut_log_no_result_says_that_it_is_well() {
    let folder = scratch("command_line_cut");
    let (whole, cut) = (folder.join("a.mcap"), folder.join("cut.mcap"));
    let file = folder.join("result.json");
    let log = ["--log", whole.to_str().unwrap()];
    run(&[&SHORT[..], &log].concat());
    let bytes = fs::read(&whole).unwrap();
    let more = ["--json", file.to_str().unwrap()];
    let told = run(&[&["verify", whole.to_str().unwrap()], &more[..]].concat());
    assert!(told.status.success(), "{}", text(&told.stderr));
    assert_eq!(tests::json(&file)["ok"], true);
    for share in [2, 5, 9] {
        fs::write(&cut, &bytes[..bytes.len() * share / 10]).unwrap();
        for verb in ["verify", "replay"] {
            fs::write(&file, "{\"ok\": true, \"identical\": true}").unwrap();
            refused_with_output(&[&[verb, cut.to_str().unwrap()], &more[..]].concat());
            if file.exists() {
                assert_ne!(tests::json(&file)["ok"], true, "{verb} of {share} tenths");
            }
        }
    }
}

/// What the bound of a log kept is a cut log, unless one asks about that part.
#[test]
fn the_part_that_a_bound_kept_can_be_verified() {
    let folder = scratch("command_line_bounded");
    let log = folder.join("a.mcap");
    let file = log.to_str().unwrap();
    let bound = ["--log", file, "--log-max-mb", "16"];
    let long = ["--set", "scene.episode.time_limit_s=8"];
    run(&[&SHORT[..6], &long, &bound].concat());
    refused_with_output(&["verify", file]);
    let told = text(&run(&["verify", file]).stdout);
    assert!(told.starts_with("partial, no violations: "), "{told}");
    let told = text(&run(&["replay", file]).stdout);
    assert!(
        told.starts_with("identical: ")
            && told.contains(" was not kept; it begins where the file before ends"),
        "{told}"
    );
    let earlier = folder.join("a.earlier.mcap");
    let told = run(&["replay", earlier.to_str().unwrap()]);
    assert!(told.status.success(), "{}", text(&told.stderr));
    for kept in [file, earlier.to_str().unwrap()] {
        let told = run(&["verify", "--part", kept]);
        assert!(told.status.success(), "{}", text(&told.stderr));
        assert!(text(&told.stdout).starts_with("ok, as far as the log's bound kept it"));
    }
    let bytes = fs::read(&log).unwrap();
    fs::write(&log, &bytes[..bytes.len() / 2]).unwrap();
    refused_with_output(&["verify", "--part", file]);
}

/// As [`refused`], of a verb that prints what there is before.
fn refused_with_output(arguments: &[&str]) {
    let output = run(arguments);
    let told = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {told}");
}

fn make_pipe(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

/// An input is neither overwritten through a link nor read without end.
#[test]
fn inputs_are_not_overwritten_through_links() {
    let folder = scratch("command_line_links");
    let (config, link) = (folder.join("control.toml"), folder.join("link.json"));
    fs::copy(repository().join("config/control.toml"), &config).unwrap();
    fs::hard_link(&config, &link).unwrap();
    let [config, link] = [config.to_str().unwrap(), link.to_str().unwrap()];
    let told = refused(&[&SHORT[..], &["--config", config, "--json", link]].concat());
    assert!(told.contains("--config names the same"), "{told}");
    let (policy, link) = (folder.join("policy"), folder.join("weights.json"));
    fs::create_dir_all(&policy).unwrap();
    fs::write(policy.join("config.json"), "{}").unwrap();
    fs::hard_link(policy.join("config.json"), &link).unwrap();
    let [policy, link] = [policy.to_str().unwrap(), link.to_str().unwrap()];
    let eval = ["eval", "--task", "needle-lift", "--trials", "1"];
    let told = refused(&[&eval[..], &["--policy", policy, "--json", link]].concat());
    assert!(told.contains("--policy names the same"), "{told}");
    let pipe = folder.join("pipe");
    make_pipe(&pipe);
    for endless in [pipe.to_str().unwrap(), "/dev/zero"] {
        let told = refused(&[&SHORT[..], &["--config", endless]].concat());
        assert!(told.contains("not a file"), "{told}");
    }
    let large = folder.join("large.toml");
    fs::write(&large, " ".repeat(1 << 21)).unwrap();
    let told = refused(&[&SHORT[..], &["--config", large.to_str().unwrap()]].concat());
    let limit = "the limit for a configuration is 1048576 bytes";
    assert!(told.contains(limit), "{told}");
}
