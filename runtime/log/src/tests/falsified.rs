//! Falsified logs: written anew with one thing changed, and all checksums right.

use std::collections::BTreeMap;
use std::path::PathBuf;

use mcap::records::{MessageHeader, Metadata};

use super::{Scratch, run_controller, write_records};
use crate::container::{Visitor, walk};
use crate::contents::ContentHash;
use crate::header;
use crate::replay::{ReplayResult, replay};
use crate::verify::{VerifyResult, verify};
use crate::{LogError, RunLog};

/// What a log holds, in order.
#[derive(Clone, Debug)]
pub(super) enum Item {
    Message(String, MessageHeader, Vec<u8>),
    Metadata(String, BTreeMap<String, String>),
}

#[derive(Default)]
struct Items(Vec<Item>);

impl Visitor for Items {
    fn message(&mut self, topic: &str, header: &MessageHeader, data: &[u8]) -> Result<(), String> {
        let item = Item::Message(topic.to_owned(), *header, data.to_vec());
        self.0.push(item);
        Ok(())
    }

    fn metadata(&mut self, name: &str, map: BTreeMap<String, String>) -> Result<(), String> {
        self.0.push(Item::Metadata(name.to_owned(), map));
        Ok(())
    }
}

/// The log of an honest run.
fn honest(name: &str) -> Vec<Item> {
    let (records, header) = run_controller(300);
    let file = Scratch::new(name);
    write_records(&file, &records, &header);
    items(&file)
}

/// What a whole file holds.
pub(super) fn items(file: &Scratch) -> Vec<Item> {
    let mut items = Items::default();
    let bytes = std::fs::read(&file.0).unwrap();
    assert_eq!(walk(&file.0, bytes.as_slice(), &mut items).unwrap(), None);
    items.0
}

/// Makes the hash over all contents that of `items`, as whoever changed them could.
pub(super) fn rehash(items: &mut [Item]) {
    let mut contents = ContentHash::default();
    for item in items {
        match item {
            Item::Message(topic, header, data) => contents.message(topic, header, data),
            Item::Metadata(name, map) if name == header::OUTCOME => {
                let hash = header::contents_after(&contents, map);
                map.insert("contents_sha256".to_owned(), hash);
            }
            Item::Metadata(name, map) => contents.metadata(name, map),
        }
    }
}

/// A file that holds `items`.
pub(super) fn written(items: &[Item]) -> Vec<u8> {
    let mut writer = mcap::Writer::new(std::io::Cursor::new(Vec::new())).unwrap();
    for item in items {
        match item {
            Item::Message(topic, header, data) => {
                let none = BTreeMap::new();
                let channel_id = writer.add_channel(0, topic, "json", &none).unwrap();
                let header = MessageHeader {
                    channel_id,
                    ..*header
                };
                writer.write_to_known_channel(&header, data).unwrap();
            }
            Item::Metadata(name, map) => writer
                .write_metadata(&Metadata {
                    name: name.clone(),
                    metadata: map.clone(),
                })
                .unwrap(),
        }
    }
    writer.finish().unwrap();
    writer.into_inner().into_inner()
}

pub(super) fn read(items: &[Item]) -> Result<RunLog, LogError> {
    RunLog::from_bytes(&PathBuf::from("falsified.mcap"), &written(items))
}

/// What replay and verify say of an honest log with `change` made to it.
fn said(name: &str, change: impl Fn(&mut Vec<Item>)) -> (ReplayResult, VerifyResult) {
    let mut items = honest(name);
    change(&mut items);
    let log = read(&items).unwrap();
    (replay(&log).unwrap(), verify(&log).unwrap())
}

/// That both find it, replay under the name `what`.
fn found(name: &str, what: &str, change: impl Fn(&mut Vec<Item>)) {
    let (replayed, verified) = said(name, change);
    let difference = replayed.first_difference.unwrap();
    assert!(difference.what.starts_with(what), "{difference}");
    assert!(!replayed.identical && !verified.ok, "{name}");
    let limits = verified.violations.iter().map(|found| &found.limit);
    assert!(limits.clone().any(|limit| limit == "contents_mismatches"));
}

/// Changes the text of the JSON message on `topic` in tick 200.
fn change_json(items: &mut [Item], topic: &str, from: &str, to: &str) {
    let of_tick = |data: &[u8]| {
        let text = String::from_utf8(data.to_vec()).unwrap();
        text.contains("\"tick\":200,").then_some(text)
    };
    for item in items {
        if let Item::Message(name, _, data) = item
            && name == topic
            && let Some(text) = of_tick(data)
        {
            let changed = text.replace(from, to);
            assert_ne!(changed, text);
            *data = changed.into_bytes();
        }
    }
}

fn change_metadata(items: &mut [Item], of: &str, change: impl Fn(&mut BTreeMap<String, String>)) {
    for item in items {
        if let Item::Metadata(name, map) = item
            && name == of
        {
            change(map);
        }
    }
}

#[test]
fn a_log_written_anew_as_it_was_is_well() {
    let (replayed, verified) = said("anew", |_| ());
    assert!(replayed.identical, "{:?}", replayed.first_difference);
    assert!(verified.ok, "{:?}", verified.violations.first());
    assert!(!verified.measured.is_empty());
}

