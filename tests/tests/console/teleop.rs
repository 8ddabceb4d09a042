//! Teleoperation as a page does it: hands move the arm, and whatever is lost stops it.

use std::path::Path;

use hal::random::SplitMix64;
use serde_json::{Value, json};
use tests::{json, stderr};
use trocar::rt::MonotonicClock;
use trocar_control::kinematics::forward;
use trocar_log::RunLog;
use tungstenite::Message;

use crate::page::Page;
use crate::run::{GROWTH_MB, Served, mutated_messages, verified};

/// Mutated messages that are sent at least.
const MUTATED: usize = 3000;

/// An episode as long as a million of them take.
const MINUTES: &str = "scene.episode.time_limit_s=300";

/// A run that a page moves by hand, in slow motion: machines that build beside it must not make
/// hands late.
fn by_hand(test: &str, task: &str) -> Served {
    let log = tests::scratch(&format!("{test}-log")).join("run.mcap");
    let words = ["run", "--task", task, "--policy", "teleop", "--seed", "7"];
    let more = ["--set", MINUTES, "--log", log.to_str().unwrap()];
    Served::start_slow(test, &[&words[..], &more].concat(), 4)
}

/// A page with its hand, in the axes of the picture.
pub(crate) struct Operator {
    pub(crate) page: Page,
    clutch: bool,
    at: [f64; 3],
    jaw: f64,
    clock: MonotonicClock,
}

impl Operator {
    pub(crate) fn take_control(mut page: Page) -> Self {
        let mut steers = false;
        while !steers {
            page.say(&json!({ "steer": true }));
            steers = page.wait_for("seat", |_| true)["steers"] == true;
        }
        page.wait_for_state("ENABLED");
        Self {
            page,
            clutch: false,
            at: [0.0; 3],
            jaw: 0.5,
            clock: MonotonicClock::new(),
        }
    }

    /// The same page takes control again.
    fn again(self) -> Self {
        Self {
            clock: self.clock,
            ..Self::take_control(self.page)
        }
    }

    fn message(&self) -> Value {
        let hand =
            json!({ "clutch": self.clutch, "at": self.at, "turn": [0, 0, 0, 1], "jaw": self.jaw });
        json!({ "hands": { "t": self.t(), "arms": [hand] } })
    }

    /// The page's time, ms.
    fn t(&self) -> f64 {
        self.clock.now().seconds() * 1e3
    }

    /// Says where the hand is, once; the state after it.
    pub(crate) fn say(&mut self) -> Value {
        let message = self.message();
        self.page.say(&message);
        self.page.wait_for("state", |_| true)
    }

    pub(crate) fn repeat(&mut self, times: usize) -> Value {
        for _ in 1..times {
            self.say();
        }
        self.say()
    }

    /// Says where the hand is until what the run does fits; the state then.
    pub(crate) fn until(&mut self, fits: impl Fn(&Value) -> bool) -> Value {
        let mut state = self.say();
        for _ in 0..2000 {
            if fits(&state) {
                return state;
            }
            state = self.say();
        }
        panic!("never: {state}");
    }

    /// Takes the clutch, anew if the run lets go of it since a message came late, until it holds.
    pub(crate) fn engage(&mut self) {
        for _ in 0..100 {
            self.clutch = false;
            self.until(|state| lost(state).is_empty() && !engaged(state));
            self.clutch = true;
            if engaged(&self.until(|state| engaged(state) || !lost(state).is_empty())) {
                return;
            }
        }
        panic!("the clutch never holds");
    }

    /// Holds the hand still until the arm rests; the state then.
    pub(crate) fn settle(&mut self) -> Value {
        let mut before = self.say();
        loop {
            let from = seconds(&before) + REST_S;
            let now = self.until(|state| seconds(state) >= from);
            if way(tip(&before), tip(&now)) < 2e-6 {
                return now;
            }
            before = now;
        }
    }

    /// Moves the hand upwards for some messages; the state after it.
    pub(crate) fn rise(&mut self, messages: usize) -> Value {
        for _ in 1..messages {
            self.at[1] += 0.002;
            self.say();
        }
        self.say()
    }
}

/// Time of the run in which an arm that rests does not move, s.
const REST_S: f64 = 0.075;

fn seconds(state: &Value) -> f64 {
    state["seconds"].as_f64().unwrap()
}

pub(crate) fn engaged(state: &Value) -> bool {
    state["teleop"]["arms"][0]["engaged"] == true
}

fn lost(state: &Value) -> String {
    let why = &state["teleop"]["arms"][0]["lost"];
    why.as_str().unwrap_or_default().to_owned()
}

