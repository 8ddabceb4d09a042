//! What is no episode: each log is named, with what helps, and nothing is written.

use std::fs;
use std::path::PathBuf;

use hal::ArmError;
use trocar_log::{LogEnd, RunOutcome};

use super::super::LogImportOptions;
use super::super::episode::whole;
use super::hand_made::{Feed, HandMade, jittered, options};
use super::*;

/// The message with which `options` are refused as bad input, before the dataset's folder is there.
fn refused(options: &LogImportOptions) -> String {
    let error = import_logs(options, &mut |_, _| {}).unwrap_err();
    assert!(error.is_bad_input(), "{error}");
    assert!(!options.out.exists(), "{error}");
    error.to_string()
}

fn check(name: &str, made: &HandMade, expected: &str) {
    let folder = Scratch::folder(&format!("import-log-{name}"));
    let log = made.write(&folder.join("b.mcap"));
    let message = refused(&options(&folder, &[&log]));
    let place = format!("{}: ", log.display());
    assert!(message.starts_with(&place), "{message}");
    assert!(message.contains(expected), "no {expected:?} in: {message}");
}

#[test]
fn a_log_without_frames_is_refused() {
    let blind = HandMade {
        cameras: Vec::new(),
        ..HandMade::default()
    };
    check(
        "blind",
        &blind,
        "has no camera frames; `trocar run --cameras",
    );
    let folder = Scratch::folder("import-log-no-camera");
    let log = HandMade::default().write(&folder.join("a.mcap"));
    let mut options = options(&folder, &[&log]);
    options.cameras = vec!["wrist".to_owned()];
    let message = refused(&options);
    assert!(
        message.contains("has no frames of wrist, only of endoscope"),
        "{message}"
    );
}

#[test]
fn too_few_frames_are_refused_with_rate_and_gap() {
    let slow = |name, rate_hz| Feed::new(name, jittered(rate_hz, 1200, 0));
    let made = |cameras| HandMade {
        cameras,
        ..HandMade::default()
    };
    let expected = "too few frames of endoscope for --fps 25: it has 10.0 a second, and none for";
    check("slow", &made(vec![slow("endoscope", 10)]), expected);
    check(
        "slow-fps",
        &made(vec![slow("endoscope", 10)]),
        "(at most 80 ms, and one step of 20 without its own); --fps 10 is possible",
    );
    let both = vec![slow("endoscope", 30), slow("wrist", 4)];
    let expected = "too few frames of wrist for --fps 25: it has 4.0 a second";
    check("slow-second", &made(both), expected);
    // A hole of 0.4 s in a camera of 30 Hz.
    let mut hole = slow("endoscope", 30);
    hole.stamps_ns
        .retain(|stamp| !(500_000_000..900_000_000).contains(stamp));
    check(
        "hole",
        &made(vec![hole]),
        "none for 433 ms from 0.47 s on (at most 80 ms,",
    );
    // One that shows nothing for the last four seconds.
    let early = HandMade {
        ticks: 6000,
        ..HandMade::default()
    };
    check("early", &early, "leave the log out");
}

#[test]
fn logs_of_another_robot_are_refused() {
    let folder = Scratch::folder("import-log-others");
    let first = HandMade::default().write(&folder.join("first.mcap"));
    let endoscope = || Feed::new("endoscope", jittered(30, 1200, 0));
    let larger = Feed {
        side: 16,
        ..endoscope()
    };
    let more = vec![endoscope(), Feed::new("wrist", jittered(30, 1200, 0))];
    let made = |arms, cameras| HandMade {
        arms,
        cameras,
        ..HandMade::default()
    };
    for (other, expected) in [
        (
            made(2, vec![endoscope()]),
            "two arms and the cameras endoscope (8 x 8)",
        ),
        (
            made(1, vec![larger]),
            "one arm and the cameras endoscope (16 x 16)",
        ),
        (made(1, more), "the cameras endoscope, wrist"),
    ] {
        let other = other.write(&folder.join("other.mcap"));
        let message = refused(&options(&folder, &[&first, &other]));
        let expected = format!("other.mcap: has {expected}");
        let expected = expected.replace("has the cameras", "has one arm and the cameras");
        assert!(message.contains(&expected), "no {expected:?} in: {message}");
        assert!(message.contains("the first log"), "{message}");
    }
}