#[test]
fn every_part_of_a_safety_report_is_compared() {
    for (name, from, to, what) in [
        ("mode", "ENABLED", "PAUSED", "safety.mode"),
        (
            "guard",
            "\"guard_intervened\":false",
            "\"guard_intervened\":true",
            "safety.guard_intervened",
        ),
        ("qp", "\"qp\":\"", "\"qp\":\"un", "safety.qp"),
        (
            "fault",
            "\"fault\":null",
            "\"fault\":\"no\"",
            "safety.fault",
        ),
    ] {
        found(&format!("report-{name}"), what, |items| {
            change_json(items, "/safety", from, to);
        });
    }
    found("report-gone", "safety", |items| {
        let first = |item: &Item| matches!(item, Item::Message(topic, ..) if topic == "/safety");
        let at = items.iter().position(first).unwrap();
        items.remove(at);
    });
}

#[test]
fn what_no_replay_recomputes_is_compared_by_its_hash() {
    found("timing", "contents", |items| {
        change_json(items, "/timing", "\"compute_ns\":0", "\"compute_ns\":1");
    });
    found("reason", "contents", |items| {
        change_metadata(items, "outcome", |map| {
            map.insert("ticks_dropped".to_owned(), "0".to_owned());
            map.insert("success".to_owned(), "true".to_owned());
        });
    });
    found("commit", "contents", |items| {
        change_metadata(items, "versions", |map| {
            map.insert("commit".to_owned(), "another".to_owned());
        });
    });
    found("hands", "contents", |items| {
        change_metadata(items, "outcome", |map| {
            map.insert("teleop".to_owned(), "{}".to_owned());
        });
    });
    // Limits that no command came near.
    found("limits", "contents", |items| {
        change_metadata(items, "configuration", |map| {
            let text = map.get_mut("safety.toml").unwrap();
            *text = text.replace("radius_m = 0.015", "radius_m = 0.001");
        });
    });
    found("swapped", "contents", |items| {
        let poses: Vec<usize> = (0..items.len())
            .filter(|&at| matches!(&items[at], Item::Message(topic, ..) if topic == "/psm1/measured_cp"))
            .collect();
        let (one, other) = (poses[100], poses[200]);
        items.swap(one, other);
    });
    found("no-hash", "contents", |items| {
        change_metadata(items, "outcome", |map| {
            map.remove("contents_sha256").unwrap();
        });
    });
}

/// A mark that this version does not know is none of its own, and is there by its name.
#[test]
fn a_mark_that_is_not_known_is_named() {
    for (mark, unknown) in [("success", None), ("good", Some("good"))] {
        let mut items = honest(&format!("mark-{mark}"));
        change_metadata(&mut items, "outcome", |map| {
            for (key, value) in [("reason", "over"), ("command_hash", "0"), ("mark", mark)] {
                map.insert(key.to_owned(), value.to_owned());
            }
        });
        rehash(&mut items);
        let end = read(&items).unwrap().end();
        assert_eq!((end.unknown_mark.as_deref(), end.altered), (unknown, false));
        let known = end.outcome.unwrap().said.mark;
        assert_eq!(known.is_some(), unknown.is_none());
    }
}

#[test]
fn a_second_record_of_a_name_is_refused() {
    for of in ["run", "versions", "configuration", "outcome"] {
        let mut items = honest(&format!("second-{of}"));
        let named = |item: &&Item| matches!(item, Item::Metadata(name, _) if name == of);
        let record = items.iter().find(named).unwrap().clone();
        items.push(record);
        let error = read(&items).unwrap_err().to_string();
        let expected = format!("a second metadata record `{of}`");
        assert!(error.contains(&expected), "{error}");
    }
}

#[test]
fn messages_that_are_too_many_or_of_another_time_are_refused() {
    let mut items = honest("twice");
    let setpoint =
        |item: &Item| matches!(item, Item::Message(topic, ..) if topic == "/psm1/setpoint_js");
    let at = items.iter().position(setpoint).unwrap();
    items.insert(at, items[at].clone());
    let error = read(&items).unwrap_err().to_string();
    assert!(error.contains("a second message of one tick"), "{error}");

    let mut items = honest("late");
    for item in &mut items {
        if let Item::Message(topic, header, _) = item
            && topic == "/psm1/tick"
        {
            header.log_time += 1;
        }
    }
    let error = read(&items).unwrap_err().to_string();
    assert!(error.contains("tick 0 has another time"), "{error}");

    let mut items = honest("after");
    let message = items.iter().find(|item| matches!(item, Item::Message(..)));
    items.push(message.unwrap().clone());
    let error = read(&items).unwrap_err().to_string();
    assert!(
        error.contains("after the record of how the run ended"),
        "{error}"
    );
}

#[test]
fn a_log_is_checked_without_being_in_memory() {
    let (records, header) = run_controller(700);
    let file = Scratch::new("streamed");
    write_records(&file, &records, &header);
    let log = RunLog::open(&file.0).unwrap();
    let replayed: Result<_, Either> = crate::replay::replay_file(&file.0);
    let verified: Result<_, Either> = crate::verify::verify_file(&file.0);
    assert_eq!(replayed.unwrap(), replay(&log).unwrap());
    assert_eq!(verified.unwrap(), verify(&log).unwrap());
    // One that never ends is none.
    let endless: Result<VerifyResult, Either> = crate::verify::verify_file("/dev/zero".as_ref());
    let told = endless.unwrap_err().0;
    assert!(
        told.contains("/dev/zero: cannot be read: it is a device"),
        "{told}"
    );
}

/// An error and its cause in words.
#[derive(Debug)]
struct Either(String);

impl<E: std::error::Error> From<E> for Either {
    fn from(error: E) -> Self {
        let cause = error.source().map(|cause| format!(": {cause}"));
        Self(format!("{error}{}", cause.unwrap_or_default()))
    }
}
