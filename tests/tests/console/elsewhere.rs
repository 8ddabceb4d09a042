//! Runs whose arms are in another process, as pages see them: cameras, the scene and how the task
//! stands come over topics.

use std::io::{BufRead as _, BufReader};
use std::path::Path;
use std::process::{Child, Stdio};

use serde_json::{Value, json};
use tests::{repository, scratch, trocar};
use trocar_log::RunLog;

use crate::browser::{SCENE as SCENE_SEEN, finds_what_is_faint, looks_right};
use crate::devtools::Browser;
use crate::intervention::{changes, driver};
use crate::lift::{say, scripted};
use crate::page::Page;
use crate::run::{SLOW_MOTION, Served, verified};
use crate::teleop::{Operator, engaged, rested, tip, way};

/// Where a page is told that everything in the scene is.
const SCENE: u8 = 255;

/// Time for the task, s: a test ends its run itself.
const LONG: [&str; 2] = ["--set", "scene.episode.time_limit_s=300"];

/// `trocar simulator` of a needle lift with one of its cameras, ended with its test.
struct Simulator {
    process: Child,
    topics: String,
}

impl Simulator {
    fn start(test: &str) -> Self {
        let topics = format!("test-{}-{test}", std::process::id());
        let mut command = trocar();
        command
            .env("TROCAR_SLOW_MOTION", SLOW_MOTION.to_string())
            .args(["simulator", "--task", "needle-lift", "--seed", "7"])
            .args(["--cameras", "endoscope", "--topics", &topics])
            .args(LONG)
            .stdout(Stdio::null())
            .stderr(Stdio::piped());
        let mut simulator = Self {
            process: command.spawn().unwrap(),
            topics,
        };
        let mut said = BufReader::new(simulator.process.stderr.take().unwrap());
        let mut line = String::new();
        while !line.contains("psm1 on topics") {
            line.clear();
            assert!(said.read_line(&mut line).unwrap() > 0, "no simulator");
        }
        std::thread::spawn(move || std::io::copy(&mut said, &mut std::io::sink()));
        simulator
    }

    /// A run that leads its arm, with a console.
    fn run(&self, test: &str, policy: &str, what: &[&str]) -> Served {
        let words = ["run", "--backend", "topics", "--topics", &self.topics];
        let policy = ["--policy", policy, "--seed", "7"];
        let words = [&words[..], &policy, what].concat();
        Served::start_slow(test, &words, SLOW_MOTION)
    }
}

impl Drop for Simulator {
    fn drop(&mut self) {
        let _gone = self.process.kill();
        let _reaped = self.process.wait();
    }
}

/// The place of `name` among the cameras that a page was told of.
fn place(facts: &Value, name: &str) -> u8 {
    let cameras = facts["cameras"].as_array().unwrap();
    let place = cameras.iter().position(|known| known == name);
    u8::try_from(place.unwrap()).unwrap()
}

/// The next picture of `camera`.
fn picture(page: &mut Page, camera: u8) -> Vec<u8> {
    loop {
        let picture = page.wait_for_picture();
        if picture[0] == camera {
            return picture;
        }
    }
}

/// How many visuals, cameras and bent shapes a message of the scene has.
fn counts(places: &[u8]) -> [u32; 3] {
    let count = |at: usize| places[at..at + 4].try_into().map(u32::from_le_bytes);
    [16, 20, 24].map(|at| count(at).unwrap())
}

fn shows_a_camera(page: &mut Page, camera: u8) {
    let picture = picture(page, camera);
    assert_eq!(picture[1], 0, "in colour");
    assert_eq!(picture[16..18], [0xff, 0xd8], "JPEG");
}