/// Where the tip is commanded to be, in the picture's axes, m.
pub(crate) fn tip(state: &Value) -> [f64; 3] {
    let tip = &state["teleop"]["arms"][0]["tip"];
    std::array::from_fn(|axis| tip[axis].as_f64().unwrap())
}

pub(crate) fn way(one: [f64; 3], other: [f64; 3]) -> f64 {
    let squares = one.iter().zip(other).map(|(a, b)| (a - b) * (a - b));
    squares.sum::<f64>().sqrt()
}

/// Waits until the arm rests; where it is then.
pub(crate) fn rested(page: &mut Page) -> [f64; 3] {
    let mut before = page.wait_for("state", |_| true);
    loop {
        let from = seconds(&before) + REST_S;
        let now = page.wait_for("state", |state| seconds(state) >= from);
        if way(tip(&before), tip(&now)) < 2e-6 {
            return tip(&now);
        }
        before = now;
    }
}

/// What the hand does is what the tip does on the picture, and it holds as the clutch is let go.
fn follows(operator: &mut Operator) {
    let start = rested(&mut operator.page);
    operator.engage();
    assert!(way(tip(&operator.repeat(3)), start) < 1e-4, "no jump");
    operator.rise(9);
    let risen = tip(&operator.settle());
    let (up, aside) = (
        risen[1] - start[1],
        (risen[0] - start[0]).hypot(risen[2] - start[2]),
    );
    // Eight steps of 2 mm at a scale of 0.4.
    assert!(
        (up - 0.0064).abs() < 5e-4 && aside < 1e-3,
        "{start:?} {risen:?}"
    );

    // The clutch is let go: the arm holds, wherever the hand goes.
    operator.clutch = false;
    operator.at = [1.0, -1.0, 0.0];
    operator.until(|state| !engaged(state));
    let held = rested(&mut operator.page);
    assert!(way(held, risen) < 5e-4);
}

/// Does something bad to a hand.
type Loss = fn(&mut Operator);

/// What may befall a hand in mid-motion, and what the page is told of it.
const LOSSES: [(&str, Loss); 4] = [
    ("no hand pose in time", |_| {}),
    ("the page was hidden", |operator| {
        operator.page.say(&json!({ "hands_off": true }))
    }),
    ("the hand jumped", |operator| {
        operator.at[0] += 0.2;
        operator.say();
    }),
    ("an invalid message", |operator| {
        operator
            .page
            .say(&json!({ "hands": { "t": operator.t(), "arms": [
                { "clutch": true, "at": [11, 0, 0], "turn": [0, 0, 0, 1], "jaw": 0 }] } }));
        operator.page.wait_for("problem", |_| true);
    }),
];

/// One thing after the other is lost in mid-motion.
fn loses(operator: &mut Operator) {
    for (why, lose) in LOSSES {
        operator.engage();
        operator.rise(6);
        lose(operator);
        operator.page.wait_for("state", |state| !engaged(state));
        let state = operator.rise(4);
        assert!(
            !engaged(&state) && lost(&state).contains(why),
            "{why}: {state}"
        );
        let rest = rested(&mut operator.page);
        let state = operator.rise(8);
        assert!(
            way(tip(&state), rest) < 1e-5,
            "{why}: moved without a new clutch"
        );
    }
}

/// A second page can't move the arm, nor the first one once it gave up control.
fn another_page_is_not_heard(operator: &mut Operator, second: &mut Page) {
    operator.engage();
    let message = operator.message();
    second.say(&message);
    // The hand stays in sight meanwhile.
    operator.repeat(5);
    let problem = second.wait_for("problem", |_| true);
    assert!(
        problem["text"]
            .as_str()
            .unwrap()
            .contains("take control first")
    );
    assert!(
        engaged(&operator.rise(3)),
        "the other page's message does not matter"
    );
    operator.page.say(&json!({ "steer": false }));
    let told = operator.message();
    operator.page.say(&told);
    operator.page.wait_for("problem", |_| true);
    operator
        .page
        .wait_for("state", |state| lost(state).contains("gave up control"));
}

