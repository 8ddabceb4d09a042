//! A scripted operator in the browser lifts the needle: by gamepad, by keyboard, in a headset. It
//! sees what the page is told, and moves nothing but its device.

use std::path::Path;

use hal::{PerArm, Pose, TipTarget};
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use serde_json::{Value, json};
use tch::Device;
use tests::{json as read_json, scratch, stderr, trocar};
use trocar::session::episode::{Episode, EpisodeObserver, StepView, Timing};
use trocar::session::latency::Latency;
use trocar::session::{Plan, PolicyChoice, SessionError};
use trocar_tasks::simulation::{Rendering, Simulation};

use crate::devices::{Tip, near};
use crate::devtools::Browser;
use crate::run::{Served, verified};

pub(crate) const SEED: &str = "7";

/// How many times slower than the machine's the clocks of the run are: it shares two cores with the
/// browser.
pub(crate) const SLOW_MOTION: u64 = 3;

/// The devices and the operator, before any script of the page.
const OPERATOR: &str = include_str!("operator.js");

/// What the expert wants of the tips.
#[derive(Default)]
struct Targets(Vec<PerArm<TipTarget>>);

impl EpisodeObserver for Targets {
    fn step(&mut self, view: &StepView<'_>) -> Result<(), SessionError> {
        if let Some(chunks) = view.answer {
            let targets = chunks.as_ref().map(|chunk| chunk.valid_targets()[0]);
            self.0.push(targets);
        }
        Ok(())
    }
}

/// What the expert does in the episode [`SEED`] of `task`.
pub(crate) struct Shown {
    plan: Plan,
    /// Where it wants the tips, by policy step.
    pub(crate) targets: Vec<PerArm<TipTarget>>,
}

impl Shown {
    pub(crate) fn of(task: &str) -> Self {
        let plan = Plan::load(task, PolicyChoice::Expert).unwrap();
        let setup = &plan.setup;
        let seed = SEED.parse().unwrap();
        let mut targets = Targets::default();
        let episode = Episode {
            simulation: &mut Simulation::new(&setup.task, seed, Rendering::Off).unwrap(),
            controller: &mut setup.controller().unwrap(),
            source: &mut setup
                .source(&PolicyChoice::Expert, seed, Device::Cpu)
                .unwrap(),
        };
        let timing = Timing {
            latency: Latency::fixed(0),
            tick_limit: 20_000,
        };
        episode.run(&timing, &mut targets).unwrap();
        Self {
            plan,
            targets: targets.0,
        }
    }

    /// Where the tip of an arm is in the scene, if it is at `target`, `raised_m` higher.
    pub(crate) fn in_scene(&self, arm: usize, target: &TipTarget, raised_m: f64) -> Pose {
        let scene_from_rcm = self.plan.setup.task.arms[arm].scene_from_rcm;
        Translation3::new(0.0, 0.0, raised_m) * scene_from_rcm * target.tip_in_rcm()
    }

    /// A place on an operator's way: which arm's tip is to be there, in the picture's axes, and how
    /// far the trigger is pressed then.
    pub(crate) fn place(&self, arm: usize, tip_in_scene: &Pose, jaw: f64) -> Value {
        let tip = scene_from_view(&self.plan).inverse() * tip_in_scene;
        json!({ "arm": arm, "tip": TipTarget::new(&tip, 0.0).pose_numbers(), "jaw": jaw })
    }
}

/// Where the tip goes, as the picture shows it, and how far the trigger is pressed: above the
/// needle, to where the expert grips it, up again.
fn way_to_lift() -> Value {
    let shown = Shown::of("needle-lift");
    let firsts = shown.targets.iter().map(|targets| targets.first);
    let height = |target: &TipTarget| target.position_m[2];
    let lowest = firsts.min_by(|a, b| height(a).total_cmp(&height(b)));
    let grasp = lowest.unwrap();
    let place = |raised_m, jaw| shown.place(0, &shown.in_scene(0, &grasp, raised_m), jaw);
    json!([
        place(0.02, 0.0),
        place(0.0, 0.0),
        place(0.0, 1.0),
        place(0.035, 1.0),
    ])
}

/// The picture's axes from what the scene file says of the endoscope: x to the right, y up, z
/// towards the viewer.
fn scene_from_view(plan: &Plan) -> Isometry3<f64> {
    let task = &plan.setup.task;
    let camera = task
        .cameras
        .iter()
        .find(|camera| camera.name == "endoscope")
        .unwrap();
    let [eye, target, up] = [camera.eye_m, camera.target_m, camera.up].map(Vector3::from);
    let ahead = (target - eye).normalize();
    let right = ahead.cross(&up).normalize();
    let axes = Matrix3::from_columns(&[right, right.cross(&ahead), -ahead]);
    let turn = UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(axes));
    Isometry3::from_parts(eye.into(), turn)
}

