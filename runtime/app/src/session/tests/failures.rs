//! Recordings that keep what failed too.

use trocar_data::dataset::Notes;

use super::disturbed::{options, small_lift};
use super::resumed::files;
use super::*;
use crate::session::SessionError;

/// A lift whose first attempt takes longer than the next ones.
fn lift() -> Plan {
    Plan {
        seed: 42,
        ..small_lift(&[])
    }
}

/// The same with so little time that some attempts are too slow.
fn hasty_lift(time_limit_s: f64) -> Plan {
    let mut plan = lift();
    plan.setup.task.time_limit_s = time_limit_s;
    plan
}

/// What fails is in a dataset of its own with its reasons; the other one has the bytes of a
/// recording without.
#[test]
fn attempts_that_fail_are_kept_apart() {
    let folder = Scratch::new("session-failures");
    let path = |name: &str| folder.0.join(name);
    let plain = options(&path("plain"), None);
    let summary = record(&lift(), &plain, &|| false, &mut |_| {}).unwrap();
    let seconds =
        |index: usize| 0.04 * f64::from(u32::try_from(summary.attempts[index].steps).unwrap());
    // Between the two.
    let plan = hasty_lift(0.5 * (seconds(0) + seconds(1)));

    let without = options(&path("without"), None);
    let expected = record(&plan, &without, &|| false, &mut |_| {}).unwrap();
    let with = RecordOptions {
        failures: Some(path("failed")),
        ..options(&path("with"), None)
    };
    let mut summary = record(&plan, &with, &|| false, &mut |_| {}).unwrap();
    let lost: Vec<_> = summary
        .attempts
        .iter()
        .filter(|it| !it.kept)
        .cloned()
        .collect();
    assert!(!lost.is_empty(), "{:?}", summary.attempts);
    assert_eq!(summary.failures.take(), Some(lost.len()));
    assert_eq!(summary, expected);
    assert!(files(&path("with")) == files(&path("without")));

    let (failed, notes) = (
        Dataset::open(&path("failed")).unwrap(),
        Notes::read(&path("failed")).unwrap(),
    );
    assert_eq!(failed.spec(), Dataset::open(&path("with")).unwrap().spec());
    assert_eq!(notes.recording.unwrap()["failures"], true);
    assert_eq!(notes.episodes.len(), lost.len());
    for ((attempt, note), episode) in lost.iter().zip(&notes.episodes).zip(failed.episodes()) {
        assert_eq!(note["failure"], attempt.reason.as_str());
        assert_eq!(note["seed"], attempt.seed);
        assert_eq!(episode.len, attempt.steps);
    }
}

/// Neither a recording that goes on nor a folder that is in use.
#[test]
fn failures_want_a_recording_from_its_start_and_a_new_folder() {
    let folder = Scratch::new("session-failures-refused");
    let plan = small_lift(&[]);
    let refused = |resume: bool, failures: &str| {
        let options = RecordOptions {
            resume,
            failures: Some(folder.0.join(failures)),
            ..options(&folder.0.join("out"), None)
        };
        let error = record(&plan, &options, &|| false, &mut |_| {}).unwrap_err();
        assert!(matches!(error, SessionError::BadArgument(_)), "{error:?}");
        assert!(!folder.0.join("out").exists());
        error.to_string()
    };
    assert!(refused(true, "failed").contains("not with --resume"));
    fs::create_dir_all(folder.0.join("used/mine")).unwrap();
    assert!(refused(false, "used").contains("not an empty folder"));
}