/// What the hand does is what the tip does on the picture; then one thing after the other is lost
/// in mid-motion. Each time the arm comes to rest at once and goes on resting though the hand moves
/// with its clutch held, until it takes the clutch anew.
#[test]
fn hands_move_the_arm_and_whatever_is_lost_stops_it() {
    let _turn = tests::alone();
    let mut served = by_hand("teleop-lost", "needle-lift");
    let mut operator = Operator::take_control(Page::open(&served));
    follows(&mut operator);
    loses(&mut operator);
    let mut second = Page::open(&served);
    another_page_is_not_heard(&mut operator, &mut second);

    // The steering page's socket closes in mid-motion, the other takes over with its clutch held.
    let mut operator = operator.again();
    operator.engage();
    operator.rise(5);
    drop(operator);
    // What it did not read yet is of before.
    second.wait_for("state", |state| lost(state).contains("connection ended"));
    let rest = rested(&mut second);
    let mut operator = Operator::take_control(second);
    operator.clutch = true;
    let state = operator.rise(8);
    assert!(!engaged(&state) && way(tip(&state), rest) < 1e-5, "{state}");
    operator.engage();
    operator.page.say(&json!({ "command": "pause" }));
    operator.until(|state| {
        state["arms"][0]["state"] == "PAUSED" && lost(state).contains("not enabled")
    });
    assert!(operator.page.command("stop").0);
    operator.page.wait_for("end", |_| true);
    assert_eq!(served.code(), 1);
    let result = json(&served.folder.join("result.json"));
    assert_eq!(result["policy"]["refused"], 0);
    let teleop = &result["teleop"];
    assert!(teleop["forced_releases"].as_u64() >= Some(7), "{teleop}");
    assert!(
        teleop["hand_to_command_ms"]["p99"].as_f64().unwrap() > 0.0,
        "{teleop}"
    );
    verified(&tests::repository().join("target/scratch/teleop-lost-log/run.mcap"));
}

/// The arm that the hand of a two-armed task does not move stays where it is.
#[test]
fn each_hand_moves_its_own_arm() {
    let _turn = tests::alone();
    let served = by_hand("teleop-two", "needle-handover");
    let mut operator = Operator::take_control(Page::open(&served));
    let of = |state: &Value, arm: usize| state["teleop"]["arms"][arm]["tip"].clone();
    let still = json!({ "clutch": false, "at": [0, 0, 0], "turn": [0, 0, 0, 1], "jaw": 0 });
    let step = |operator: &mut Operator, clutch: bool, y: f64| {
        let hand = json!({ "clutch": clutch, "at": [0, y, 0], "turn": [0, 0, 0, 1], "jaw": 0 });
        operator
            .page
            .say(&json!({ "hands": { "t": operator.t(), "arms": [still, hand] } }));
        operator.page.wait_for("state", |_| true)
    };
    let first = of(&step(&mut operator, false, 0.0), 0);
    let second = of(&step(&mut operator, false, 0.0), 1);
    let mut tries = 0;
    loop {
        let state = step(&mut operator, true, 0.0);
        if state["teleop"]["arms"][1]["engaged"] == true {
            break;
        }
        if !state["teleop"]["arms"][1]["lost"].is_null() {
            step(&mut operator, false, 0.0);
        }
        tries += 1;
        assert!(tries < 2000, "{state}");
    }
    // It rises by 30 mm and rests there.
    for count in 0..20 {
        step(&mut operator, true, 0.0015 * f64::from(count));
    }
    let up = |state: &Value| of(state, 1)[1].as_f64().unwrap() - second[1].as_f64().unwrap();
    let mut state = step(&mut operator, true, 0.03);
    for _ in 0..2000 {
        assert_eq!(of(&state, 0), first);
        if (up(&state) - 0.012).abs() < 1e-3 {
            break;
        }
        state = step(&mut operator, true, 0.03);
    }
    let from = seconds(&state) + REST_S;
    while seconds(&state) < from {
        state = step(&mut operator, true, 0.03);
    }
    assert!((up(&state) - 0.012).abs() < 1e-3, "{}", up(&state));
    drop(served);
}

/// Thousands of broken messages of hands, from the page that steers and whose clutch is open: none
/// moves the arm, and the console stands.
#[test]
fn mutated_hands_move_nothing() {
    let _turn = tests::alone();
    let mut served = by_hand("teleop-mutated", "needle-lift");
    let mut operator = Operator::take_control(Page::open(&served));
    let still = rested(&mut operator.page);
    let from = seconds(&operator.page.wait_for("state", |_| true));
    let mut until = from;
    let mut random = SplitMix64::new(11);
    let (mut sent, resident_mb) = (0, served.resident_mb());
    while sent < mutated_messages(MUTATED) {
        for _ in 0..200 {
            if operator.page.socket.send(mutated(&mut random)).is_err() {
                break;
            }
            sent += 1;
        }
        drop(operator);
        operator = Operator::take_control(Page::open(&served));
        let state = operator.page.wait_for("state", |_| true);
        assert!(way(tip(&state), still) < 1e-5, "{state}");
        assert_eq!(state["arms"][0]["state"], "ENABLED");
        until = seconds(&state);
    }
    assert_eq!(served.process.try_wait().unwrap(), None);
    let after_mb = served.resident_mb();
    assert!(
        after_mb < resident_mb + GROWTH_MB,
        "{resident_mb} MB, then {after_mb}"
    );
    operator.engage();
    operator.rise(9);
    // Whole ones still do.
    operator.until(|state| way(tip(state), still) > 0.002);
    assert!(operator.page.command("stop").0);
    operator.page.wait_for("end", |_| true);
    served.code();
    let log = tests::repository().join("target/scratch/teleop-mutated-log/run.mcap");
    verified(&log);
    let moved_m = greatest_way_m(&log, from, until);
    assert!(moved_m < 1e-5, "the tip moved by {moved_m} m");
}

