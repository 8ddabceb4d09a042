//! Devices at the robot's computer as hands: recorded events of a keyboard, through a pipe.

use std::fs::{File, OpenOptions};
use std::io::Write as _;
use std::path::Path;
use std::process::Command;

use crate::page::Page;
use crate::run::{Served, verified};
use crate::teleop::{engaged, refused, rested, tip, way};

/// `EV_KEY` of the kernel, and some of its keys.
const KEY: u16 = 1;
const F: u16 = 33;
const UP: u16 = 103;

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

/// The tip rises while both keys are held and holds when the clutch is let go; a keyboard that is unplugged in mid-motion lets go. A page
/// beside it looks on and moves nothing.
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
    refused(&[&run[..], &["expert"], &device].concat(), "--hands needs");
}
