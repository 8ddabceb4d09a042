//! A task that a lab adds by writing one folder: it runs, is evaluated, recorded, drawn and checked
//! as the built-in ones are, under its own name; and what is no task is refused.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::path::{Path, PathBuf};

use tests::{json, repository, scratch, stderr, trocar};
use trocar_data::dataset::Dataset;
use trocar_log::RunLog;

/// Runs `trocar`, expects `code`, and gives what it said on standard error.
fn ends_with(code: i32, arguments: &[&str]) -> String {
    let output = trocar().args(arguments).output().unwrap();
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(code), "{arguments:?}: {message}");
    message
}

/// The folder `name` in `parent` with the files of the built-in needle lift, of whose lines that
/// begin with one of `changes` the first is replaced.
fn task(parent: &Path, name: &str, changes: &[(&str, &str)]) -> PathBuf {
    let (shipped, folder) = (
        repository().join("config/tasks/needle-lift"),
        parent.join(name),
    );
    fs::create_dir_all(&folder).unwrap();
    let text = fs::read_to_string(shipped.join("scene.toml")).unwrap();
    let mut lines: Vec<&str> = text.lines().collect();
    for (old, new) in changes {
        let place = lines.iter().position(|line| line.starts_with(old));
        lines[place.unwrap()] = new;
    }
    fs::write(folder.join("scene.toml"), lines.join("\n")).unwrap();
    fs::copy(shipped.join("safety.toml"), folder.join("safety.toml")).unwrap();
    folder
}

/// Another needle than the lift's, which may lie anywhere in a smaller region and any way round
/// within 0.6 rad, and must be lifted twice as high as in the built-in task and higher than its
/// expert lifts.
const OTHER_LIFT: [(&str, &str); 8] = [
    ("order", "# no order"),
    ("arc_radius_m", "arc_radius_m = 0.0121"),
    ("arc_angle_rad", "arc_angle_rad = 3.142"),
    ("wire_radius_m", "wire_radius_m = 0.0007"),
    ("range_m", "range_m = [0.010, 0.006]"),
    ("yaw_jitter_rad", "yaw_jitter_rad = 0.6"),
    ("lift_height_m", "lift_height_m = 0.040"),
    ("shading", "shading = \"plain\""),
];

fn text(path: &Path) -> String {
    path.display().to_string()
}

#[test]
fn the_same_files_under_another_name_give_the_same_commands() {
    let scratch = scratch("task-copy");
    let folder = task(&scratch, "lift-copy", &[]);
    let (result, path) = (scratch.join("eval.json"), text(&folder));
    let out = text(&result);
    let evaluated = |task: &str| {
        let eval = ["eval", "--policy", "expert", "--trials", "1", "--seed", "3"];
        ends_with(0, &[&eval[..], &["--json", &out, "--task", task]].concat());
        json(&result)
    };
    let (built_in, own) = (evaluated("needle-lift"), evaluated(&path));
    assert_eq!(
        (&built_in["task"], &own["task"]),
        (&"needle-lift".into(), &"lift-copy".into())
    );
    assert!(built_in["scene"].is_null());
    assert_eq!(own["scene"], text(&folder.join("scene.toml")).as_str());
    assert_eq!(built_in["episodes"], own["episodes"]);
}

#[test]
fn an_expert_does_a_task_that_is_only_a_folder() {
    let scratch = scratch("task-own");
    let folder = task(&scratch, "high-lift", &OTHER_LIFT);
    // Limits of its own, too.
    let limits = folder.join("safety.toml");
    let own = fs::read_to_string(&limits).unwrap();
    let own = own.replace("name = \"vessel\"", "name = \"artery\"");
    fs::write(&limits, &own).unwrap();
    let path = text(&folder);
    let result = scratch.join("eval.json");
    let eval = ["eval", "--policy", "expert", "--trials", "3", "--task"];
    ends_with(0, &[&eval[..], &[&path, "--json", &text(&result)]].concat());
    let told = json(&result);
    assert_eq!(told["task"], "high-lift");
    assert_eq!(told["successes"], 3, "{told:#}");

    let (log, result) = (scratch.join("run.mcap"), scratch.join("run.json"));
    let run = ["run", "--lockstep", "--policy", "expert", "--task", &path];
    let (log, out) = (text(&log), text(&result));
    ends_with(0, &[&run[..], &["--log", &log, "--json", &out]].concat());
    assert_eq!(json(&result)["task"], "high-lift");
    let header = RunLog::open(Path::new(&log)).unwrap().header;
    assert_eq!(header.task, "high-lift");
    assert_eq!(header.texts.get("safety.toml"), Some(&own));
    // A log needs the folder no more.
    fs::remove_dir_all(&folder).unwrap();
    ends_with(0, &["replay", &log]);
    ends_with(0, &["verify", &log]);
    let message = ends_with(2, &run);
    assert!(message.contains("there is no such folder"), "{message}");
}

