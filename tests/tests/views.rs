//! Needles, views and cameras from the command line to the result, the log and the dataset; and the
//! contact sheet.

#![expect(
    clippy::unwrap_used,
    reason = "in a test, a failure to set up is a failure"
)]

use std::fs;
use std::path::Path;

use tests::{json, scratch, stderr, trocar};
use trocar_log::RunLog;

/// Runs `trocar`, expects success, and gives what it printed.
fn done(arguments: &[&str]) -> String {
    let output = trocar().args(arguments).output().unwrap();
    assert!(
        output.status.success(),
        "{arguments:?}: {}",
        stderr(&output)
    );
    String::from_utf8_lossy(&output.stdout).into_owned()
}

/// Width and height of a PNG file.
fn png_size(path: &Path) -> [u32; 2] {
    let bytes = fs::read(path).unwrap();
    assert_eq!(&bytes[1..4], b"PNG");
    [16, 20].map(|at| u32::from_be_bytes(bytes[at..at + 4].try_into().unwrap()))
}

const EXPERT: [&str; 5] = ["--task", "needle-lift", "--policy", "expert", "--seed"];

/// Needle and view are in result and log and only the asked camera is.
#[test]
fn needle_and_view_are_in_result_and_log() {
    let folder = scratch("needle-and-view");
    let (log, result) = (folder.join("run.mcap"), folder.join("run.json"));
    let paths = [&log, &result].map(|path| path.display().to_string());
    let scene = [
        "--needle",
        "N3",
        "--view",
        "view1",
        "--cameras",
        "wrist",
        "--log",
        &paths[0],
        "--json",
        &paths[1],
    ];
    done(&[&["run", "--lockstep"], &EXPERT[..], &["3"], &scene[..]].concat());
    let told = json(&result);
    assert_eq!(
        (&told["needle"], &told["view"]),
        (&"N3".into(), &"view1".into())
    );
    let header = RunLog::open(&log).unwrap().header;
    assert_eq!(
        (header.needle.as_deref(), header.view.as_str()),
        (Some("N3"), "view1")
    );
    // Topic names stand uncompressed at the end of a log.
    let bytes = fs::read(&log).unwrap();
    let has = |topic: &str| {
        bytes
            .windows(topic.len())
            .any(|part| part == topic.as_bytes())
    };
    assert!(has("/camera/wrist/pose") && has("/camera/wrist/calibration"));
    assert!(!has("/camera/endoscope") && !has("/camera/side"));
    assert!(done(&["replay", &paths[0]]).contains("identical"));
    assert!(done(&["verify", &paths[0]]).contains("ok"));
}

/// Evaluations tell needle and view and only the needle changes the expert's commands.
#[test]
fn evaluation_results_name_needle_and_view() {
    let folder = scratch("evaluated-views");
    let eval = |name: &str, scene: &[&str]| {
        let result = folder.join(name);
        let path = result.display().to_string();
        let counts = ["3", "--trials", "1", "--json", &path];
        done(&[&["eval"], &EXPERT[..], &counts[..], scene].concat());
        json(&result)
    };
    let hash = |result: &serde_json::Value| result["episodes"][0]["command_hash"].to_string();
    let plain = eval("plain.json", &[]);
    assert_eq!(
        (&plain["needle"], &plain["view"]),
        (&"N1".into(), &"train".into())
    );
    let seen = eval("view2.json", &["--view", "view2", "--needle", "N1"]);
    assert_eq!(
        (&seen["needle"], &seen["view"]),
        (&"N1".into(), &"view2".into())
    );
    assert_eq!(hash(&plain), hash(&seen));
    let other = eval("n2.json", &["--needle", "N2"]);
    assert_eq!(other["needle"], "N2");
    assert_ne!(hash(&plain), hash(&other));
}

#[test]
fn a_dataset_holds_the_cameras_that_were_asked_for() {
    let folder = scratch("recorded-cameras");
    let (out, result) = (folder.join("demos"), folder.join("record.json"));
    let paths = [&out, &result].map(|path| path.display().to_string());
    done(&[
        "record",
        "--task",
        "needle-lift",
        "--episodes",
        "1",
        "--cameras",
        "multi",
        "--needle",
        "N2",
        "--out",
        &paths[0],
        "--json",
        &paths[1],
    ]);
    let told = json(&result);
    assert_eq!(told["cameras"], serde_json::json!(["endoscope", "wrist"]));
    assert_eq!(told["needle"], "N2");
    let features = json(&out.join("meta/info.json"))["features"].clone();
    let has = |name: &str| !features[&format!("observation.images.{name}")].is_null();
    assert!(
        has("endoscope") && has("wrist") && !has("side"),
        "{features}"
    );
}

#[test]
fn a_sheet_shows_the_tasks_that_were_asked_for() {
    let file = scratch("sheet").join("new/sheet.png");
    let path = file.display().to_string();
    let said = done(&[
        "sheet",
        "--task",
        "block-transfer",
        "--width",
        "24",
        "--at",
        "0.1",
        "--out",
        &path,
    ]);
    assert!(said.contains("sheet.png"), "{said}");
    let [width, height] = png_size(&file);
    assert!(width >= 3 * 24 && height >= 3 * 24, "{width} x {height}");
}

/// Runs `trocar`, expects exit code 2, and gives the message.
fn refused(arguments: &[&str]) -> String {
    let output = trocar().args(arguments).output().unwrap();
    let message = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {message}");
    message
}

#[test]
fn needle_view_and_camera_that_a_task_has_not_are_refused() {
    let run = ["run", "--policy", "expert", "--lockstep", "--task"];
    for (task, option, value, said) in [
        ("needle-lift", "--needle", "N9", "it has N1, N2, N3, N4, N5"),
        ("block-transfer", "--needle", "N1", "no choice of needles"),
        ("needle-lift", "--view", "view3", "view1"),
    ] {
        let message = refused(&[&run[..], &[task, option, value]].concat());
        assert!(
            message.contains(option) && message.contains(said),
            "{message}"
        );
    }
    let out = scratch("unknown-camera").join("demos");
    let path = out.display().to_string();
    let record = ["record", "--task", "needle-lift", "--episodes", "1"];
    let message = refused(&[&record[..], &["--cameras", "fly", "--out", &path]].concat());
    assert!(
        message.contains("--cameras fly") && message.contains("endoscope, side, wrist"),
        "{message}"
    );
    assert!(!out.exists());
}

#[test]
fn sheet_of_a_strange_size_moment_or_place_is_refused() {
    let file = scratch("bad-sheet").join("file.png");
    fs::write(&file, "a file").unwrap();
    let (file, below) = (file.display().to_string(), file.join("sheet.png"));
    let below = below.display().to_string();
    for (out, option, value) in [
        (&file, "--width", "0"),
        (&file, "--width", "100000"),
        (&file, "--at", "1.5"),
        (&file, "--at", "nan"),
        (&file, "--task", "tonsils"),
        (&file, "--needle", "N9"),
        (&below, "--out", ""),
    ] {
        let mut arguments = vec!["sheet", "--out", out];
        if !value.is_empty() {
            arguments.extend([option, value]);
        }
        let message = refused(&arguments);
        assert!(message.contains(option), "{message}");
    }
    assert_eq!(fs::read_to_string(file).unwrap(), "a file");
}
