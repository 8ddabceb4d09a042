//! Intervention: a policy drives, an operator takes over from it and hands back, and all of it is
//! recorded as such.

use std::path::Path;

use serde_json::{Value, json};
use tests::{json as read_json, scratch, trocar};
use trocar_data::dataset::Dataset;
use trocar_log::RunLog;

use crate::lift::{SLOW_MOTION, operated, say, start_in_headset};
use crate::page::Page;
use crate::run::{Served, verified};
use crate::teleop::{Operator, engaged, refused, rested, tip, way};

/// The words of `trocar record` with a person who may take over from the expert.
fn record(data: &Path) -> Vec<String> {
    let words = "record --task needle-lift --source intervention --policy expert --episodes 1 --seed 7 --set scene.episode.time_limit_s=300";
    let words = words.split(' ').map(str::to_owned);
    let out = ["--out".to_owned(), data.display().to_string()];
    words.chain(out).collect()
}

pub(crate) fn driver(state: &Value) -> &str {
    state["teleop"]["driver"].as_str().unwrap_or_default()
}

/// What a log says of who drove, one entry each time that another did.
pub(crate) fn changes(log: &Path) -> Vec<String> {
    let log = RunLog::open(log).unwrap();
    let operators = log.ticks().filter_map(|(tick, _)| tick.arms.first.operator);
    operators.map(|event| format!("{event:?}")).collect()
}

/// The page goes with its clutch held: the arm holds, the policy does not come back by itself, and
/// a page that does not steer can't hand back. That page.
fn lost_in_mid_motion(operator: Operator, served: &Served) -> Page {
    drop(operator);
    let mut page = Page::open(served);
    let held = rested(&mut page);
    for _ in 0..20 {
        let state = page.wait_for("state", |_| true);
        assert_eq!(driver(&state), "operator");
        assert!(way(tip(&state), held) < 1e-5, "{state}");
    }
    page.say(&json!({ "hand_back": true }));
    page.wait_for("problem", |problem| {
        problem["text"]
            .as_str()
            .unwrap()
            .contains("take control first")
    });
    page
}

/// The hands take over from a policy in mid-motion and hold; their page is lost and nothing moves;
/// another page hands back, and the policy does the task from there. No step of the commands is
/// larger than the arms' limits allow, and the log replays to the bit.
#[test]
fn hands_take_over_from_a_policy_and_hand_back() {
    let _turn = tests::alone();
    let log = scratch("intervention-log").join("run.mcap");
    let words = [
        "run",
        "--task",
        "needle-lift",
        "--policy",
        "expert",
        "--seed",
        "7",
    ];
    let words = [&words[..], &["--log", log.to_str().unwrap()]].concat();
    let mut served = Served::start_slow("intervention-run", &words, 4);
    let mut operator = Operator::take_control(Page::open(&served));
    let moves = |state: &Value| {
        let velocity = state["arms"][0]["commanded_velocity"].as_array().unwrap();
        velocity
            .iter()
            .any(|axis| axis.as_f64().unwrap().abs() > 0.02)
    };
    let state = operator.page.wait_for("state", moves);
    assert_eq!(driver(&state), "policy");
    // Without a policy's leave nothing is handed back twice, and an open hand takes nothing over.
    let state = operator.repeat(5);
    assert_eq!(driver(&state), "policy");
    operator.engage();
    let state = operator.until(|state| driver(state) == "operator");
    assert!(engaged(&state), "{state}");
    let taken = rested(&mut operator.page);
    assert!(
        way(taken, tip(&state)) < 0.004,
        "it stops where it was taken over"
    );
    operator.engage();
    operator.rise(9);
    let risen = tip(&operator.settle());
    assert!(risen[1] - taken[1] > 0.004, "it follows the hand");

    let page = lost_in_mid_motion(operator, &served);
    let mut operator = Operator::take_control(page);
    // Who holds the clutch as the policy gets the arms back has to take it anew.
    operator.engage();
    operator.page.say(&json!({ "hand_back": true }));
    operator
        .page
        .wait_for("state", |state| driver(state) == "policy");
    let state = operator.repeat(10);
    assert!(driver(&state) == "policy" && !engaged(&state), "{state}");
    operator.page.wait_for("end", |end| end["success"] == true);
    assert_eq!(served.code(), 0);

    let result = read_json(&served.folder.join("result.json"));
    let interventions = &result["teleop"]["interventions"];
    let counts = ["taken_over", "handed_back"].map(|what| interventions[what].as_u64());
    assert_eq!(counts, [Some(1), Some(1)], "{interventions}");
    assert!(
        interventions["operator_s"].as_f64() > Some(0.3),
        "{interventions}"
    );
    assert_eq!(
        changes(&log),
        ["Enable", "TakeOver", "HandBack", "Pause", "Disable"]
    );
    verified(&log);
    let replay = trocar().arg("replay").arg(&log).output().unwrap();
    assert!(replay.status.success(), "{}", tests::stderr(&replay));
    shows_who_drove(&log);
}