/// What a page of a simulated run sees, that of a run whose simulator is another process sees too.
#[test]
fn a_page_sees_the_world_of_another_process() {
    let _turn = tests::alone();
    let simulator = Simulator::start("console-world");
    let log = scratch("console-world-log").join("run.mcap");
    let task = ["--task", "needle-lift", "--log", log.to_str().unwrap()];
    let task = [&task[..], &LONG].concat();
    let mut served = simulator.run("console-world", "random", &task);
    let mut page = Page::open(&served);
    let facts = page.wait_for("facts", |_| true);
    assert_eq!(facts["title"], "needle-lift");
    assert_eq!(
        (&facts["scene"], &facts["time_limit_s"]),
        (&json!(true), &json!(300.0))
    );
    let endoscope = place(&facts, "endoscope");
    page.say(&json!({ "show": [[endoscope, "colour"], [SCENE, "colour"]] }));
    shows_a_camera(&mut page, endoscope);
    // After head and counts it has poses, of which the arm's change.
    let first = picture(&mut page, SCENE);
    while picture(&mut page, SCENE)[28..] == first[28..] {}
    let state = page.wait_for("state", |state| {
        state["criteria"]
            .as_array()
            .is_some_and(|all| all.len() > 1)
    });
    assert!(!state["task"].as_str().unwrap().is_empty(), "{state}");
    let criteria = state["criteria"].as_array().unwrap();
    let lasts = criteria.last().unwrap();
    assert_eq!(
        (&lasts["unit"], &lasts["met"]),
        (&json!("s"), &json!(false))
    );
    assert!(criteria.iter().all(|it| it["goal"].is_f64()), "{state}");
    has_in_its_scene(&served, &["needle", "left finger", "endoscope", "psm1"]);
    assert!(page.command("stop").0);
    page.wait_for("end", |_| true);
    assert_eq!(served.code(), 1);
    replays(&log);
    looks_as_the_world_did(&log);
}

/// The file of the scene that is shown has these parts; what it says.
fn has_in_its_scene(served: &Served, parts: &[&str]) -> String {
    let (host, cookie) = (served.host(), served.cookie());
    let headers = [("Host", host.as_str()), ("Cookie", cookie.as_str())];
    let scene = served.get("/scene.glb", &headers);
    for part in parts {
        assert!(scene.contains(&format!("\"name\":\"{part}\"")), "{part}");
    }
    scene
}

/// The log keeps every limit, and its commands are computed again bit for bit.
fn replays(log: &Path) {
    verified(log);
    let replay = trocar().arg("replay").arg(log).output().unwrap();
    assert!(replay.status.success(), "{}", tests::stderr(&replay));
}

/// The page on the log of a run whose world was another process shows what its own page did: where
/// everything was, and how the task stood.
fn looks_as_the_world_did(log: &Path) {
    let words = ["replay", log.to_str().unwrap()];
    let served = Served::start("console-world-replay", &words);
    let mut page = Page::open(&served);
    let facts = page.wait_for("facts", |_| true);
    assert_eq!(
        (&facts["scene"], &facts["time_limit_s"]),
        (&json!(true), &json!(300.0))
    );
    assert!(facts["drawn"].as_array().unwrap().contains(&json!("side")));
    has_in_its_scene(&served, &["needle", "left finger", "endoscope", "psm1"]);
    page.say(&json!({ "show": [[SCENE, "colour"]] }));
    let seconds = facts["seconds"].as_f64().unwrap();
    page.say(&json!({ "at": 0.1 }));
    let first = picture(&mut page, SCENE);
    page.say(&json!({ "at": seconds }));
    assert_ne!(
        picture(&mut page, SCENE)[16..],
        first[16..],
        "the arm moved"
    );
    page.say(&json!({ "at": seconds }));
    let state = page.wait_for("state", |_| true);
    let criteria = state["criteria"].as_array().unwrap();
    assert!(criteria.len() > 1 && criteria.iter().all(|it| it["goal"].is_f64()));
    assert!(!state["task"].as_str().unwrap().is_empty(), "{state}");
}

