//! The console on a log.

use std::process::Command;

use serde_json::{Value, json};

use crate::page::{Page, PageEvent};
use crate::run::{Served, made_log};

#[test]
fn a_log_is_looked_through() {
    let log = made_log("console-log-made", "needle-lift");
    let mut served = Served::start("console-log", &["replay", log.to_str().unwrap()]);
    let mut page = Page::open(&served);
    let facts = page.wait_for("facts", |_| true);
    assert_eq!(
        (&facts["log"], &facts["title"]),
        (&json!(true), &json!("needle-lift"))
    );
    assert_eq!(facts["outcome"]["success"], true);
    let seconds = facts["seconds"].as_f64().unwrap();
    assert!(seconds > 1.0);
    let events = facts["events"].as_array().unwrap();
    let enabled = |event: &&serde_json::Value| event["text"] == "psm1: DISABLED to ENABLED";
    assert_eq!(events.iter().filter(enabled).count(), 1, "{events:?}");

    page.say(&json!({ "show": [[0, "colour"]] }));
    let mut stamps = Vec::new();
    for at in [0.0, seconds / 2.0, seconds, 1e9, -5.0] {
        page.say(&json!({ "at": at }));
        let state = page.wait_for("state", |_| true);
        let told = state["seconds"].as_f64().unwrap();
        assert!(
            (told - at.clamp(0.0, seconds)).abs() < 0.03,
            "{told} at {at}"
        );
        assert!(state["arms"][0]["measured"].is_array());
        if at > 0.0 && at < seconds {
            let picture = page.wait_for_picture();
            stamps.push(f64::from_le_bytes(picture[8..16].try_into().unwrap()));
        }
    }
    let [middle] = stamps[..] else {
        panic!("{stamps:?}")
    };
    assert!(
        (middle - seconds / 2.0).abs() < 0.3,
        "{middle} of {seconds}"
    );
    looks_like_its_run(&mut page, &facts);
    let (ok, said) = page.command("pause");
    assert!(!ok, "{said}");
    let id = served.process.id().to_string();
    assert!(
        Command::new("kill")
            .args(["-INT", &id])
            .status()
            .unwrap()
            .success()
    );
    page.wait_for("end", |_| true);
    assert_eq!(served.code(), 0);
}

/// The scene is there, its cameras too, those that the log has no images of; depth, ids and where everything is are told for a place, and so is
/// how the task stood and where the chunk led.
fn looks_like_its_run(page: &mut Page, facts: &Value) {
    assert_eq!(facts["scene"], true);
    assert_eq!(facts["cameras"], json!(["endoscope", "side", "wrist"]));
    assert_eq!(facts["drawn"], json!(["side", "wrist"]));
    assert_eq!(facts["depth"], facts["cameras"]);
    let shown = [(0, 0), (0, 1), (0, 2), (2, 0), (SCENE, 0)];
    let planes = ["colour", "depth", "ids"];
    let show = shown.map(|(camera, plane)| json!([camera, planes[usize::from(plane)]]));
    // What it had before is told anew.
    page.say(&json!({ "show": [] }));
    page.say(&json!({ "show": show }));
    let seconds = facts["seconds"].as_f64().unwrap();
    let begin = seen_at(page, 0.0, &shown);
    let end = seen_at(page, seconds, &shown);
    for ((stream, before), after) in shown.iter().zip(begin).zip(end) {
        // The arm has moved.
        assert_ne!(before[16..], after[16..], "{stream:?}");
        if stream.0 != SCENE {
            let image = image::load_from_memory(&after[16..]).unwrap();
            assert_eq!((image.width(), image.height()), (512, 512), "{stream:?}");
        }
    }
    let met = |state: &Value| {
        let criteria = state["criteria"].as_array().unwrap().iter();
        criteria.filter(|it| it["met"] == true).count()
    };
    let mut told = |at: f64| {
        page.say(&json!({ "at": at }));
        page.wait_for("state", |state| {
            (state["seconds"].as_f64().unwrap() - at).abs() < 0.03
        })
    };
    let (begin, middle, end) = (told(0.0), told(seconds / 2.0), told(seconds));
    assert!(met(&end) > met(&begin), "{begin} {end}");
    let path = &middle["paths"][0];
    let points = path["points"].as_array().unwrap().len();
    assert!(points > 1, "{path}");
    assert_eq!(path["pictures"]["0"].as_array().unwrap().len(), points);
    assert!(path["pictures"]["2"].is_array(), "{path}");
}

/// The stream of the scene.
const SCENE: u8 = 255;

/// What there is to see of each of the streams `shown` at that time.
fn seen_at(page: &mut Page, seconds: f64, shown: &[(u8, u8)]) -> Vec<Vec<u8>> {
    page.say(&json!({ "at": seconds }));
    let mut seen = vec![Vec::new(); shown.len()];
    while seen.iter().any(Vec::is_empty) {
        match page.hear() {
            PageEvent::Picture(picture) => {
                let stamp = f64::from_le_bytes(picture[8..16].try_into().unwrap());
                let place = shown.iter().position(|it| *it == (picture[0], picture[1]));
                // One of the place before may be on its way.
                if (stamp - seconds).abs() < 0.2 {
                    seen[place.unwrap()] = picture;
                }
            }
            PageEvent::Text(told) => assert_ne!(told["kind"], "problem", "{told}"),
            PageEvent::Closed(code) => panic!("closed with {code}"),
        }
        page.acknowledge();
    }
    seen
}
