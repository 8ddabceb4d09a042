//! Devices at the robot's computer as hands: recorded events of a keyboard, through a pipe.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;
use trocar::rt::sleep_ns;

use crate::intervention::{changes, driver};
use crate::page::Page;
use crate::run::{Served, verified};
use crate::teleop::{engaged, refused, rested, tip, way};

/// `EV_KEY` of the kernel, and some of its keys.
const KEY: u16 = 1;
const F: u16 = 33;
const UP: u16 = 103;
const B: u16 = 48;

/// A keyboard of which nothing but its events is there.
struct Keyboard(File);

impl Keyboard {
    /// A `struct input_event`: its time, which nobody reads, kind, code and value.
    fn tell(&mut self, code: u16, value: i32) {
        let mut bytes = vec![0; 16];
        bytes.extend(KEY.to_ne_bytes());
        bytes.extend(code.to_ne_bytes());
        bytes.extend(value.to_ne_bytes());
        self.0.write_all(&bytes).unwrap();
    }
}

fn pipe(path: &Path) {
    assert!(Command::new("mkfifo").arg(path).status().unwrap().success());
}

/// The tip rises while both keys are held and holds when the clutch is let go; a keyboard that is
/// unplugged in mid-motion lets go. A page beside it looks on and moves nothing.
#[test]
fn a_keyboard_at_the_robot_moves_the_arm() {
    let _turn = tests::alone();
    let folder = tests::scratch("teleop-desk-files");
    let (keys, log) = (folder.join("keyboard"), folder.join("run.mcap"));
    pipe(&keys);
    let words = [
        "run",
        "--task",
        "needle-lift",
        "--policy",
        "teleop",
        "--seed",
        "7",
    ];
    let files = [
        "--hands",
        keys.to_str().unwrap(),
        "--log",
        log.to_str().unwrap(),
    ];
    let mut served = Served::start_slow("teleop-desk", &[&words[..], &files].concat(), 4);
    let mut keyboard = Keyboard(OpenOptions::new().write(true).open(&keys).unwrap());
    let mut page = Page::open(&served);
    page.say(&serde_json::json!({ "steer": true }));
    page.wait_for_state("ENABLED");
    let start = rested(&mut page);
    keyboard.tell(UP, 1);
    assert!(way(rested(&mut page), start) < 1e-5, "without the clutch");
    keyboard.tell(F, 1);
    page.wait_for("state", |state| {
        engaged(state) && tip(state)[1] > start[1] + 0.003
    });
    let hands = serde_json::json!({ "hands": { "t": 1, "arms": [{ "clutch": true, "at": [0, 0, 0], "turn": [0, 0, 0, 1], "jaw": 0 }] } });
    page.say(&hands);
    let problem = page.wait_for("problem", |_| true);
    assert!(
        problem["text"].as_str().unwrap().contains("--hands"),
        "{problem}"
    );
    keyboard.tell(F, 0);
    let risen = rested(&mut page);
    assert!(risen[1] > start[1] + 0.003 && (risen[0] - start[0]).abs() < 1e-3);

    keyboard.tell(F, 1);
    page.wait_for("state", |state| {
        engaged(state) && tip(state)[1] > risen[1] + 0.002
    });
    drop(keyboard);
    page.wait_for("state", |state| {
        let lost = state["teleop"]["arms"][0]["lost"].as_str();
        !engaged(state) && lost.is_some_and(|lost| lost.contains("disconnected"))
    });
    rested(&mut page);
    assert!(page.command("stop").0);
    page.wait_for("end", |_| true);
    assert_eq!(served.code(), 1);
    let result = tests::json(&served.folder.join("result.json"));
    assert_eq!(result["teleop"]["device"], "input_device");
    verified(&log);
}

#[test]
fn a_device_that_is_not_there_is_an_error() {
    let run = ["run", "--task", "needle-lift", "--policy"];
    let device = ["--hands", "/dev/input/event9999"];
    refused(
        &[&run[..], &["teleop"], &device].concat(),
        "--hands /dev/input/event9999: No such file",
    );
    for (policy, more, reason) in [
        (
            "expert",
            &["--lockstep"][..],
            "--hands: --lockstep has virtual time",
        ),
        ("expert", &[], "--hands /dev/input/event9999: No such file"),
        (
            "teleop",
            &["--lockstep"],
            "--policy teleop: --lockstep has virtual time",
        ),
    ] {
        refused(&[&run[..], &[policy], &device, more].concat(), reason);
    }
    let robot = [
        "run",
        "--backend",
        "topics",
        "--safety",
        "none.toml",
        "--policy",
        "noop",
    ];
    refused(
        &[&robot[..], &device].concat(),
        "--hands: of a robot without a task it needs --hands-view",
    );
    let record = [
        "record",
        "--task",
        "needle-lift",
        "--episodes",
        "1",
        "--out",
        "none",
    ];
    for (source, reason) in [
        (
            &["--source", "expert"][..],
            "--hands needs --source teleop or intervention",
        ),
        (
            &["--source", "intervention"],
            "--source intervention needs --policy",
        ),
        (
            &["--source", "intervention", "--policy", "expert"],
            "--hands /dev/input/event9999: No such file",
        ),
    ] {
        refused(&[&record[..], source, &device].concat(), reason);
    }
}

