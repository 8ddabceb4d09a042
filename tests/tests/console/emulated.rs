//! The headset is Meta's emulation of a Quest 3 (IWER), which `.ci/setup-browser.sh` installs:
//! sessions, frames, views, grip spaces and buttons are those of a runtime that is none of ours.

use std::path::PathBuf;
use std::{env, fs};

use tests::scratch;

use crate::devices::{Tip, near};
use crate::devtools::Browser;
use crate::lift::{
    SLOW_MOTION as QUICKER, lift, loses_tracking, operated_with, record_to, redo, start_in_headset,
    wait_for_end,
};
use crate::run::{Served, verified};

/// How many times slower than the machine's the clocks of the run are: the emulation's frames are
/// the page's, which a software renderer draws.
const SLOW_MOTION: u64 = 6;

/// Its script, from the cache of [`.ci/setup-browser.sh`].
fn runtime() -> String {
    let cache = env::var_os("XDG_CACHE_HOME").filter(|path| !path.is_empty());
    let cache = cache.map(PathBuf::from);
    let cache = cache.unwrap_or_else(|| PathBuf::from(env::var_os("HOME").unwrap()).join(".cache"));
    let path = cache.join("trocar/iwer-2.5.0/iwer.min.js");
    fs::read_to_string(&path).unwrap_or_else(|error| {
        panic!(
            "{}: {error}; `make setup-browser` installs it",
            path.display()
        )
    })
}

/// `trocar WORDS`, which is moved by hand, and a page that may enter the emulated headset.
fn emulated(test: &str, words: &[&str]) -> (Served, Browser) {
    let served = Served::start_slow(test, words, SLOW_MOTION);
    let mut browser = operated_with(test, &served, "iwer", &runtime());
    browser.wait_until("!document.querySelector('#enter-vr').hidden");
    (served, browser)
}

/// The emulated controllers lift the needle: squeeze is the clutch, the trigger closes the jaw, and
/// buttons begin the recorded episode, twice.
#[test]
#[ignore = "needs chromium and IWER: `make test-console` runs it"]
fn an_emulated_quest_lifts_the_needle() {
    let _turn = tests::alone();
    let data = scratch("teleop-iwer-lift-data").join("data");
    let (mut served, mut browser) = emulated("teleop-iwer-lift", &record_to(&data));
    start_in_headset(&mut browser);
    redo(&mut browser);
    browser.evaluate(&format!("operator.pace = {SLOW_MOTION} / {QUICKER}"));
    lift(&mut browser);
    wait_for_end(&mut browser, "1 episodes are recorded");
    assert_eq!(served.code(), 0);
    let attempts = &tests::json(&served.folder.join("result.json"))["attempts"];
    let attempts = attempts.as_array().unwrap();
    let reasons: Vec<_> = attempts.iter().map(|attempt| &attempt["reason"]).collect();
    assert_eq!(reasons, ["to be done again", "success"]);
}

/// A thumbstick that is pushed tilts the scene, until less of it is seen from above; while a clutch
/// is held it does not.
fn turns_the_scene(browser: &mut Browser) {
    browser.evaluate("window.below = operator.seen[2], operator.hands.axes = [0, 0, 0, -1], true");
    browser.wait_until("operator.seen[2] < below - 0.008");
    browser.evaluate("operator.hands.axes = [0, 0, 0, 0], operator.hold(true), operator.looked(4)");
    browser.evaluate(
        "window.below = operator.seen[2], operator.hands.axes = [0, 0, 0, 1], operator.looked(8)",
    );
    let way = browser.evaluate("operator.seen[2] - below");
    assert!(way.as_f64().unwrap().abs() < 0.003, "{way}");
    browser.evaluate("operator.hands.axes = [0, 0, 0, 0], operator.hold(false), true");
}

/// Two views are drawn side by side, with the scene if it is asked for; a controller that is held
/// as its instrument points engages by its squeeze, and the tip goes and turns as its grip does;
/// without the squeeze it moves nothing. A controller whose position is only estimated lets go, and
/// the arm rests. No limit is broken meanwhile.
#[test]
#[ignore = "needs chromium and IWER: `make test-console` runs it"]
fn an_emulated_quest_moves_the_tip() {
    let _turn = tests::alone();
    let log = scratch("teleop-iwer-log").join("run.mcap");
    let words = "run --task needle-lift --policy teleop --seed 7 --stereo --log";
    let words: Vec<&str> = words.split(' ').chain([log.to_str().unwrap()]).collect();
    let (mut served, mut browser) = emulated("teleop-iwer", &words);
    browser.evaluate("operator.eyes = true, document.querySelector('#enter-vr').click()");
    browser.wait_until("operator.seen?.[1] > 0.05 && operator.seen[0] > 0.01");
    let seen = browser.evaluate("operator.seen");
    assert!(seen[0].as_f64() < Some(0.9), "{seen}");
    browser.wait_until("shown.headset > 0");
    // The scene appears below the picture, and goes again.
    let lit = seen[1].as_f64().unwrap();
    browser.evaluate("document.querySelector('#scene-vr').click()");
    browser.wait_until(&format!("operator.seen[1] > {lit} + 0.02"));
    turns_the_scene(&mut browser);
    browser.screenshot(&scratch("teleop-iwer-pictures").join("eyes.png"));
    browser.evaluate("document.querySelector('#scene-vr').click()");
    browser.wait_until(&format!("operator.seen[1] < {lit} + 0.01"));
    browser.evaluate("operator.eyes = false, true");

    let start = Tip::rested(&mut browser);
    browser.evaluate("operator.push([0, 1, 0]), new Promise((done) => setTimeout(done, 500))");
    near(start.way(&Tip::rested(&mut browser)), [0.0; 3], 1e-5);
    browser.evaluate("operator.rest(), operator.take(), true");
    browser.wait_until("told.teleop.arms[0].engaged");
    let y = start.0[1];
    browser.evaluate(&format!(
        "operator.until([0, 1, 0], [0, 0, 0], () => told.teleop.arms[0].tip[1] > {y} + 0.004), true"
    ));
    browser.wait_until("operator.there");
    let risen = Tip::rested(&mut browser);
    let [x, up, z] = start.way(&risen);
    assert!(up > 0.004 && x.hypot(z) < 0.1 * up, "{x} {up} {z}");

    // The grip turns about itself, though the emulation turns where the controller points from.
    let [a, b] = [3, 4].map(|place| risen.numbers()[place]);
    browser.evaluate(&format!(
        "operator.until([0, 0, 0], [0, 0, 1], () => Math.hypot(told.teleop.arms[0].tip[3] - {a}, told.teleop.arms[0].tip[4] - {b}) > 0.06), true"
    ));
    browser.wait_until("operator.there");
    let rolled = Tip::rested(&mut browser);
    let [x, y, roll] = risen.turn(&rolled);
    assert!(roll > 0.1 && x.hypot(y) < 0.2 * roll, "{x} {y} {roll}");
    near(risen.way(&rolled), [0.0; 3], 8e-4);

    loses_tracking(&mut browser);
    assert_eq!(browser.errors, Vec::<String>::new());
    browser.evaluate("document.querySelector('[data-command=stop]').click()");
    assert_eq!(served.code(), 1);
    verified(&log);
}
