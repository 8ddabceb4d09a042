use ratatui::Terminal;
use ratatui::backend::TestBackend;
use ratatui::crossterm::event::{KeyCode, KeyEvent, KeyModifiers};
use serde_json::{Value, json};

use super::*;
use crate::rig::can_traffic::Bus;

/// A run of two arms, of which the second has a fault.
fn facts() -> Value {
    let names = [
        "yaw",
        "pitch",
        "insertion",
        "roll",
        "wrist_pitch",
        "wrist_yaw",
        "jaw",
    ];
    let axes = names.map(|name| {
        let unit = if name == "insertion" { "m" } else { "rad" };
        let (low, high) = if unit == "m" {
            (0.0, 0.24)
        } else {
            (-1.0, 1.0)
        };
        json!({ "name": name, "unit": unit, "low": low, "high": high, "velocity": 0.5 })
    });
    let buckets = [
        1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000,
    ];
    json!({ "title": "needle-handover", "policy": "expert", "seed": 7, "axes": axes, "buckets_us": buckets, "time_limit_s": 30.0 })
}

fn state() -> Value {
    let arm = |name: &str, state: &str, fault: Option<&str>| {
        json!({
            "name": name, "state": state, "homed": true, "busy": fault.is_none(), "fault": fault, "error": null,
            "measured": [0.0, -0.5, 0.12, 0.25, -1.0, 1.0, 0.3], "commanded": [0.1, -0.5, 0.121, 0.25, -0.99, 1.0, 0.2],
            "commanded_velocity": [0.05, 0.0, 0.01, 0.0, 0.5, -0.5, 0.0], "follows": fault.is_none()
        })
    };
    let histogram = |bucket: usize, max_us: f64| {
        let mut counts = [0; 17];
        counts[bucket] = 900;
        counts[bucket + 1] = 100;
        json!({ "counts": counts, "newest_us": 12.0, "max_us": max_us })
    };
    json!({
        "seconds": 12.345, "silent_s": 0.05,
        "arms": [arm("psm1", "ENABLED", None), arm("psm2", "FAULT", Some("the QP failed"))],
        "filter": { "ago_s": 0.1, "rows": ["psm1 tip speed", "psm1 region 2"], "more": 3, "change": [0.1, 0, 0, 0, -0.02, 0, 0, 0, 0, 0, 0, 0, 0, 0] },
        "counts": {
            "ticks": 12345, "passed": 12000, "solved": 345, "failed": 0, "guard": 2, "guard_ago_s": 4.5, "chunks": 300, "refused": 1,
            "last_refused": "psm1 at 3.20 s: out of order"
        },
        "timing": { "compute": histogram(4, 88.0), "wake": histogram(5, 1250.0), "overruns": 0 },
        "latency": histogram(10, 45_000.0), "speed_percent": 60, "task": "the needle is not held by both"
    })
}

/// The texts of the lines of a terminal of this size.
fn drawn(screen: &Screen, (width, height): (u16, u16)) -> String {
    let mut terminal = Terminal::new(TestBackend::new(width, height)).unwrap();
    terminal.draw(|frame| draw::screen(frame, screen)).unwrap();
    let buffer = terminal.backend().buffer();
    let line = |y| {
        let cells = (0..width).map(|x| buffer[(x, y)].symbol());
        cells.collect::<String>().trim_end().to_owned()
    };
    (0..height).map(line).collect::<Vec<_>>().join("\n") + "\n"
}

fn screen_of(state: Option<Value>) -> Screen {
    Screen {
        facts: serde_json::from_value(facts()).unwrap(),
        state: state.map(|state| serde_json::from_value(state).unwrap()),
        buses: Bus::all(vec![Bus::counted(
            "can0",
            &[(0, 0), (500, 4000), (1500, 12_000)],
        )]),
        answer: Answer {
            text: "pause: ok; 12.30 s; psm1 PAUSED homed".to_owned(),
            refused: false,
        },
    }
}

/// The whole screen, as it is in `screen.txt`.
#[test]
fn the_screen_shows_arms_filter_and_loop() {
    let screen = screen_of(Some(state()));
    let drawn = drawn(&screen, (100, 30));
    assert_eq!(drawn, include_str!("screen.txt"), "\n{drawn}");
}

