//! Logs whose bound left out the beginning: they replay from the controller's state where they
//! begin.

use std::path::Path;

use hal::config::Source;
use hal::{ArmError, ArmState, PerArm, TimeNs};

use super::falsified::{Item, items, read, rehash, written};
use super::two_arms::{SCENE, chunk_of_arm, start};
use super::{
    LogError, Pressure, Recorder, RunHeader, RunLog, Scratch, TickRecord, TickTiming, Writing,
    header, outcome,
};
use crate::RunOutcome;
use crate::bound::{SPARE_BYTES, earlier};
use crate::replay::{ReplayError, ReplayResult, replay, replay_file};
use crate::verify::verify;
use trocar_control::{
    AnyController, CommandHash, ControlConfig, OperatorEvent, SnapshotError, TickInput,
};

/// Ticks of a run: of a file there are far fewer.
const TICKS: u64 = 14_000;

/// Bytes of a file, about: the controller's state that may end it counts.
const FILE_BYTES: u64 = 500_000;

/// The files of a run of one arm, or of two.
struct Files {
    last: Scratch,
    before: Scratch,
}

/// What the operator does; the arms fault once, and are enabled again.
fn operator(tick: u64) -> Option<OperatorEvent> {
    Some(match tick {
        1 | 5800 => OperatorEvent::Enable,
        5700 => OperatorEvent::Clear,
        _ => match tick % 2000 {
            700 => OperatorEvent::Speed { percent: 40 },
            1300 => OperatorEvent::Pause,
            1500 => OperatorEvent::Resume,
            1600 => OperatorEvent::Speed { percent: 100 },
            _ => return None,
        },
    })
}

/// A run of the real controller; its log has a bound, and the controller's state if it `keeps`
/// that.
fn run(name: &str, safety: &Source, keeps: bool) -> Files {
    let control = ControlConfig::default_control();
    let config = ControlConfig::load(&control, safety).unwrap();
    let mut controller = AnyController::new(&config).unwrap();
    let last = Scratch::new(name);
    let texts = [
        ("control.toml", control.text()),
        ("safety.toml", safety.text()),
    ];
    let header = RunHeader {
        texts: texts
            .map(|(name, text)| (name.to_owned(), text.to_owned()))
            .into(),
        ..header()
    };
    let writing = Writing {
        bytes_max: Some(2 * (FILE_BYTES + SPARE_BYTES)),
        ..Writing::new(Pressure::Block)
    };
    let mut recorder = Recorder::create_with(&last.0, &header, writing).unwrap();
    let place = (start(), 0.4);
    let mut places = match controller.arm_count() {
        1 => PerArm::one(place),
        _ => PerArm::two(place, place),
    };
    let mut commands = CommandHash::new();
    for tick in 0..TICKS {
        let now = TimeNs::from_tick(tick);
        let chunks = [0, 1].map(|arm| {
            let mut chunk = chunk_of_arm(arm, (tick / 250) % 4 + 1);
            (chunk.sequence, chunk.observed_at) = (tick / 250 + 1, now);
            (tick % 250 == 20).then_some(chunk)
        });
        let mut given = chunks.iter();
        let inputs = places.map(|(mut position, jaw)| {
            position[1] += 1e-5 * f64::from(u8::try_from(tick % 7).unwrap());
            let state = ArmState::at_rest(now, position, jaw);
            TickInput {
                now,
                measured: match tick {
                    5000 => Err(ArmError::MeasurementLost { age_ns: 9 }),
                    _ => Ok(state),
                },
                chunk: given.next().unwrap().as_ref(),
                operator: operator(tick),
            }
        });
        let outputs = controller.tick(&inputs);
        places = outputs.map(|output| (output.command.position, output.command.jaw_position));
        for (arm, (input, output)) in inputs.zip(outputs).iter().enumerate() {
            commands.add(&output.command);
            if let Some(chunk) = input.chunk {
                recorder.chunk(arm, chunk);
            }
        }
        let timing = TickTiming::default();
        recorder.tick(&TickRecord::new(tick, inputs, outputs, timing));
        if keeps {
            recorder.snapshot(&controller);
        }
    }
    let outcome = RunOutcome {
        command_hash: format!("{:016x}", commands.value()),
        ..outcome()
    };
    recorder.finish(Some(&outcome)).unwrap();
    Files {
        before: Scratch(earlier(&last.0)),
        last,
    }
}

