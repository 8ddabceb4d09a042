//! What a page may say, and what comes of it.

use hal::random::SplitMix64;
use serde_json::{Value, json};
use tests::json;
use tungstenite::Message;

use crate::page::{Page, PageEvent};
use crate::run::{GROWTH_MB, Served, mutated_messages};

/// Mutated messages that are sent at least.
const MUTATED: usize = 6000;

fn steering(served: &Served) -> Page {
    let mut page = Page::open(served);
    take_control(&mut page);
    page.wait_for_state("ENABLED");
    page
}

/// Asks to steer until the page before it is known to be gone.
fn take_control(page: &mut Page) {
    let mut steers = false;
    while !steers {
        page.say(&json!({ "steer": true }));
        steers = page.wait_for("seat", |_| true)["steers"] == true;
    }
}

#[test]
fn one_page_steers_and_others_look_on() {
    let mut served = Served::run("console-steering", "random");
    let mut one = steering(&served);
    let mut other = Page::open(&served);
    other.say(&json!({ "steer": true }));
    let seat = other.wait_for("seat", |seat| seat["pages"] == 2);
    assert_eq!(
        (&seat["steers"], &seat["taken"]),
        (&json!(false), &json!(true))
    );
    for command in ["resume", "enable", "disable", "speed 10", "clear"] {
        let (ok, said) = other.command(command);
        assert!(
            !ok && said.contains("another page steers"),
            "{command}: {said}"
        );
    }
    other.wait_for_state("ENABLED");

    // Every page may bring the arms to rest; only the one that steers lets them move again.
    let (ok, said) = other.command("pause");
    assert!(ok, "{said}");
    other.wait_for_state("PAUSED");
    assert!(!other.command("resume").0);
    assert!(one.command("pause").0);
    let (ok, said) = one.command("enable");
    assert!(
        !ok && said.contains("enable does not apply in PAUSED"),
        "{said}"
    );
    assert!(one.command("speed 40").0);
    other.wait_for("state", |state| state["speed_percent"] == 40);
    // More than the whole, or anything that is no verb of the operator's, does not get further than
    // the console.
    for command in [
        "speed 101",
        "speed 0",
        "limits",
        "set control.limits.tip_speed_m_s=1",
        "",
    ] {
        let (ok, said) = one.command(command);
        assert!(!ok && said.contains("is no command"), "{command}: {said}");
    }
    assert!(one.command("resume").0);
    other.wait_for_state("ENABLED");
    assert!(one.command("disable").0);
    other.wait_for_state("DISABLED");
    assert!(one.command("enable").0);
    other.wait_for_state("ENABLED");

    drop(one);
    other.wait_for("seat", |seat| seat["taken"] == false);
    take_control(&mut other);
    assert!(other.command("stop").0);
    let end = other.wait_for("end", |_| true);
    assert_eq!(end["reason"], "stopped by the operator");
    assert!(matches!(other.hear(), PageEvent::Closed(1000)));
    assert_eq!(served.code(), 1);
    let result = json(&served.folder.join("result.json"));
    assert_eq!(result["reason"], "stopped by the operator");
}