/// A robot has cameras, which are those that were asked for, and no criteria; its instrument is
/// seen where it is measured, with limits and cameras.
#[test]
fn a_page_sees_arm_and_cameras_of_a_robot() {
    let _turn = tests::alone();
    let simulator = Simulator::start("console-robot");
    let safety = repository().join("config/tasks/needle-lift/safety.toml");
    let log = scratch("console-robot-log").join("run.mcap");
    let what = [
        "--safety",
        safety.to_str().unwrap(),
        "--cameras",
        "endoscope",
        "--log",
        log.to_str().unwrap(),
    ];
    let mut served = simulator.run("console-robot", "random", &what);
    let mut page = Page::open(&served);
    // The scene comes with the first measurement.
    let facts = page.wait_for("facts", |facts| facts["scene"] == true);
    assert_eq!(facts["cameras"], json!(["endoscope"]));
    let scene = has_in_its_scene(&served, &["left finger", "shaft", "psm1", "endoscope"]);
    assert!(scene.contains("\"region\"") && !scene.contains("needle"));
    page.say(&json!({ "show": [[0, "colour"], [SCENE, "colour"]] }));
    shows_a_camera(&mut page, 0);
    let first = picture(&mut page, SCENE);
    assert_eq!(counts(&first), [4, 1, 0], "visuals, cameras, bent shapes");
    while picture(&mut page, SCENE)[28..] == first[28..] {}
    let state = page.wait_for_state("ENABLED");
    assert!(state["criteria"].is_null(), "{state}");
    marks_the_run(&mut page);
    assert!(page.command("stop").0);
    let end = page.wait_for("end", |_| true);
    let said = end["reason"].as_str().unwrap();
    assert!(
        said.contains("; marked discard, label \"camera fell\"; log: "),
        "{said}"
    );
    served.code();
    let said = &tests::json(&served.folder.join("result.json"))["said"];
    assert_eq!(said, &json!({ "mark": "discard", "label": "camera fell" }));
    replays(&log);
    shows_its_arm(&log);
    is_discarded(&log);
}

/// A person says how the run went, and otherwise a moment later; only the page that steers may.
fn marks_the_run(page: &mut Page) {
    page.say(&json!({ "mark": "success" }));
    let problem = page.wait_for("problem", |_| true);
    assert_eq!(
        problem["text"],
        "only the page that steers marks and labels the run: take control first"
    );
    page.say(&json!({ "steer": true }));
    page.wait_for("seat", |seat| seat["steers"] == true);
    let marked = |mark: &Value| {
        let mark = mark.clone();
        move |state: &Value| state["said"]["mark"] == mark
    };
    page.wait_for("state", marked(&Value::Null));
    for mark in [json!("success"), Value::Null, json!("discard")] {
        page.say(&json!({ "mark": mark }));
        page.wait_for("state", marked(&mark));
    }
    page.say(&json!({ "label": "camera fell" }));
    page.wait_for("state", |state| state["said"]["label"] == "camera fell");
}

/// No dataset is made of a run that its operator discarded, which is said in words.
fn is_discarded(log: &Path) {
    let out = scratch("console-robot-dataset").join("data");
    let mut command = trocar();
    command
        .args(["import", "log"])
        .arg(log)
        .args(["--task", "lift", "--failures", "--out"]);
    let output = command.arg(&out).output().unwrap();
    let said = tests::stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(
        said.contains("the operator has discarded all of the 1 runs"),
        "{said}"
    );
    assert_eq!(out.read_dir().map_or(0, Iterator::count), 0, "it is empty");
}