fn one_arm(name: &str, keeps: bool) -> Files {
    run(name, &ControlConfig::needle_lift_safety(), keeps)
}

/// An error of either kind, in words.
#[derive(Debug)]
struct Either(String);

impl From<LogError> for Either {
    fn from(error: LogError) -> Self {
        Self(error.to_string())
    }
}

impl From<ReplayError> for Either {
    fn from(error: ReplayError) -> Self {
        Self(error.to_string())
    }
}

/// What a replay says of the file at `path`, and of what lies beside it.
fn of_file(path: &Path) -> ReplayResult {
    let replayed: Result<_, Either> = replay_file(path);
    replayed.unwrap_or_else(|Either(told)| panic!("{told}"))
}

/// That a file is identical from its first tick on.
fn identical(path: &Path) -> (RunLog, ReplayResult) {
    let log = RunLog::open(path).unwrap();
    let replayed = replay(&log).unwrap();
    assert!(replayed.identical, "{:?}", replayed.first_difference);
    let streamed = of_file(path);
    let alone = ReplayResult {
        edge_checked: false,
        ..streamed.clone()
    };
    assert_eq!(alone, replayed, "the file before has no part in it");
    let (first, _) = log.ticks().next().unwrap();
    let kept_from = replayed.kept_from.unwrap();
    assert_eq!(kept_from.left_out, log.header.left_out);
    assert_eq!(kept_from.left_out, first.tick, "no tick was dropped");
    assert!((kept_from.at_s - first.now.seconds()).abs() < 1e-12);
    assert_eq!(replayed.ticks, log.tick_count() as u64);
    (log, streamed)
}

#[test]
fn what_a_bound_kept_replays_from_its_beginning() {
    let handover = Source::embedded("handover.toml", SCENE);
    for (name, safety) in [
        ("kept-one", ControlConfig::needle_lift_safety()),
        ("kept-two", handover),
    ] {
        let files = run(name, &safety, true);
        let mut next = None;
        for file in [&files.before, &files.last] {
            let (log, replayed) = identical(&file.0);
            assert!(replayed.bounded && replayed.inputs_checked && log.header.left_out > 0);
            assert_eq!(replayed.edge_checked, next.is_some(), "of the second alone");
            let ticks: Vec<u64> = log.ticks().map(|(tick, _)| tick.tick).collect();
            assert!(ticks.len() >= 250 && next.is_none_or(|next| next == ticks[0]));
            next = ticks.last().map(|last| last + 1);
            let verified = verify(&log).unwrap();
            assert_eq!((verified.violation_count, verified.bounded), (0, true));
        }
        assert_eq!(next, Some(TICKS), "the last file goes to the end");
    }
}

/// What is on disk once a process was killed.
#[test]
fn a_cut_part_replays_up_to_the_cut() {
    let files = one_arm("kept-cut", true);
    let bytes = std::fs::read(&files.before.0).unwrap();
    std::fs::write(&files.before.0, &bytes[..bytes.len() * 2 / 3]).unwrap();
    let (_, replayed) = identical(&files.before.0);
    assert!(replayed.cut.is_some() && !replayed.bounded && !replayed.inputs_checked);
}

#[test]
fn a_part_without_the_controllers_state_is_refused() {
    let files = one_arm("kept-none", false);
    let error = replay(&RunLog::open(&files.last.0).unwrap()).unwrap_err();
    assert!(matches!(error, ReplayError::LeftOut { .. }), "{error}");
    let told = error.to_string();
    assert!(told.contains("nothing to replay the others from"), "{told}");
}