/// What the page says of the episode, by an expression.
const EPISODE: &str = "document.querySelector('#episode-state').textContent";

/// What runs before the scripts of a page whose operator has `device` in hand, after `runtime`.
pub(crate) fn scripted(device: &str, runtime: &str) -> String {
    format!("{runtime}\n{OPERATOR}\nwindow.device = {};", json!(device))
}

/// A page whose operator has `device` in hand, once it steers an arm that is enabled.
pub(crate) fn operated(test: &str, served: &Served, device: &str) -> Browser {
    operated_with(test, served, device, "")
}

/// The same, in which `runtime` runs before all other scripts.
pub(crate) fn operated_with(test: &str, served: &Served, device: &str, runtime: &str) -> Browser {
    let script = scripted(device, runtime);
    let mut browser = Browser::open_with(&format!("{test}-profile"), &served.url(), &script);
    browser.look(1280, "light");
    browser.wait_until("document.querySelector('.chip')?.dataset.state === 'ENABLED'");
    browser.wait_until("document.querySelector('#steer').getAttribute('aria-pressed') === 'true'");
    browser.wait_until(
        "!document.querySelector('#teleop').hidden && window.told?.teleop.arms[0].tip != null",
    );
    browser
}

pub(crate) fn lift(browser: &mut Browser) {
    for place in way_to_lift().as_array().unwrap() {
        browser.evaluate(&format!("operator.follow([{place}]), true"));
        browser.wait_until(
            "operator.done || /Success|recorded/.test(document.querySelector('#banner').textContent)",
        );
    }
}

/// Holds the button of the device that says `what` until an expression is true, and lets it go.
pub(crate) fn say(browser: &mut Browser, what: &str, comes: &str) {
    browser.evaluate(&format!("operator.say('{what}', true)"));
    browser.wait_until(comes);
    browser.evaluate(&format!("operator.say('{what}', false)"));
}

/// Starts the episode that waits, by the device alone.
fn start(browser: &mut Browser) {
    browser.wait_until("!document.querySelector('[data-episode=start]').disabled");
    say(browser, "start", &says("is recorded"));
}

/// Begins the same episode again, by the device alone.
pub(crate) fn redo(browser: &mut Browser) {
    say(browser, "redo", &says("waits for its start"));
    start(browser);
}

/// Whether the page says so of the episode.
fn says(words: &str) -> String {
    format!("{EPISODE}.includes('{words}')")
}

/// Puts the headset on, which shows how the episode stands, and starts it.
pub(crate) fn start_in_headset(browser: &mut Browser) {
    browser.wait_until("!document.querySelector('#enter-vr').hidden");
    browser.evaluate(
        "operator.eyes = true, operator.compares = false, document.querySelector('#enter-vr').click()",
    );
    browser.wait_until("document.querySelector('#enter-vr-text').textContent.startsWith('Leave')");
    browser.wait_until(&says("waits for its start"));
    browser.wait_until(&format!("written.has({EPISODE})"));
    start(browser);
    browser.wait_until(&format!("written.has({EPISODE})"));
}

/// A controller that is not tracked in mid-motion lets go and the arm rests; one that comes back
/// with its squeeze held moves nothing.
pub(crate) fn loses_tracking(browser: &mut Browser) {
    browser.evaluate("operator.lose([0, 1, 0]).then(() => true)");
    browser.wait_until("!told.teleop.arms[0].engaged && told.arms[0].commanded_velocity.every((v) => Math.abs(v) < 1e-4)");
    let rest = Tip::rested(browser);
    browser.evaluate("operator.tracked = true, new Promise((done) => setTimeout(done, 500))");
    near(rest.way(&Tip::rested(browser)), [0.0; 3], 1e-5);
    assert_eq!(browser.evaluate("told.teleop.arms[0].engaged"), false);
    browser.evaluate("operator.rest(), true");
}

pub(crate) fn wait_for_end(browser: &mut Browser, words: &str) {
    let told = format!("document.querySelector('#banner').textContent.includes('{words}')");
    browser.wait_until(&told);
    let errors = std::mem::take(&mut browser.errors);
    assert_eq!(errors, Vec::<String>::new());
}