/// The page on a robot's log has its instrument where it was measured, with the limits, and neither
/// a needle nor criteria.
fn shows_its_arm(log: &Path) {
    let served = Served::start("console-robot-replay", &["replay", log.to_str().unwrap()]);
    let mut page = Page::open(&served);
    let facts = page.wait_for("facts", |_| true);
    assert_eq!(
        (&facts["scene"], &facts["cameras"], &facts["depth"]),
        (&json!(true), &json!(["endoscope"]), &json!([]))
    );
    let scene = has_in_its_scene(&served, &["left finger", "shaft", "psm1", "endoscope"]);
    assert!(scene.contains("\"region\"") && !scene.contains("needle"));
    page.say(&json!({ "show": [[SCENE, "colour"]] }));
    page.say(&json!({ "at": 0.0 }));
    let first = picture(&mut page, SCENE);
    page.say(&json!({ "at": facts["seconds"] }));
    assert_ne!(
        picture(&mut page, SCENE)[16..],
        first[16..],
        "the arm moved"
    );
    page.say(&json!({ "show": [[0, "colour"]] }));
    assert_eq!(picture(&mut page, 0)[17..20], *b"PNG");
    page.say(&json!({ "at": facts["seconds"] }));
    let state = page.wait_for("state", |_| true);
    assert!(state["criteria"].is_null() && state["task"].is_null());
    let (end, events) = (&facts["outcome"], facts["events"].as_array().unwrap());
    assert_eq!(end["said"], "marked discard, label \"camera fell\"");
    let told = |text: &str| {
        events
            .iter()
            .any(|event| event["text"].as_str().unwrap().contains(text))
    };
    for text in [
        "the operator marks the run: success",
        "the operator takes the mark of the run back",
        "the operator marks the run: discard",
        "; marked discard, label \"camera fell\"",
    ] {
        assert!(told(text), "{text}: {events:?}");
    }
}

/// The page of a robot in Chromium: its instrument is drawn and moves, and the run is marked by
/// keys and by a gamepad.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn the_page_shows_and_marks_the_run_of_a_robot() {
    let _turn = tests::alone();
    let simulator = Simulator::start("console-robot-browser");
    let safety = repository().join("config/tasks/needle-lift/safety.toml");
    let log = scratch("console-robot-browser-log").join("run.mcap");
    let what = [
        "--safety",
        safety.to_str().unwrap(),
        "--cameras",
        "endoscope",
    ];
    let what = [&what[..], &["--log", log.to_str().unwrap()]].concat();
    let mut served = simulator.run("console-robot-browser", "random", &what);
    let mut browser = Browser::open_with(
        "console-robot-browser-profile",
        &served.url(),
        &scripted("gamepad", ""),
    );
    browser.look(1280, "light");
    let stamp = "Number(document.querySelector('#scene-view').dataset.seconds)";
    browser.wait_until(&format!("{stamp} > 0"));
    let (before, seen) = (
        browser.evaluate(stamp).as_f64().unwrap(),
        browser.evaluate(SCENE_SEEN),
    );
    browser.wait_until(&format!("{stamp} > {before} + 1"));
    browser.wait_until(&format!("({SCENE_SEEN})[1] !== {}", seen[1]));
    assert!(seen[0].as_u64() > Some(100), "{seen}");
    let mark = "document.querySelector('[data-mark][aria-pressed=true]')?.dataset.mark ?? ''";
    browser.wait_until("!document.querySelector('[data-mark]').disabled");
    for (key, expected) in [
        ("y", "success"),
        ("z", "failure"),
        ("z", ""),
        ("x", "discard"),
        ("y", "success"),
    ] {
        browser.press(key);
        browser.wait_until(&format!("({mark}) === '{expected}'"));
    }
    // A gamepad's buttons are those of the page, though hands do not move this robot.
    for (button, expected) in [
        ("discard", "discard"),
        ("redo", "failure"),
        ("keep", "success"),
        ("keep", ""),
        ("keep", "success"),
    ] {
        say(&mut browser, button, &format!("({mark}) === '{expected}'"));
    }
    browser.evaluate("(() => { const label = document.querySelector('#mark-label'); label.value = 'third try'; label.dispatchEvent(new Event('input')); })()");
    looks_right(&mut browser, "robot");
    finds_what_is_faint(&mut browser);
    browser.press("s");
    browser.wait_until("document.querySelector('#banner').textContent.includes('marked success, label \"third try\"')");
    browser
        .wait_until("document.querySelector('#banner').textContent.includes('trocar import log')");
    assert_eq!(browser.errors, Vec::<String>::new());
    served.code();
}