/// In 80 columns and 24 lines two arms leave room for everything but bars.
#[test]
fn everything_fits_a_small_terminal() {
    let drawn = drawn(&screen_of(Some(state())), (80, 24));
    for text in [
        "Trocar needle-handover, policy expert, seed 7  12.35 s of 30 s  speed 60 %",
        "psm2 FAULT homed, at rest  the QP failed",
        "filter +10 %",
        "12000 passed, QP 345, failed 0",
        "gate    300 chunks, 1 refused",
        "wake-up p50 ≤ 50 µs, max 1.2 ms",
        "can0    8000 frames/s",
        "p pause r resume e enable d disable c clear -+ speed q quit s stop (no eme",
    ] {
        assert!(drawn.contains(text), "{text} is not in\n{drawn}");
    }
}

/// A run that no task judges has its mark, and the keys of marks in place of those that it refuses.
#[test]
fn a_run_that_takes_a_mark_shows_mark_and_keys() {
    let mut robot = state();
    robot["task"] = Value::Null;
    robot["said"] = json!({ "mark": "failure", "label": "third try" });
    let drawn = drawn(&screen_of(Some(robot)), (100, 30));
    for text in [
        "run     marked failure, label \"third try\"",
        "p pause r resume d disable y success z failure x discard -+ speed q quit s stop (no emergency",
    ] {
        assert!(drawn.contains(text), "{text} is not in\n{drawn}");
    }
}

/// Every size of a terminal is drawn without a panic, and a run that has not begun is.
#[test]
fn every_size_is_drawn() {
    for width in [1, 10, 40, 80, 200] {
        for height in [1, 3, 10, 24, 60] {
            drawn(&screen_of(Some(state())), (width, height));
        }
    }
    let waiting = drawn(&screen_of(None), (80, 24));
    assert!(waiting.contains("Trocar needle-handover"), "{waiting}");
}

fn said(text: &str) -> Option<KeyAction> {
    Some(KeyAction::Send(text.parse().unwrap()))
}

/// The letters are those of the console's page, and as there the mark that is set is taken back.
#[test]
fn a_run_is_marked_by_the_keys_of_the_page() {
    let page = include_str!("../console/page/index.html");
    for (key, mark) in [
        ('y', RunMark::Success),
        ('z', RunMark::Failure),
        ('x', RunMark::Discard),
    ] {
        let name = mark.name();
        let button = format!("data-mark=\"{name}\" data-key=\"{key}\"");
        assert!(page.contains(&button), "{button}");
        let pressed = KeyEvent::new(KeyCode::Char(key), KeyModifiers::NONE);
        let marks = |set| wish(pressed, 100, set);
        assert_eq!(marks(None), said(&format!("mark {name}")));
        assert_eq!(marks(Some(mark)), said("mark none"));
    }
}

#[test]
fn keys_are_the_operators_commands() {
    let pressed = |key| wish(KeyEvent::new(key, KeyModifiers::NONE), 95, None);
    for (key, text) in [
        ('p', "pause"),
        ('r', "resume"),
        ('s', "stop"),
        ('e', "enable"),
        ('d', "disable"),
        ('c', "clear"),
        ('-', "speed 85"),
        ('+', "speed 100"),
    ] {
        assert_eq!(pressed(KeyCode::Char(key)), said(text), "{key}");
    }
    let slow = wish(
        KeyEvent::new(KeyCode::Char('-'), KeyModifiers::NONE),
        5,
        None,
    );
    assert_eq!(slow, said("speed 1"));
    assert_eq!(pressed(KeyCode::Char('k')), None);
    for quit in [
        KeyEvent::new(KeyCode::Char('q'), KeyModifiers::NONE),
        KeyEvent::new(KeyCode::Esc, KeyModifiers::NONE),
        KeyEvent::new(KeyCode::Char('c'), KeyModifiers::CONTROL),
    ] {
        assert_eq!(wish(quit, 100, None), Some(KeyAction::Quit));
    }
}