/// By gamepad alone, its buttons too, a needle is lifted in the second attempt: the first is thrown
/// away and done again. The dataset says who did it and how late the hand was, and can be trained
/// on.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn a_gamepad_lifts_the_needle_and_the_dataset_trains() {
    let _turn = tests::alone();
    let folder = scratch("teleop-gamepad-data");
    let data = folder.join("data");
    let mut served = Served::start_slow("teleop-gamepad", &record_to(&data), SLOW_MOTION);
    let mut browser = operated("teleop-gamepad", &served, "gamepad");
    does_not_start_with_the_clutch(&mut browser);
    start(&mut browser);
    say(&mut browser, "redo", &says("waits for its start"));
    browser.wait_until("!document.querySelector('[data-episode=start]').disabled");
    browser.screenshot(&folder.join("waiting.png"));
    start(&mut browser);
    label(&mut browser, "second try");
    assert_eq!(browser.evaluate(&says("is recorded")), true);
    lift(&mut browser);
    wait_for_end(&mut browser, "1 episodes are recorded");
    assert_eq!(served.code(), 0);
    let result = read_json(&served.folder.join("result.json"));
    assert_eq!(result["episodes"], 1);
    let attempts = result["attempts"].as_array().unwrap();
    let reasons: Vec<_> = attempts.iter().map(|attempt| &attempt["reason"]).collect();
    assert_eq!(reasons, [&json!("to be done again"), &json!("success")]);
    assert_eq!(attempts[0]["seed"], attempts[1]["seed"]);
    says_who_and_trains(&folder, &data, &json!("second try"));
}

/// Before the start the hand moves nothing. While it holds its clutch the button does not start the
/// episode, nor does one that goes on being held.
fn does_not_start_with_the_clutch(browser: &mut Browser) {
    browser.wait_until(&says("waits for its start"));
    browser.wait_until("!document.querySelector('[data-episode=start]').disabled");
    let before = browser.evaluate("told.teleop.arms[0].tip");
    browser.evaluate("operator.hold(true), operator.push([1, 0, 0]), operator.say('start', true)");
    browser.evaluate("new Promise((done) => setTimeout(done, 1000))");
    assert_eq!(browser.evaluate("told.teleop.arms[0].tip"), before);
    browser.evaluate("operator.rest(), new Promise((done) => setTimeout(done, 500))");
    assert_eq!(browser.evaluate(&says("waits for its start")), true);
    browser.evaluate("operator.say('start', false)");
}

/// Writes the episode's label, whose letters are no keys of the page.
fn label(browser: &mut Browser, text: &str) {
    browser.evaluate(&format!(
        "(() => {{ const field = document.querySelector('#label'); field.focus(); field.value = {}; field.dispatchEvent(new Event('input')); }})()",
        json!(text)
    ));
    browser.wait_until(&format!("told.teleop.label === {}", json!(text)));
    for key in ["x", "p", "s", "z", "y"] {
        browser.press(key);
    }
    browser.press("Enter");
    assert_eq!(browser.evaluate("document.activeElement.id"), "");
    browser.evaluate("new Promise((done) => setTimeout(done, 500))");
    assert_eq!(browser.evaluate("told.arms[0].state"), "ENABLED");
}

/// What the dataset in `data` says of its one episode, its label among it; some steps of training
/// on it.
fn says_who_and_trains(folder: &Path, data: &Path, label: &Value) {
    let note = std::fs::read_to_string(data.join("meta/trocar_episodes.jsonl")).unwrap();
    let note: Value = serde_json::from_str(note.trim()).unwrap();
    assert_eq!(
        (&note["source"], &note["ended_by"]),
        (&json!("teleop"), &json!("judge"))
    );
    assert_eq!(&note["label"], label);
    let latency = &note["teleop"]["hand_to_command_ms"];
    assert!(
        latency["p50"].as_f64() > Some(0.0) && latency["p99"].as_f64() > Some(0.0),
        "{note}"
    );
    let shown = &note["teleop"]["camera_to_page_ms"];
    assert!(
        shown["p50"].as_f64() > Some(0.0) && shown["p99"].as_f64() >= shown["p95"].as_f64(),
        "{note}"
    );
    let output = trocar()
        .args([
            "train",
            "--policy",
            "act",
            "--preset",
            "small",
            "--threads",
            "1",
        ])
        .args([
            "--steps",
            "2",
            "--batch",
            "2",
            "--data",
            data.to_str().unwrap(),
        ])
        .arg("--out")
        .arg(folder.join("policy"))
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", stderr(&output));
    assert!(folder.join("policy/model.safetensors").is_file());
}