#[test]
fn a_page_hears_what_the_run_does() {
    let served = Served::run("console-told", "expert");
    let mut page = Page::open(&served);
    let facts = page.wait_for("facts", |_| true);
    assert_eq!(facts["title"], "needle-lift");
    assert_eq!(facts["arms"], json!(["psm1"]));
    assert_eq!(facts["axes"].as_array().unwrap().len(), 7);
    let cameras = facts["cameras"].as_array().unwrap();
    assert!(cameras.contains(&json!("endoscope")), "{cameras:?}");
    let endoscope = cameras.iter().position(|name| name == "endoscope").unwrap();
    page.say(&json!({ "show": [[endoscope, "colour"], [endoscope, "ids"]] }));
    let mut planes = std::collections::BTreeSet::new();
    while planes.len() < 2 {
        let picture = page.wait_for_picture();
        assert_eq!(usize::from(picture[0]), endoscope);
        planes.insert(picture[1]);
        let start = if picture[1] == 0 {
            &[0xff, 0xd8][..]
        } else {
            &b"\x89PNG"[..]
        };
        assert!(picture[16..].starts_with(start));
    }
    let state = page.wait_for("state", |state| {
        state["counts"]["chunks"].as_u64() > Some(2)
    });
    let arm = &state["arms"][0];
    assert_eq!(
        (&arm["name"], &arm["homed"]),
        (&json!("psm1"), &json!(true))
    );
    for key in [
        "measured",
        "commanded",
        "measured_velocity",
        "commanded_velocity",
    ] {
        assert_eq!(arm[key].as_array().unwrap().len(), 7, "{key}");
    }
    assert!(state["task"].is_string(), "{state}");
    let criteria = state["criteria"].as_array().unwrap();
    let lasts = criteria.last().unwrap();
    assert_eq!(
        (&lasts["unit"], &lasts["met"]),
        (&json!("s"), &json!(false))
    );
    assert!(criteria.iter().all(|it| it["goal"].is_f64()), "{state}");
    let ticks = state["counts"]["ticks"].as_u64().unwrap();
    for (histogram, before) in [("compute", 0), ("wake", 0), ("period", 1)] {
        let counts = state["timing"][histogram]["counts"].as_array().unwrap();
        let sum: u64 = counts.iter().map(|count| count.as_u64().unwrap()).sum();
        // The first tick ends no period.
        assert_eq!(sum + before, ticks, "{histogram}");
    }
}

/// A page that acknowledges nothing is sent a few messages and no more; what it then gets is of
/// now. Of the end it is told all the same.
#[test]
fn a_slow_page_sees_the_newest() {
    let mut served = Served::run("console-slow", "noop");
    let mut slow = Page::open(&served);
    let mut watching = Page::open(&served);
    let facts = watching.wait_for("facts", |_| true);
    assert!(facts["cameras"].is_array());
    watching.say(&json!({ "show": [[0, "colour"]] }));
    slow.say(&json!({ "show": [[0, "colour"]] }));
    while slow.unacknowledged < 8 {
        slow.hear();
    }
    // Two seconds of the run go by.
    let seconds = |state: &Value| state["seconds"].as_f64().unwrap();
    let before = seconds(&watching.wait_for_state("ENABLED"));
    let (mut later, mut shown) = (before, 0.0);
    while later <= before + 2.0 || shown <= before {
        match watching.hear() {
            PageEvent::Text(text) if text["kind"] == "state" => later = seconds(&text),
            PageEvent::Text(_) => {}
            PageEvent::Picture(bytes) => {
                shown = f64::from_le_bytes(bytes[8..16].try_into().unwrap())
            }
            PageEvent::Closed(code) => panic!("closed with {code}"),
        }
        watching.acknowledge();
    }
    slow.acknowledge();
    let mut first_state = None;
    let mut first_picture = None;
    while first_state.is_none() || first_picture.is_none() {
        match slow.hear() {
            PageEvent::Text(text) if text["kind"] == "state" => {
                first_state.get_or_insert(seconds(&text));
            }
            PageEvent::Text(_) => {}
            PageEvent::Picture(bytes) => {
                let stamp = f64::from_le_bytes(bytes[8..16].try_into().unwrap());
                first_picture.get_or_insert(stamp);
            }
            PageEvent::Closed(code) => panic!("closed with {code}"),
        }
        slow.acknowledge();
    }
    assert!(first_state >= Some(later), "{first_state:?} at {later}");
    assert!(first_picture >= Some(shown), "{first_picture:?} at {shown}");

    while slow.unacknowledged < 8 {
        if let PageEvent::Closed(code) = slow.hear() {
            panic!("closed with {code}");
        }
    }
    assert!(watching.command("stop").0);
    let ended = |heard: PageEvent| matches!(heard, PageEvent::Text(text) if text["kind"] == "end");
    assert!(ended(slow.hear()));
    assert!(matches!(slow.hear(), PageEvent::Closed(1000)));
    assert_eq!(served.code(), 1);
}