/// Where the controller's state is in a file: first, and last.
fn snapshots(items: &[Item]) -> (usize, usize) {
    let is = |item: &Item| matches!(item, Item::Message(topic, ..) if topic == "/snapshot");
    let first = items.iter().position(is).unwrap();
    (first, items.iter().rposition(is).unwrap())
}

/// Changes a message as JSON.
fn change(item: &mut Item, how: impl Fn(&mut serde_json::Value)) {
    let Item::Message(_, _, data) = item else {
        panic!("it is a message");
    };
    let mut message = serde_json::from_slice(data).unwrap();
    how(&mut message);
    *data = serde_json::to_vec(&message).unwrap();
}

/// Words of the controller's state in a message.
fn state_words(item: &Item) -> usize {
    let Item::Message(_, _, data) = item else {
        panic!("it is a message");
    };
    let message: serde_json::Value = serde_json::from_slice(data).unwrap();
    message["state"].as_str().unwrap().len() / 16
}

/// Flips a bit of a word of the controller's state.
fn flip(item: &mut Item, word: usize, bit: u32) {
    change(item, |message| {
        let state = message["state"].as_str().unwrap();
        let digits = &state[16 * word..16 * (word + 1)];
        let flipped = u64::from_str_radix(digits, 16).unwrap() ^ (1 << bit);
        let (before, after) = (&state[..16 * word], &state[16 * (word + 1)..]);
        message["state"] = format!("{before}{flipped:016x}{after}").into();
    });
}

/// What a replay says of a part that was changed, all hashes over it being right again.
fn said(part: &[Item], change: impl Fn(&mut Vec<Item>)) -> Result<ReplayResult, ReplayError> {
    let mut items = part.to_vec();
    change(&mut items);
    rehash(&mut items);
    replay(&read(&items).unwrap())
}

/// What differs.
fn found(part: &[Item], change: impl Fn(&mut Vec<Item>)) -> String {
    let said = said(part, change).unwrap();
    assert!(!said.identical);
    said.first_difference.unwrap().what
}

#[test]
fn a_falsified_state_is_found() {
    let files = one_arm("kept-false", true);
    let part = items(&files.before);
    let (first, last) = snapshots(&part);
    assert!(first < last);
    assert!(said(&part, |_| ()).unwrap().identical);
    // The state at the end is compared word by word.
    let words = state_words(&part[last]);
    for word in (0..words).step_by(words / 12) {
        assert_eq!(
            found(&part, |items| flip(&mut items[last], word, 0)),
            "state"
        );
    }
    // The commanded positions come after time, operating state and flags, and show in the first
    // command.
    for axis in 0..7 {
        let what = found(&part, |items| flip(&mut items[first], 6 + axis, 30));
        assert!(what.starts_with("position."), "{what}");
    }
    // What no command shows is there at the end still: how many chunks were accepted.
    for (place, key, what) in [
        (last, "input_hash", "inputs"),
        (last, "command_hash", "command_hash"),
        (first, "input_hash", "inputs"),
        (first, "command_hash", "command_hash"),
    ] {
        let differs = found(&part, |items| {
            change(&mut items[place], |it| it[key] = "00".repeat(8).into());
        });
        assert_eq!(differs, what);
    }
    // A chunk that the controller holds, and what it says of itself.
    let jaw = |it: &mut serde_json::Value| {
        it["chunks"][0]["chunk"]["targets"][49][7] = 0.123.into();
    };
    let differs = found(&part, |items| change(&mut items[last], jaw));
    assert_eq!(differs, "state");
    let other = |it: &mut serde_json::Value| it["layout"] = "00".repeat(8).into();
    let refused = said(&part, |items| change(&mut items[first], other)).unwrap_err();
    let layout = matches!(refused, ReplayError::State(SnapshotError::Layout));
    assert!(layout, "{refused}");
    let refused = said(&part, |items| drop(items.remove(first))).unwrap_err();
    assert!(matches!(refused, ReplayError::LeftOut { .. }), "{refused}");
}

