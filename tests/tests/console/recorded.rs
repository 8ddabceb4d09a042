//! Recordings without a browser: demonstrations by hand that are appended to a dataset (`record
//! --resume`), and what a page is told of the expert's.

use std::path::Path;

use serde_json::{Value, json};
use tests::{json as read_json, scratch};
use trocar_data::dataset::Dataset;

use crate::page::Page;
use crate::run::{SLOW_MOTION, Served};
use crate::teleop::{Operator, tip};

/// The words of a recording by hand that goes on until there are so many episodes in `data`.
fn words<'a>(data: &'a Path, episodes: &'a str) -> [&'a str; 11] {
    [
        "record",
        "--task",
        "needle-lift",
        "--source",
        "teleop",
        "--seed",
        "7",
        "--episodes",
        episodes,
        "--out",
        data.to_str().unwrap(),
    ]
}

/// One episode by hand, the last one of the recording of `words`: it is started, the tip is raised,
/// and it is kept. The result, and the seed that the page was told.
fn demonstrate(test: &str, words: &[&str]) -> (Value, Value) {
    let mut served = Served::start_slow(test, words, SLOW_MOTION);
    let mut operator = Operator::take_control(Page::open(&served));
    let is = |state: &Value, phase: &str| state["teleop"]["recording"]["phase"] == phase;
    let waiting = operator.until(|state| is(state, "waiting"));
    operator.page.say(&json!({ "episode": "start" }));
    operator.until(|state| is(state, "running"));
    operator.engage();
    let from = tip(&operator.say());
    operator.rise(9);
    operator.until(|state| tip(state)[1] > from[1] + 0.002);
    operator.page.say(&json!({ "episode": "keep" }));
    operator.page.wait_for("end", |_| true);
    assert_eq!(served.code(), 0);
    let seed = waiting["teleop"]["recording"]["seed"].clone();
    (read_json(&served.folder.join("result.json")), seed)
}

/// What the arm was in and was told in each frame of `episode`, bit for bit.
fn bits(dataset: &Dataset, episode: usize) -> Vec<(Vec<u32>, Vec<u64>)> {
    let episode = dataset.episodes()[episode];
    let frames = episode.start..episode.start + episode.len;
    let bits = frames.map(|frame| {
        let state = dataset.state(frame, 0).into_iter().map(f32::to_bits);
        let action = dataset.action(frame, 0).into_iter().map(f64::to_bits);
        (state.collect(), action.collect())
    });
    bits.collect()
}

/// The second episode has the next seed and stands behind the first, of which nothing changes.
#[test]
fn episodes_by_hand_are_appended_to_a_dataset() {
    let _turn = tests::alone();
    let data = scratch("record-appended-data").join("data");
    let (result, seed) = demonstrate("record-first", &words(&data, "1"));
    let counts = |result: &Value| ["episodes_before", "episodes"].map(|key| result[key].as_u64());
    assert_eq!(counts(&result), [Some(0), Some(1)], "{result}");
    assert_eq!(seed, 7);
    let first = bits(&Dataset::open(&data).unwrap(), 0);
    assert!(first.len() > 3, "{} frames", first.len());

    let more = [&words(&data, "2")[..], &["--resume"]].concat();
    let (result, seed) = demonstrate("record-second", &more);
    assert_eq!(counts(&result), [Some(1), Some(2)], "{result}");
    assert_eq!(seed, 8);
    let dataset = Dataset::open(&data).unwrap();
    assert_eq!(dataset.episodes().len(), 2);
    assert!(bits(&dataset, 0) == first, "the first is as it was");
    assert!(bits(&dataset, 1).len() > 3);
    let notes = std::fs::read_to_string(data.join("meta/trocar_episodes.jsonl")).unwrap();
    let notes = notes.lines().map(|line| {
        let note: Value = serde_json::from_str(line).unwrap();
        ["episode_index", "seed", "source", "ended_by"].map(|key| note[key].clone())
    });
    let expected = [(0, 7), (1, 8)].map(|(index, seed)| {
        [
            json!(index),
            json!(seed),
            json!("teleop"),
            json!("operator"),
        ]
    });
    assert_eq!(notes.collect::<Vec<_>>(), expected);
}

/// The page of a recording by the expert is told what success asks for, as that of a run is.
#[test]
fn a_recording_tells_its_criteria() {
    let data = scratch("record-told-data").join("data");
    let mut words = words(&data, "3");
    words[4] = "expert";
    let mut served = Served::start("record-told", &words);
    let mut page = Page::open(&served);
    let facts = page.wait_for("facts", |_| true);
    assert_eq!(facts["subject"], "recording");
    let state = page.wait_for("state", |state| {
        state["criteria"]
            .as_array()
            .is_some_and(|all| all.len() > 1)
    });
    assert!(!state["task"].as_str().unwrap().is_empty(), "{state}");
    let criteria = state["criteria"].as_array().unwrap();
    assert!(criteria.iter().all(|it| it["goal"].is_f64()), "{state}");
    page.wait_for("end", |_| true);
    assert_eq!(served.code(), 0);
}
