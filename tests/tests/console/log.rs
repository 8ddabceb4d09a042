//! The console on a log.

use std::process::Command;

use serde_json::json;

use crate::page::Page;
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