/// The hand is taken, and rises: so does the tip, which did not jump before.
fn rises(operator: &mut Operator) {
    let start = rested(&mut operator.page);
    operator.engage();
    assert!(way(tip(&operator.repeat(3)), start) < 1e-4, "no jump");
    operator.rise(9);
    let risen = tip(&operator.settle());
    assert!(risen[1] - start[1] > 0.004, "{start:?} {risen:?}");
}

/// The operator's stop ends the run, whose log is of a run by hand that kept every limit and
/// replays.
fn ends(mut served: Served, mut page: Page, log: &Path) -> Value {
    assert!(page.command("stop").0);
    page.wait_for("end", |_| true);
    served.code();
    verified(log);
    let replay = trocar().arg("replay").arg(log).output().unwrap();
    assert!(replay.status.success(), "{}", tests::stderr(&replay));
    let teleop = tests::json(&served.folder.join("result.json"))["teleop"].clone();
    let kept = RunLog::open(log).unwrap().outcome.unwrap().teleop.unwrap();
    let kept: Value = serde_json::from_str(&kept).unwrap();
    assert_eq!(kept, teleop, "the log says the same");
    assert_eq!(teleop["device"], "page");
    teleop
}

/// Hands move the arm of a task in another process as they do one of the run's own, in the axes of
/// its picture.
#[test]
fn hands_move_the_arm_of_another_process() {
    let _turn = tests::alone();
    let simulator = Simulator::start("console-hands");
    let log = scratch("console-hands-log").join("run.mcap");
    let what = ["--task", "needle-lift", "--log", log.to_str().unwrap()];
    let served = simulator.run("console-hands", "teleop", &[&what[..], &LONG].concat());
    let mut page = Page::open(&served);
    let facts = page.wait_for("facts", |_| true);
    let endoscope = place(&facts, "endoscope");
    assert_eq!(facts["picture"]["camera"], endoscope, "{facts}");
    let mut operator = Operator::take_control(page);
    operator.until(|state| state["seconds"].as_f64() > Some(0.3));
    rises(&mut operator);
    let teleop = ends(served, operator.page, &log);
    assert!(teleop["engagements"].as_u64() > Some(0), "{teleop}");
}

/// A robot without a task is moved in the axes that were told, beside its policy: hands take over
/// and hand back.
#[test]
fn hands_take_over_from_the_policy_of_a_robot() {
    let _turn = tests::alone();
    let simulator = Simulator::start("console-beside");
    let safety = repository().join("config/tasks/needle-lift/safety.toml");
    let log = scratch("console-beside-log").join("run.mcap");
    let what = [
        "--safety",
        safety.to_str().unwrap(),
        "--hands-view",
        "psm1=25,0,15",
        "--log",
        log.to_str().unwrap(),
    ];
    let served = simulator.run("console-beside", "random", &what);
    let mut operator = Operator::take_control(Page::open(&served));
    let state = operator.repeat(5);
    assert_eq!(driver(&state), "policy", "{state}");
    operator.engage();
    let state = operator.until(|state| driver(state) == "operator");
    assert!(engaged(&state), "{state}");
    rises(&mut operator);
    operator.page.say(&json!({ "hand_back": true }));
    let back = |state: &Value| driver(state) == "policy";
    operator.page.wait_for("state", back);
    let state = operator.repeat(10);
    assert!(back(&state) && !engaged(&state), "{state}");
    let moved = tip(&state);
    operator.until(|state| way(tip(state), moved) > 0.002);
    let teleop = ends(served, operator.page, &log);
    let interventions = &teleop["interventions"];
    let counts = ["taken_over", "handed_back"].map(|what| interventions[what].as_u64());
    assert_eq!(counts, [Some(1), Some(1)], "{interventions}");
    assert_eq!(
        changes(&log),
        ["Enable", "TakeOver", "HandBack", "Pause", "Disable"]
    );
}