/// By keyboard alone, after the page was hidden and reloaded in mid-motion: each time the arm came
/// to rest.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn a_keyboard_lifts_the_needle() {
    let _turn = tests::alone();
    let folder = scratch("teleop-keyboard-pictures");
    let log = folder.join("run.mcap");
    let mut served = Served::start_slow("teleop-keyboard", &run_to(&log), SLOW_MOTION);
    let mut browser = operated("teleop-keyboard", &served, "keyboard");
    for (loss, said) in [
        (
            "Object.defineProperty(document, 'hidden', { value: true, configurable: true }), document.dispatchEvent(new Event('visibilitychange')), true",
            "was hidden",
        ),
        ("location.reload(), true", ""),
    ] {
        engage_and_push(&mut browser);
        browser.evaluate(loss);
        if !said.is_empty() {
            browser.wait_until(&format!("told.teleop.arms[0].lost?.includes('{said}')"));
        }
        browser.wait_until("window.told && !told.teleop.arms[0].engaged && told.arms[0].commanded_velocity.every((v) => Math.abs(v) < 1e-4)");
        browser
            .wait_until("document.querySelector('#steer').getAttribute('aria-pressed') === 'true'");
        browser.evaluate("delete document.hidden, operator.rest(), true");
        browser.wait_until("told.teleop.arms[0].lost === null");
    }
    engage_and_push(&mut browser);
    browser.screenshot(&folder.join("engaged.png"));
    crate::browser::looks_right(&mut browser, "teleop");
    browser.evaluate("operator.rest(), true");
    lift(&mut browser);
    wait_for_end(&mut browser, "Success");
    assert_eq!(served.code(), 0);
    verified(&log);
}

/// In a headset alone, whose squeeze is the clutch, whose trigger closes the jaw and whose buttons
/// begin the episode, twice, a needle is lifted for a dataset that can be trained on.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn a_headset_lifts_the_needle_and_the_dataset_trains() {
    let _turn = tests::alone();
    let folder = scratch("teleop-headset-data");
    let data = folder.join("data");
    let mut served = Served::start_slow("teleop-headset", &record_to(&data), SLOW_MOTION);
    let mut browser = operated("teleop-headset", &served, "headset");
    start_in_headset(&mut browser);
    redo(&mut browser);
    aligns(&mut browser, &folder);
    loses_tracking(&mut browser);
    lift(&mut browser);
    wait_for_end(&mut browser, "1 episodes are recorded");
    assert_eq!(served.code(), 0);
    says_who_and_trains(&folder, &data, &Value::Null);
}

/// A controller that is held otherwise than its instrument points does not engage, and the page
/// says by how much; turned so, with its squeeze still held, it does.
fn aligns(browser: &mut Browser, folder: &Path) {
    let before = browser.evaluate("told.teleop.arms[0].tip");
    for (degrees, said) in [
        (
            60.0_f64,
            "the controller is 60° off the instrument; turn it within 30°",
        ),
        (31.5, "the controller is 32° off"),
    ] {
        let radians = degrees.to_radians();
        let shown = browser.evaluate(&format!(
            "operator.misalign({radians}).then(() => [document.querySelector('#hands').textContent, told.teleop.arms[0]])"
        ));
        let shown = shown.as_array().unwrap();
        assert!(shown[0].as_str().unwrap().contains(said), "{shown:?}");
        assert_eq!(shown[1]["engaged"], false);
    }
    browser.screenshot(&folder.join("misaligned.png"));
    assert_eq!(browser.evaluate("told.teleop.arms[0].tip"), before);
    // A run that let go of it meanwhile, since a message came late, wants a new clutch.
    browser.evaluate(
        "(async () => {
          while (!told.teleop.arms[0].engaged) {
            await operator.misalign(0.6);
            operator.hands.align(told.teleop.arms[0].tip, 0.5);
            while (!told.teleop.arms[0].engaged && told.teleop.arms[0].lost === null) await new Promise((done) => setTimeout(done, 20));
          }
        })()",
    );
    browser.evaluate("operator.rest(), true");
    browser.wait_until("!told.teleop.arms[0].engaged");
}

/// The words of a recording of one episode by hand into `data`.
pub(crate) fn record_to(data: &Path) -> Vec<&str> {
    let words = ["record", "--task", "needle-lift", "--source", "teleop"];
    let more = ["--episodes", "1", "--seed", SEED, "--out"];
    [&words[..], &more, &[data.to_str().unwrap()]].concat()
}

/// The words of a run by hand with its log at `log`.
fn run_to(log: &Path) -> Vec<&str> {
    let words = [
        "run",
        "--task",
        "needle-lift",
        "--policy",
        "teleop",
        "--seed",
        SEED,
    ];
    [&words[..], &["--log", log.to_str().unwrap()]].concat()
}

/// Takes the clutch and pushes to the right, until the arm moves.
fn engage_and_push(browser: &mut Browser) {
    browser.evaluate("operator.move([0, 1, 0]), true");
    browser.wait_until("operator.moves");
}