/// What no command shows of the state that a file begins with, its last tick does not show either.
#[test]
fn a_falsified_beginning_is_found_by_the_file_before() {
    let files = one_arm("kept-edge", true);
    let part = items(&files.last);
    let (first, _) = snapshots(&part);
    let falsified = |word: usize| {
        let mut items = part.clone();
        flip(&mut items[first], word, 0);
        rehash(&mut items);
        items
    };
    let is_hidden = |word: &usize| {
        let log = read(&falsified(*word)).unwrap();
        replay(&log).is_ok_and(|replayed| replayed.identical)
    };
    let hidden = (0..state_words(&part[first])).rev().find(is_hidden);
    std::fs::write(&files.last.0, written(&falsified(hidden.unwrap()))).unwrap();
    let replayed = of_file(&files.last.0);
    assert!(replayed.edge_checked && !replayed.identical);
    let difference = replayed.first_difference.unwrap();
    assert_eq!(
        (difference.what.as_str(), replayed.ticks),
        ("snapshot.state", 0)
    );
    let name = files.before.0.file_name().unwrap().to_str().unwrap();
    let ends = format!(" where {name} ends");
    assert!(difference.computed.ends_with(&ends), "{difference}");
    for (key, what) in [
        ("input_hash", "snapshot.inputs"),
        ("command_hash", "snapshot.command_hash"),
    ] {
        let mut items = part.clone();
        change(&mut items[first], |it| it[key] = "00".repeat(8).into());
        rehash(&mut items);
        std::fs::write(&files.last.0, written(&items)).unwrap();
        assert_eq!(of_file(&files.last.0).first_difference.unwrap().what, what);
    }
}

/// What lies beside a file is the one before it only if it is of the same run, and ends where the
/// file begins.
#[test]
fn a_file_of_another_run_is_not_the_one_before() {
    let files = one_arm("kept-beside", true);
    let before = items(&files.before);
    assert!(of_file(&files.last.0).edge_checked);
    let (_, end) = snapshots(&before);
    let without_end = |items: &mut Vec<Item>| drop(items.remove(end));
    let of_other_seed = |items: &mut Vec<Item>| {
        for item in items {
            if let Item::Metadata(name, map) = item
                && name == "run"
            {
                map.insert("seed".to_owned(), "7".to_owned());
            }
        }
    };
    let [mut cut, mut other] = [before.clone(), before];
    without_end(&mut cut);
    of_other_seed(&mut other);
    for mut items in [cut, other] {
        rehash(&mut items);
        std::fs::write(&files.before.0, written(&items)).unwrap();
        let replayed = of_file(&files.last.0);
        assert!(replayed.identical && !replayed.edge_checked);
    }
}

#[test]
fn a_falsified_command_or_input_of_a_part_is_found() {
    let files = one_arm("kept-command", true);
    let part = items(&files.before);
    let nth = |topic: &str| {
        let of = |(at, item): (usize, &Item)| {
            matches!(item, Item::Message(its, ..) if its == topic).then_some(at)
        };
        part.iter().enumerate().filter_map(of).nth(300).unwrap()
    };
    let differs = found(&part, |items| {
        let Item::Message(_, _, data) = &mut items[nth("/psm1/setpoint_js")] else {
            panic!("it is a message");
        };
        // Within the last number of a joint.
        let at = data.len() - 4;
        data[at] ^= 1;
    });
    assert!(!differs.is_empty() && differs != "contents", "{differs}");
    // Without the hashes being made right again, anything shows.
    let mut items = part.clone();
    let at = nth("/timing");
    change(&mut items[at], |it| it["compute_ns"] = 77.into());
    let replayed = replay(&read(&items).unwrap()).unwrap();
    assert_eq!(replayed.first_difference.unwrap().what, "contents");
}