#[test]
fn too_large_and_too_many_messages_end_a_page() {
    let served = Served::run("console-bounds", "noop");
    let mut large = Page::open(&served);
    large
        .socket
        .send(Message::text("x".repeat(100_000)))
        .unwrap();
    while !matches!(large.hear(), PageEvent::Closed(_)) {}
    let mut many = Page::open(&served);
    let mut sent = 0;
    while many.socket.send(Message::text("{}")).is_ok() && sent < 10_000 {
        sent += 1;
    }
    let mut code = None;
    while code.is_none() {
        if let PageEvent::Closed(closed) = many.hear() {
            code = Some(closed);
        }
    }
    assert!(matches!(code, Some(1008 | 1006)), "{code:?}");
    let pages: Vec<Page> = (0..64).map(|_| Page::open(&served)).collect();
    let mut one_more = Page::open(&served);
    assert!(matches!(one_more.hear(), PageEvent::Closed(1013)));
    drop(pages);
}

/// Thousands of broken messages, from the page that steers: none moves the paused arm or resumes
/// it, and the console stands.
#[test]
fn mutated_messages_do_nothing() {
    let mut served = Served::run("console-mutated", "random");
    let mut page = steering(&served);
    assert!(page.command("pause").0);
    page.wait_for("state", |state| {
        state["arms"][0]["busy"] == false && state["arms"][0]["state"] == "PAUSED"
    });
    let still = page.wait_for_state("PAUSED")["arms"][0]["commanded"].clone();
    let mut random = SplitMix64::new(7);
    let (mut sent, resident_mb) = (0, served.resident_mb());
    while sent < mutated_messages(MUTATED) {
        for _ in 0..200 {
            let message = mutated(&mut random);
            if page.socket.send(message).is_err() {
                break;
            }
            sent += 1;
        }
        page = Page::open(&served);
        take_control(&mut page);
        let state = page.wait_for("state", |_| true);
        assert_eq!(state["arms"][0]["state"], "PAUSED");
        assert_eq!(state["arms"][0]["commanded"], still);
    }
    assert_eq!(served.process.try_wait().unwrap(), None);
    let after_mb = served.resident_mb();
    assert!(
        after_mb < resident_mb + GROWTH_MB,
        "{resident_mb} MB, then {after_mb}"
    );
    assert!(page.command("resume").0);
    page.wait_for_state("ENABLED");
}

/// A message of the page with something wrong in it. None is a verb that would move the arm:
/// `resume` and `enable` are not among what it is made of, nor what changing it could make.
fn mutated(random: &mut SplitMix64) -> Message {
    const WHOLE: [&str; 6] = [
        r#"{"command":"pause"}"#,
        r#"{"command":"speed 55"}"#,
        r#"{"show":[[0,"colour"],[1,"depth"]]}"#,
        r#"{"steer":true}"#,
        r#"{"seen":4}"#,
        r#"{"at":12.5}"#,
    ];
    let mut bytes = WHOLE[index(random, WHOLE.len())].as_bytes().to_vec();
    for _ in 0..=index(random, 4) {
        let at = index(random, bytes.len().max(1));
        #[expect(clippy::cast_possible_truncation, reason = "a byte of it")]
        let byte = random.next_u64() as u8;
        match index(random, 5) {
            0 if !bytes.is_empty() => bytes[at] = byte,
            1 if !bytes.is_empty() => {
                bytes.remove(at);
            }
            2 => bytes.insert(at.min(bytes.len()), byte),
            3 => bytes.extend(bytes.clone()),
            _ => bytes.truncate(at),
        }
    }
    match index(random, 8) {
        0 => Message::binary(bytes),
        1 => Message::Ping(bytes.into_iter().take(100).collect::<Vec<_>>().into()),
        _ => Message::text(String::from_utf8_lossy(&bytes).into_owned()),
    }
}

fn index(random: &mut SplitMix64, count: usize) -> usize {
    usize::try_from(random.next_u64() % count as u64).unwrap()
}
