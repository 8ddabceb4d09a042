//! Runs with faults whose logs have a bound: what is kept replays from where it begins, the faults
//! with it.

use std::fs;
use std::os::unix::fs::MetadataExt as _;
use std::path::{Path, PathBuf};

use tests::{alone, trocar};
use trocar::rt::{MonotonicClock, sleep_ns};
use trocar::session::operator::{Ask, Command as Operator, ask};
use trocar_control::OperatorEvent;
use trocar_log::RunLog;
use trocar_log::replay::{ReplayResult, replay};
use trocar_log::verify::verify;

use super::{CHECKPOINT, MS_NS, PATIENCE_NS, Run, send};

/// Where the part before the last is.
fn earlier(run: &Run) -> PathBuf {
    run.log.with_extension("earlier.mcap")
}

/// Waits until the log has lost its beginning: until a second full file has taken the place of the
/// first.
fn loses_its_beginning(run: &Run) {
    let clock = MonotonicClock::new();
    let file = || fs::metadata(earlier(run)).ok().map(|found| found.ino());
    let mut first = None;
    while first.is_none() || file() == first {
        first = first.or_else(file);
        assert!(clock.now().0 < PATIENCE_NS, "{:?}", run.said());
        sleep_ns(20 * MS_NS);
    }
}

fn operate(run: &Run, event: OperatorEvent) {
    let of = Ask {
        run: Some(run.process.id().to_string()),
        json: false,
    };
    ask(Operator::Event(event), &of).unwrap();
}

/// A run in real time that has lost its beginning, and then its policy, which was started again,
/// while the operator was there.
fn troubled(test: &str) -> Run {
    let mut run = Run::start_with(test, CHECKPOINT, 2, None, &["--log-max-mb", "16"]);
    loses_its_beginning(&run);
    operate(&run, OperatorEvent::Speed { percent: 60 });
    send("-KILL", run.policy_process());
    run.stops();
    run.until("it goes on", |seen| seen.enabled && seen.moves);
    operate(&run, OperatorEvent::Pause);
    run.stops();
    operate(&run, OperatorEvent::Speed { percent: 100 });
    operate(&run, OperatorEvent::Resume);
    run.until("it goes on", |seen| seen.enabled && seen.moves);
    run
}

/// A part that is identical from its first tick on.
fn identical(path: &Path) -> (RunLog, ReplayResult) {
    let log = RunLog::open(path).unwrap();
    let replayed = replay(&log).unwrap();
    assert!(replayed.identical, "{:?}", replayed.first_difference);
    assert_eq!(verify(&log).unwrap().violation_count, 0);
    let kept_from = replayed.kept_from.unwrap();
    assert!(kept_from.left_out > 0 && kept_from.left_out == log.header.left_out);
    (log, replayed)
}

/// The wishes that the arm of `logs` heard.
fn wishes(logs: &[&RunLog]) -> Vec<OperatorEvent> {
    let ticks = logs.iter().flat_map(|log| log.ticks());
    ticks
        .filter_map(|(tick, _)| tick.arms.first.operator)
        .collect()
}

#[test]
fn what_a_bound_kept_of_a_faulty_run_replays() {
    let _turn = alone();
    let mut run = troubled("faults-kept");
    sleep_ns(500 * MS_NS);
    run.send("-INT");
    let (_, result) = run.end();
    assert_eq!(result.unwrap()["real_time"]["thread"]["allocations"], 0);
    let (before, _) = identical(&earlier(&run));
    let (last, replayed) = identical(&run.log);
    assert!(replayed.bounded && replayed.inputs_checked);
    let heard = wishes(&[&before, &last]);
    for event in [
        OperatorEvent::GoOn,
        OperatorEvent::Pause,
        OperatorEvent::Resume,
    ] {
        assert!(heard.contains(&event), "{event:?}: {heard:?}");
    }
    let told = trocar().arg("replay").arg(&run.log).output().unwrap();
    let told_text = String::from_utf8_lossy(&told.stdout).into_owned();
    let expected = format!("identical: {} ticks from ", replayed.ticks);
    assert!(
        told.status.success() && told_text.starts_with(&expected),
        "{told_text}"
    );
    let left_out = format!(
        "the beginning ({} ticks) was not kept",
        last.header.left_out
    );
    assert!(told_text.contains(&left_out), "{told_text}");
}

#[test]
fn what_a_bound_kept_of_a_killed_run_replays() {
    let _turn = alone();
    let mut run = troubled("faults-kept-killed");
    // A file that has just begun holds no tick yet.
    while fs::metadata(&run.log).map_or(0, |found| found.len()) < 300_000 {
        sleep_ns(MS_NS);
    }
    run.send("-KILL");
    let (code, _) = run.end();
    assert_eq!(code, None);
    let (before, whole) = identical(&earlier(&run));
    assert!(whole.bounded);
    let (last, cut) = identical(&run.log);
    assert!(cut.cut.is_some() && !cut.bounded);
    assert!(wishes(&[&before, &last]).contains(&OperatorEvent::GoOn));
}