/// The page of the log has who drove, as it was at each time.
fn shows_who_drove(log: &Path) {
    let served = Served::start("intervention-replay", &["replay", log.to_str().unwrap()]);
    let mut page = Page::open(&served);
    let facts = page.wait_for("facts", |_| true);
    let events = facts["events"].as_array().unwrap();
    let when = |text: &str| {
        let event = events.iter().find(|event| event["text"] == text);
        event.unwrap()["seconds"].as_f64().unwrap()
    };
    let (taken, back) = (when("the operator drives"), when("the policy drives"));
    for (at, expected) in [
        (0.0, "policy"),
        (taken + 0.15, "operator"),
        (back + 0.15, "policy"),
    ] {
        page.say(&json!({ "at": at }));
        let state = page.wait_for("state", |state| {
            (state["seconds"].as_f64().unwrap() - at).abs() < 0.1
        });
        assert_eq!(driver(&state), expected, "{state}");
    }
}

/// In the browser: the policy begins the episode, a headset's controller takes over and moves the
/// arm away, hands back, and the policy lifts the needle. Every frame of the dataset says who
/// drove.
#[test]
#[ignore = "needs chromium: `make test-console` runs it"]
fn a_headset_takes_over_from_a_policy_and_the_dataset_says_so() {
    let _turn = tests::alone();
    let folder = scratch("intervention-data");
    let data = folder.join("data");
    let words = record(&data);
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let mut served = Served::start_slow("intervention-record", &words, SLOW_MOTION);
    let mut browser = operated("intervention", &served, "headset");
    start_in_headset(&mut browser);
    let drives =
        |who: &str| format!("document.querySelector('#driver').dataset.driver === '{who}'");
    browser.wait_until(&drives("policy"));
    browser.wait_until("told.arms[0].commanded_velocity.some((v) => Math.abs(v) > 0.02)");
    // Pictures take their time, and the policy would be done.
    browser.press("p");
    browser.wait_until("document.querySelector('.chip').dataset.state === 'PAUSED'");
    crate::browser::looks_right(&mut browser, "policy-drives");
    browser.evaluate("document.querySelector('[data-command=resume]').click()");
    browser.wait_until("document.querySelector('.chip').dataset.state === 'ENABLED'");
    let tip = "told.teleop.arms[0].tip[1]";
    browser.evaluate("operator.take(), true");
    browser.wait_until(&drives("operator"));
    let taken = browser.evaluate(tip);
    browser.evaluate(&format!(
        "operator.until([0, 1, 0], [0, 0, 0], () => {tip} > {taken} + 0.005), true"
    ));
    browser.wait_until("operator.there");
    crate::browser::looks_right(&mut browser, "operator-drives");
    browser.evaluate("operator.rest(), true");
    browser.wait_until("!document.querySelector('#hand-back').disabled");
    say(&mut browser, "handBack", &drives("policy"));
    browser.wait_until("/recorded/.test(document.querySelector('#banner').textContent)");
    assert_eq!(browser.errors, Vec::<String>::new());
    assert_eq!(served.code(), 0);
    says_who_drove(&data);
}

fn says_who_drove(data: &Path) {
    let dataset = Dataset::open(data).unwrap();
    assert!(dataset.spec().intervention);
    let by_hand = dataset.interventions(dataset.episodes()[0]).unwrap();
    let first = by_hand.iter().position(|&by_hand| by_hand).unwrap();
    let last = by_hand.iter().rposition(|&by_hand| by_hand).unwrap();
    assert!(first > 0 && last + 1 < by_hand.len(), "{by_hand:?}");
    assert!(by_hand[first..=last].iter().all(|&by_hand| by_hand));
    // Neither takes the arm on a jump: it goes on no faster than it may, 0.1 m/s, and hands begin
    // where the policy left it.
    let way = |one: &[f64], other: &[f64]| {
        let squares = one.iter().zip(other).take(3);
        squares.map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
    };
    for frame in [first, last + 1] {
        let [before, after] = [frame - 1, frame].map(|frame| dataset.tip_pose(frame, 0));
        assert!(way(&before, &after) < 0.004, "{before:?} {after:?}");
    }
    let (tip, taken) = (dataset.tip_pose(first, 0), dataset.action(first, 0));
    assert!(way(&tip, &taken) < 0.006, "{tip:?} {taken:?}");
    let info = read_json(&data.join("meta/info.json"));
    assert_eq!(
        info["features"]["intervention"],
        json!({ "dtype": "bool", "shape": [1], "names": null })
    );
    assert_eq!(info["trocar"]["source"], "intervention");
    assert_eq!(info["trocar"]["policy"], "expert");
    let note = std::fs::read_to_string(data.join("meta/trocar_episodes.jsonl")).unwrap();
    let note: Value = serde_json::from_str(note.trim()).unwrap();
    assert_eq!(note["source"], "intervention");
    assert_eq!(note["teleop"]["interventions"]["taken_over"], 1, "{note}");
}

#[test]
fn an_intervention_needs_a_policy_and_a_page() {
    let words = |more: &[&'static str]| {
        let base = [
            "record",
            "--task",
            "needle-lift",
            "--episodes",
            "1",
            "--out",
            "none",
        ];
        [&base[..], more].concat()
    };
    for (more, reason) in [
        (
            &["--source", "intervention", "--policy", "expert"][..],
            "the operator's hands come over --console",
        ),
        (
            &["--source", "intervention", "--console", "127.0.0.1:0"],
            "--source intervention needs --policy",
        ),
        (
            &["--policy", "expert"],
            "--policy needs --source intervention",
        ),
        (
            &[
                "--source",
                "intervention",
                "--policy",
                "no/such",
                "--console",
                "127.0.0.1:0",
            ],
            "no/such",
        ),
    ] {
        refused(&words(more), reason);
    }
}
