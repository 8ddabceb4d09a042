//! The console on a log.

use std::path::Path;
use std::process::Command;

use hal::config::Source;
use serde_json::{Value, json};
use tests::trocar;
use trocar_control::{AnyController, ControlConfig, TickInput};
use trocar_log::{BusRecord, BusesRecord, Level, Pressure, Recorder, RunLog, TickRecord};

use crate::page::{Page, PageEvent};
use crate::run::{Served, made_log, verified};

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

/// What an operator's hand did in the run of [`as_if_on_can`], and in which tick.
const HAND: [(u64, &str); 4] = [
    (1000, "the scale of the operator's hands is 0.5"),
    (1000, "psm1: the operator's hand engaged"),
    (1000, "the operator drives"),
    (1500, "psm1: the operator released the clutch"),
];

/// A log at `to` of the run in `log`, as if its arm had been on a CAN bus that got busier every
/// half second, an operator had taken over, and nobody had said where the needle was.
pub(crate) fn as_if_on_can(log: &Path, to: &Path) {
    let read = RunLog::open(log).unwrap();
    let source = |file: &'static str| Source::embedded(file, read.text(file).unwrap());
    let config = ControlConfig::load(&source("control.toml"), &source("safety.toml")).unwrap();
    let mut controller = AnyController::new(&config).unwrap();
    let mut recorder = Recorder::create(to, &read.header, Pressure::Block).unwrap();
    for (tick, chunks) in read.ticks() {
        let given = tick.arms.as_ref().zip(chunks);
        let inputs = given.map(|(arm, chunk)| TickInput {
            now: tick.now,
            measured: arm.measured,
            chunk,
            operator: arm.operator,
        });
        let outputs = controller.tick(&inputs);
        for (arm, chunk) in chunks.iter().enumerate() {
            if let Some(chunk) = chunk {
                recorder.chunk(arm, chunk);
            }
        }
        recorder.tick(&TickRecord::new(tick.tick, inputs, outputs, tick.timing));
        for (_, line) in HAND.iter().filter(|(at, _)| *at == tick.tick) {
            recorder.event(tick.now, Level::Info, line);
        }
        let half_seconds = u32::try_from(tick.tick / 500).unwrap();
        if tick.tick.is_multiple_of(500) {
            let bus = BusRecord {
                interface: "can0".to_owned(),
                frames_per_s: 14_003.0,
                load: 0.2 + 0.1 * f64::from(half_seconds),
                errors: u64::from(half_seconds / 2),
            };
            recorder.buses(tick.now, BusesRecord { buses: vec![bus] });
        }
    }
    recorder.finish(read.outcome.as_ref()).unwrap();
}

/// The page on the log of a CAN run says the load and the errors of its bus at each place of the
/// time line, who drove and whether the hand was engaged; it has the instruments and the ground, and
/// no needle.
#[test]
fn a_log_of_a_bus_is_looked_through() {
    let made = made_log("console-log-can-made", "needle-lift");
    let log = made.with_file_name("can.mcap");
    as_if_on_can(&made, &log);
    verified(&log);
    let replay = trocar().arg("replay").arg(&log).output().unwrap();
    assert!(replay.status.success(), "{}", tests::stderr(&replay));
    let served = Served::start("console-log-can", &["replay", log.to_str().unwrap()]);
    let mut page = Page::open(&served);
    let facts = page.wait_for("facts", |_| true);
    assert_eq!(
        (&facts["scene"], &facts["depth"]),
        (&json!(true), &json!([]))
    );
    for (at, load, errors, driver, engaged) in [
        (1.1, 0.4, 1, "operator", true),
        (0.6, 0.3, 0, "policy", false),
        (2.1, 0.6, 2, "operator", false),
    ] {
        page.say(&json!({ "at": at }));
        let state = page.wait_for("state", |_| true);
        let [bus] = &state["buses"].as_array().unwrap()[..] else {
            panic!("{state}");
        };
        assert_eq!(
            (&bus["interface"], &bus["errors"]),
            (&json!("can0"), &json!(errors))
        );
        assert!(
            (bus["load"].as_f64().unwrap() - load).abs() < 1e-9,
            "{bus} at {at}"
        );
        assert!(state["criteria"].is_null(), "{state}");
        let teleop = &state["teleop"];
        assert_eq!(
            (&teleop["driver"], &teleop["arms"][0]["engaged"]),
            (&json!(driver), &json!(engaged))
        );
    }
    let (host, cookie) = (served.host(), served.cookie());
    let headers = [("Host", host.as_str()), ("Cookie", cookie.as_str())];
    let scene = served.get("/scene.glb", &headers);
    for (part, is_there) in [("organ", true), ("left finger", true), ("needle", false)] {
        let named = format!("\"name\":\"{part}\"");
        assert_eq!(scene.contains(&named), is_there, "{part}");
    }
    page.say(&json!({ "show": [[SCENE, "colour"]] }));
    let [begin, end] = [0.0, 2.0].map(|at| seen_at(&mut page, at, &[(SCENE, 0)]).remove(0));
    assert_ne!(begin[16..], end[16..], "the arm moved");
}

/// The scene is there, its cameras too, those that the log has no images of; depth, ids and where
/// everything is are told for a place, and so is how the task stood and where the chunk led.
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