#[test]
fn a_recording_and_a_sheet_of_a_folder_carry_its_name() {
    let scratch = scratch("task-recorded");
    let folder = task(&scratch, "high-lift", &OTHER_LIFT);
    let scene = folder.join("scene.toml");
    let small = fs::read_to_string(&scene).unwrap().replace("= 512", "= 64");
    fs::write(&scene, small).unwrap();
    let (path, out) = (text(&folder), scratch.join("demos"));
    let record = ["record", "--episodes", "1", "--out", &text(&out), "--task"];
    ends_with(0, &[&record[..], &[&path]].concat());
    assert_eq!(Dataset::open(&out).unwrap().spec().task, "high-lift");

    let picture = scratch.join("tasks.png");
    let sheet = ["sheet", "--width", "24", "--at", "0.05", "--out"];
    let out = text(&picture);
    ends_with(0, &[&sheet[..], &[&out, "--task", &path]].concat());
    assert!(picture.exists());
    let dotted = format!("{path}/.");
    let twice = [&sheet[..], &[&out, "--task", &path, "--task", &dotted]].concat();
    let message = ends_with(2, &twice);
    assert!(message.contains("high-lift is named twice"), "{message}");
}

#[test]
fn what_is_no_task_is_refused_by_every_verb() {
    let scratch = scratch("task-refused");
    let empty = scratch.join("empty");
    fs::create_dir_all(&empty).unwrap();
    let (empty, out) = (text(&empty), text(&scratch.join("out.png")));
    let verbs: [&[&str]; 5] = [
        &["run", "--policy", "expert", "--lockstep", "--task"],
        &["eval", "--policy", "expert", "--task"],
        &["record", "--episodes", "1", "--out", &out, "--task"],
        &["sheet", "--out", &out, "--task"],
        &["drives", "--task"],
    ];
    for verb in verbs {
        let message = ends_with(2, &[verb, &["needle-drop"]].concat());
        assert!(
            message.contains("there is no task \"needle-drop\"; there are needle-lift"),
            "{message}"
        );
        let message = ends_with(2, &[verb, &[&empty]].concat());
        assert!(
            message.contains("empty/scene.toml: cannot be read"),
            "{message}"
        );
    }
    assert!(!Path::new(&out).exists());
}

#[test]
fn a_folder_that_is_wrong_is_refused_with_file_line_and_key() {
    let scratch = scratch("task-wrong");
    let refused = |folder: &Path, more: &[&str]| {
        let path = text(folder);
        let run = ["run", "--policy", "expert", "--lockstep", "--task", &path];
        ends_with(2, &[&run[..], more].concat())
    };
    for (old, new, reason) in [
        (
            "kind",
            "kind = \"needle-drop\"",
            "task.kind = needle-drop is outside block-transfer",
        ),
        ("kind", "# none", "missing field `kind`"),
        ("order", "number = 3", "unknown field `number`"),
        (
            "lift_height_m",
            "lift_height_m = 3.0",
            "success.lift_height_m = 3 is outside [0.005, 0.1]",
        ),
        (
            "rcm_in_scene_m",
            "rcm_in_scene_m = [0.0, 0.0, 0.16]",
            "arm.0.rcm_in_scene_m",
        ),
    ] {
        let folder = task(&scratch, "wrong", &[(old, new)]);
        let message = refused(&folder, &[]);
        assert!(message.contains("wrong/scene.toml:"), "{message}");
        assert!(message.contains(reason), "{message}");
    }
    let folder = task(&scratch, "wrong", &[]);
    let (scene, limits) = (folder.join("scene.toml"), folder.join("safety.toml"));
    for file in [&scene, &limits] {
        let message = refused(&folder, &["--json", &text(file)]);
        assert!(message.contains("--task names the same"), "{message}");
    }
    let text = fs::read_to_string(&limits).unwrap();
    fs::write(
        &limits,
        text.replace("filter_m = 0.0015", "filter_m = -1.0"),
    )
    .unwrap();
    let message = refused(&folder, &[]);
    assert!(message.contains("wrong/safety.toml:"), "{message}");

    let taken = task(&scratch, "needle-lift", &[("hold_s", "hold_s = 0.1")]);
    let message = refused(&taken, &[]);
    assert!(
        message.contains("scene.toml is not that of the built-in task"),
        "{message}"
    );
}