/// How far the commanded tip of the first arm was at most from where it was at `from`, in all ticks
/// of `log` up to `until`, s.
fn greatest_way_m(log: &Path, from: f64, until: f64) -> f64 {
    let log = RunLog::open(log).unwrap();
    let ticks = log.ticks().map(|(tick, _)| tick);
    let ticks = ticks.filter(|tick| (from..until).contains(&tick.now.seconds()));
    let mut tips = ticks.map(|tick| {
        forward(&tick.arms.first.command.position)
            .translation
            .vector
    });
    let first = tips.next().unwrap();
    let ways: Vec<f64> = tips.map(|tip| (tip - first).norm()).collect();
    assert!(ways.len() > 100, "{} ticks", ways.len());
    ways.into_iter().fold(0.0, f64::max)
}

/// A message of hands with something wrong in it. Its clutch is held in none that is whole: a hand
/// that was never heard to let go can't engage, and what changing it makes is at most one that
/// holds it.
fn mutated(random: &mut SplitMix64) -> Message {
    const WHOLE: [&str; 4] = [
        r#"{"hands":{"t":1e9,"arms":[{"clutch":true,"at":[0.5,0.5,0.5],"turn":[0,0,0,1],"jaw":0.5}]}}"#,
        r#"{"hands":{"t":-7,"arms":[{"clutch":true,"at":[-0.1,9e9,0],"turn":[0,1,0,1e-9],"jaw":1}]}}"#,
        r#"{"hands":{"t":0.5,"arms":[null,{"clutch":true,"at":[0,0,0],"turn":[0,0,0,1],"jaw":0}]}}"#,
        r#"{"hands_off":true}"#,
    ];
    let mut bytes = WHOLE[index(random, WHOLE.len())].as_bytes().to_vec();
    for _ in 0..=index(random, 4) {
        let at = index(random, bytes.len().max(1));
        #[expect(clippy::cast_possible_truncation, reason = "a byte of it")]
        let byte = random.next_u64() as u8;
        match index(random, 6) {
            0 if !bytes.is_empty() => bytes[at] = byte,
            1 if !bytes.is_empty() => {
                bytes.remove(at);
            }
            2 => bytes.insert(at.min(bytes.len()), byte),
            3 => bytes.insert(
                at.min(bytes.len()),
                b"0123456789eE-+.,[]{}"[index(random, 20)],
            ),
            4 => bytes.extend(bytes.clone()),
            _ => bytes.truncate(at),
        }
    }
    if index(random, 10) == 0 {
        return Message::binary(bytes);
    }
    Message::text(String::from_utf8_lossy(&bytes).into_owned())
}

fn index(random: &mut SplitMix64, count: usize) -> usize {
    usize::try_from(random.next_u64() % count as u64).unwrap()
}

#[test]
fn teleoperation_needs_real_time_a_console_and_a_task() {
    for (words, reason) in [
        (
            &["--lockstep"][..],
            "--policy teleop: --lockstep has virtual time",
        ),
        (
            &[],
            "--policy teleop: the operator's hands come over --console",
        ),
    ] {
        refused(
            &[
                &["run", "--task", "needle-lift", "--policy", "teleop"],
                words,
            ]
            .concat(),
            reason,
        );
    }
    let words = [
        "eval",
        "--task",
        "needle-lift",
        "--policy",
        "teleop",
        "--trials",
        "1",
    ];
    refused(
        &words,
        "policy teleop: an operator's hands move in real time",
    );
}

/// `trocar WORDS` ends as bad usage that says `reason`.
pub(crate) fn refused(words: &[&str], reason: &str) {
    let output = tests::trocar().args(words).output().unwrap();
    let said = stderr(&output);
    assert_eq!(output.status.code(), Some(2), "{words:?}: {said}");
    assert!(said.contains(reason), "{words:?}: {said}");
}