#[test]
fn images_that_change_their_size_are_refused() {
    let late = Feed {
        side: 16,
        ..Feed::new("endoscope", jittered(30, 1200, 0))
    };
    let mut early = Feed::new("endoscope", jittered(30, 1200, 0));
    early.stamps_ns.truncate(10);
    let mut made = HandMade {
        cameras: vec![early, late],
        ..HandMade::default()
    };
    made.cameras[1].stamps_ns.drain(..10);
    check(
        "sizes",
        &made,
        "endoscope are 8 x 8 at first and 16 x 16 at 0.3",
    );
}

#[test]
fn a_log_that_is_not_its_whole_run_is_refused() {
    let folder = Scratch::folder("import-log-cut");
    let log = HandMade::default().write(&folder.join("a.mcap"));
    let bytes = fs::read(&log).unwrap();
    fs::write(&log, &bytes[..bytes.len() / 2]).unwrap();
    let message = refused(&options(&folder, &[&log]));
    assert!(
        message.contains("a.mcap: the log is cut off (the file ends at byte"),
        "{message}"
    );
    let bounded = HandMade {
        bounded: true,
        ..HandMade::default()
    };
    check("bounded", &bounded, "record without --log-max-mb");
    let crashed = HandMade {
        ends: false,
        ..HandMade::default()
    };
    check("crashed", &crashed, "it does not say how its run ended");
}

/// What the operator said is not dropped, whatever it means.
#[test]
fn a_mark_that_is_not_known_is_refused() {
    let end = |mark: Option<&str>| LogEnd {
        outcome: Some(RunOutcome::default()),
        unknown_mark: mark.map(str::to_owned),
        ..LogEnd::default()
    };
    let log = PathBuf::from("a.mcap");
    whole(&log, end(None)).unwrap();
    let error = whole(&log, end(Some("good"))).unwrap_err();
    assert!(error.is_bad_input(), "{error}");
    assert_eq!(
        error.to_string(),
        "a.mcap: its mark is \"good\", which is none of success, failure and discard; import it with the version that recorded it"
    );
}

#[test]
fn hands_that_cannot_be_read_are_refused() {
    for text in ["[2]", "{"] {
        let made = HandMade {
            teleop: Some(text),
            ..HandMade::default()
        };
        check("hands", &made, &format!("its `teleop` is {text:?}"));
    }
}

#[test]
fn what_is_no_log_is_refused() {
    let folder = Scratch::folder("import-log-none");
    let text = folder.join("a.mcap");
    fs::write(&text, "no log\n").unwrap();
    let absent: PathBuf = folder.join("absent.mcap");
    for (log, expected) in [
        (&text, "a.mcap: not an MCAP file"),
        (&absent, "absent.mcap: cannot be read"),
    ] {
        let message = refused(&options(&folder, &[log]));
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn unusable_numbers_are_refused() {
    let changed = |change| HandMade {
        change,
        ..HandMade::default()
    };
    let measured = changed(|record| {
        if let (600..640, Ok(state)) = (record.tick, &mut record.arms.first.measured) {
            state.position[2] = f64::NAN;
        }
    });
    check(
        "nan",
        &measured,
        "the measurement of psm1 is non-finite at 0.6",
    );
    let target = changed(|record| {
        if let (600..640, Some(target)) = (record.tick, &mut record.arms.first.report.target) {
            target.jaw = f64::INFINITY;
        }
    });
    check(
        "infinite",
        &target,
        "the target of psm1 is non-finite at 0.6",
    );
    let lost = changed(|record| {
        if let 600..640 = record.tick {
            record.arms.first.measured = Err(ArmError::MeasurementLost { age_ns: 1 });
        }
    });
    check("lost", &lost, "lacks a measurement of psm1 at 0.6");
    let skipped = changed(|record| {
        if record.tick >= 600 {
            record.tick += 100;
            record.now = hal::TimeNs::from_tick(record.tick);
            if let Ok(state) = &mut record.arms.first.measured {
                state.stamp = record.now;
            }
        }
    });
    check(
        "skipped",
        &skipped,
        "lacks ticks, which the logger dropped, at 0.6",
    );
}

#[test]
fn a_run_that_asks_for_nothing_is_no_episode() {
    let idle = HandMade {
        change: |record| record.arms.first.report.target = None,
        ..HandMade::default()
    };
    check("idle", &idle, "never ENABLED with a target");
    let folder = Scratch::folder("import-log-failed");
    let failed = HandMade {
        task: "needle-lift",
        success: Some(false),
        ..HandMade::default()
    };
    let log = failed.write(&folder.join("a.mcap"));
    let message = refused(&options(&folder, &[&log]));
    assert_eq!(
        message,
        "none of the 1 runs has done its task; --failures takes them"
    );
}