/// A keyboard at the robot's computer takes over from a policy in mid-motion and moves the arm; B
/// gives it back, and a clutch that is held meanwhile has to be taken anew.
#[test]
fn a_keyboard_takes_over_from_a_policy() {
    let _turn = tests::alone();
    let folder = tests::scratch("intervention-desk-files");
    let (keys, log) = (folder.join("keyboard"), folder.join("run.mcap"));
    pipe(&keys);
    let words = [
        "run",
        "--task",
        "needle-lift",
        "--policy",
        "expert",
        "--seed",
        "7",
    ];
    let files = [
        "--hands",
        keys.to_str().unwrap(),
        "--log",
        log.to_str().unwrap(),
    ];
    let mut served = Served::start_slow("intervention-desk", &[&words[..], &files].concat(), 4);
    let mut keyboard = Keyboard(OpenOptions::new().write(true).open(&keys).unwrap());
    let mut page = Page::open(&served);
    page.say(&serde_json::json!({ "steer": true }));
    let moves = |state: &Value| {
        let velocity = state["arms"][0]["commanded_velocity"].as_array().unwrap();
        velocity
            .iter()
            .any(|axis| axis.as_f64().unwrap().abs() > 0.02)
    };
    let state = page.wait_for("state", moves);
    assert_eq!(driver(&state), "policy");
    keyboard.tell(F, 1);
    page.wait_for("state", |state| {
        driver(state) == "operator" && engaged(state)
    });
    let taken = rested(&mut page);
    keyboard.tell(UP, 1);
    page.wait_for("state", |state| tip(state)[1] > taken[1] + 0.003);
    keyboard.tell(UP, 0);
    rested(&mut page);
    keyboard.tell(B, 1);
    let state = page.wait_for("state", |state| driver(state) == "policy");
    assert!(!engaged(&state), "{state}");
    let state = page.wait_for("state", moves);
    assert!(driver(&state) == "policy" && !engaged(&state), "{state}");
    assert!(page.command("stop").0);
    page.wait_for("end", |_| true);
    assert_eq!(served.code(), 1);
    let result = tests::json(&served.folder.join("result.json"));
    let interventions = &result["teleop"]["interventions"];
    let counts = ["taken_over", "handed_back"].map(|what| interventions[what].as_u64());
    assert_eq!(counts, [Some(1), Some(1)], "{interventions}");
    assert_eq!(changes(&log)[..3], ["Enable", "TakeOver", "HandBack"]);
    verified(&log);
}

/// Without a page too: whoever takes the clutch again and again, and hands back, has taken over.
#[test]
fn hands_at_the_robot_need_no_page() {
    let _turn = tests::alone();
    let folder = tests::scratch("intervention-desk-alone");
    let (keys, result) = (folder.join("keyboard"), folder.join("result.json"));
    pipe(&keys);
    let words = "run --task needle-lift --policy noop --no-log --set scene.episode.time_limit_s=3";
    let mut run = tests::trocar()
        .args(words.split(' '))
        .arg("--hands")
        .arg(&keys)
        .arg("--json")
        .arg(&result)
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    // Open at both ends, so that nothing waits for a run that has ended.
    let pipe = OpenOptions::new().read(true).write(true).open(&keys);
    let mut keyboard = Keyboard(pipe.unwrap());
    let code = loop {
        if let Some(status) = run.try_wait().unwrap() {
            break status.code();
        }
        for (key, value) in [(F, 1), (F, 0), (B, 1), (B, 0)] {
            keyboard.tell(key, value);
            sleep_ns(60_000_000);
        }
    };
    assert_eq!(code, Some(1), "nothing is lifted");
    let interventions = &tests::json(&result)["teleop"]["interventions"];
    let counts = ["taken_over", "handed_back"].map(|what| interventions[what].as_u64());
    assert!(
        counts.iter().all(|count| *count > Some(0)),
        "{interventions}"
    );
}
