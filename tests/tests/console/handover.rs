//! Two hands in a headset, one controller an arm: the right one lifts the needle and holds it out,
//! the left one takes it away.

use serde_json::{Value, json};
use tests::{json as read_json, scratch};

use crate::devtools::Browser;
use crate::lift::{SEED, SLOW_MOTION, Shown, operated, wait_for_end};
use crate::run::{Served, verified};

/// How far the first hand rises before it carries the needle, and the second one comes from above
/// it, m.
const LIFT_M: f64 = 0.012;

/// Within which a tip is where it is to be, m and rad: what the needle in one hand is off by shows
/// in the other's grip.
const WITHIN: [f64; 2] = [0.000_5, 0.025];

/// Where both tips go, as the picture shows it, in three parts: to where the expert holds the
/// needle out, to where it takes it there, and apart.
fn way_to_hand_over() -> [Value; 3] {
    let shown = Shown::of("needle-handover");
    let targets = |arm| shown.targets.iter().filter_map(move |both| both.get(arm));
    let closed = |arm| {
        let jaws: Vec<bool> = targets(arm).map(|target| target.jaw < 0.0).collect();
        let first = jaws.iter().position(|closed| *closed).unwrap();
        let last = jaws.iter().rposition(|closed| *closed).unwrap();
        // It does not try twice.
        assert!(jaws[first..=last].iter().all(|closed| *closed));
        [first, last]
    };
    let at = |arm, step, raised_m, jaw| {
        let target = targets(arm).nth(step).unwrap();
        shown.place(arm, &shown.in_scene(arm, target, raised_m), jaw)
    };
    let ([grasps, gives], [takes, _]) = (closed(0), closed(1));
    let end = shown.targets.len() - 1;
    [
        json!([
            at(0, grasps, 0.02, 0.0),
            at(0, grasps, 0.0, 0.0),
            at(0, grasps, 0.0, 1.0),
            at(0, grasps, LIFT_M, 1.0),
            at(0, gives, 0.0, 1.0),
        ]),
        json!([
            at(1, takes, LIFT_M, 0.0),
            at(1, takes, 0.0, 0.0),
            at(1, takes, 0.0, 1.0),
        ]),
        json!([
            at(0, gives, 0.0, 0.0),
            at(0, end, 0.0, 0.0),
            at(1, end, 0.0, 1.0),
        ]),
    ]
}

/// Goes a part of the way, with both clutches held.
fn go(browser: &mut Browser, way: &Value) {
    browser.evaluate(&format!("operator.follow({way}, {}), true", json!(WITHIN)));
    browser.wait_until(
        "operator.done || /Success|Failure/.test(document.querySelector('#banner').textContent)",
    );
}

/// Whether a criterion of success stands on the page.
fn stands(criterion: &str) -> String {
    format!(
        "[...document.querySelectorAll('#criteria-rows tr')].some((row) => row.dataset.met === 'true' && row.textContent.includes('{criterion}'))"
    )
}

/// By WebXR alone, with both clutches held, a needle is lifted by one hand and taken by the other;
/// no limit is broken meanwhile.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn two_controllers_hand_a_needle_over() {
    let _turn = tests::alone();
    let folder = scratch("teleop-handover-log");
    let log = folder.join("run.mcap");
    let words = "run --task needle-handover --policy teleop --seed";
    let words: Vec<&str> = words.split(' ').chain([SEED, "--log"]).collect();
    let words = [&words[..], &[log.to_str().unwrap()]].concat();
    let mut served = Served::start_slow("teleop-handover", &words, SLOW_MOTION);
    let mut browser = operated("teleop-handover", &served, "headset");
    browser.wait_until("!document.querySelector('#enter-vr').hidden");
    browser.evaluate("operator.arms = [0, 1], document.querySelector('#enter-vr').click()");
    browser.wait_until("document.querySelector('#enter-vr-text').textContent.startsWith('Leave')");

    let [give, take, part] = way_to_hand_over();
    go(&mut browser, &give);
    browser.wait_until("told.teleop.arms.every((arm) => arm.engaged)");
    browser.wait_until(&stands("lifted by the first arm"));
    browser.screenshot(&folder.join("given.png"));
    go(&mut browser, &take);
    browser.screenshot(&folder.join("taken.png"));
    go(&mut browser, &part);
    wait_for_end(&mut browser, "Success");
    assert_eq!(served.code(), 0);
    let result = read_json(&served.folder.join("result.json"));
    assert!(
        result["teleop"]["engagements"].as_u64() >= Some(2),
        "{result}"
    );
    verified(&log);
}
