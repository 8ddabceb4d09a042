//! Rows of the fault matrix (`tests/scripts/fault_matrix.py`): from the log of a run with a fault,
//! in ticks of 1 ms, when the fault was detected, when the arm was at rest, and whether limits were
//! kept.
#![expect(clippy::print_stdout, reason = "the rows are printed too")]

use std::fs;

use serde_json::Value;
use tests::repository;
use trocar::rt::{MonotonicClock, sleep_ns};
use trocar::session::operator::{Ask, Command, ask};
use trocar_log::verify::verify;
use trocar_log::{Loss, RunLog};

/// Ticks that an arm may take to rest after a fault is detected: what a run gives its arms at its
/// end, more than twice the longest stop.
const STOP_TICKS_MAX: usize = 500;

/// The newest tick that the run of `process` tells an operator, once it does.
pub(crate) fn newest_tick(process: u32) -> u64 {
    let of = Ask {
        run: Some(process.to_string()),
        json: true,
    };
    let clock = MonotonicClock::new();
    loop {
        let answer = ask(Command::Status, &of).ok();
        let answer: Option<Value> =
            answer.and_then(|(answer, _)| serde_json::from_str(&answer).ok());
        if let Some(seconds) = answer.and_then(|answer| answer["seconds"].as_f64()) {
            return format!("{:.0}", 1e3 * seconds).parse().unwrap();
        }
        assert!(clock.now().seconds() < 180.0, "the run tells nothing");
        sleep_ns(2_000_000);
    }
}

/// How the first arm of a run took a fault.
#[derive(Clone, Debug)]
pub(crate) struct Taken {
    /// Ticks from the one before the fault was injected until it was detected; none if nothing
    /// detects it.
    pub(crate) detected: Option<u64>,
    /// Ticks that the controller did from then on until the arm was at rest, and at most; none if
    /// the arm goes on.
    rests: Option<(usize, usize)>,
    /// Ticks from its rest until it moves again, if it does.
    pub(crate) again: Option<u64>,
    limits: String,
}

impl Taken {
    /// A fault after tick `injected` that takes the arm out of ENABLED.
    pub(crate) fn stops(log: &RunLog, injected: u64) -> Self {
        Self::rests_within(log, injected, is_stopped, STOP_TICKS_MAX)
    }

    /// Chunks that are refused from `injected` on: the arm follows the last good one to its end,
    /// `chunk_ticks` after its observation.
    pub(crate) fn refuses(log: &RunLog, injected: u64, chunk_ticks: usize) -> Self {
        let within = chunk_ticks + STOP_TICKS_MAX;
        Self::rests_within(log, injected, is_refusal, within)
    }

    fn rests_within(
        log: &RunLog,
        injected: u64,
        detects: impl Fn(&Value) -> bool,
        within: usize,
    ) -> Self {
        let mut reports = reports(log, injected).skip_while(|(_, report)| !detects(report));
        let (detected, report) = reports.next().unwrap();
        let at_rest = |report: &Value| report["busy"] == false;
        let (rested, rests) = if at_rest(&report) {
            (detected, 0)
        } else {
            let mut later = reports.by_ref().zip(1..);
            let ((tick, _), rests) = later.find(|((_, report), _)| at_rest(report)).unwrap();
            (tick, rests)
        };
        assert!(rests <= within, "at rest after {rests} ticks of {within}");
        let again = reports.find(|(_, report)| !is_stopped(report) && !at_rest(report));
        Self {
            detected: Some(detected - injected),
            rests: Some((rests, within)),
            again: again.map(|(tick, _)| tick - rested),
            limits: limits(log),
        }
    }

    /// Periods that are skipped after `injected`, during which the arm plays its tail and goes on.
    pub(crate) fn skips(log: &RunLog, injected: u64) -> Self {
        let ticks = || log.ticks().map(|(tick, _)| tick.tick);
        let mut pairs = ticks().zip(ticks().skip(1));
        let gap = pairs.find(|(one, next)| *next > injected && *next > one + 1);
        let (_, next) = gap.unwrap();
        Self::goes_on(log, Some(next - injected))
    }

    /// Records that the log lacks after `injected`.
    pub(crate) fn drops(log: &RunLog, injected: u64) -> Self {
        let first = log.losses.iter().find_map(|loss| match loss {
            Loss::Ticks { position, .. } => Some(*position),
            Loss::Chunk { .. } => None,
        });
        let (last, _) = log.ticks().take(first.unwrap()).last().unwrap();
        Self::goes_on(log, Some(last.tick + 1 - injected))
    }

    /// A fault that was detected after so many ticks, if at all, and costs the arm nothing.
    pub(crate) fn goes_on(log: &RunLog, detected: Option<u64>) -> Self {
        Self {
            detected,
            rests: None,
            again: None,
            limits: limits(log),
        }
    }
}

/// The reports of the first arm after tick `injected`, each with its tick.
fn reports(log: &RunLog, injected: u64) -> impl Iterator<Item = (u64, Value)> {
    let steps = log.steps().filter(move |step| step.tick.tick > injected);
    steps.filter_map(|step| {
        let report = serde_json::from_slice(step.reports.first?).unwrap();
        Some((step.tick.tick, report))
    })
}

fn is_stopped(report: &Value) -> bool {
    report["mode"] != "ENABLED"
}

fn is_refusal(report: &Value) -> bool {
    let gate = report["gate"].as_str();
    gate.is_some_and(|decision| decision != "Accepted")
}

/// Whether `log` keeps the limits: all that it has does, or the test fails.
fn limits(log: &RunLog) -> String {
    let verified = verify(log).unwrap();
    let missing = |limit: &str| limit == "missing_ticks";
    let mut found = verified.violations.iter();
    assert!(found.all(|it| missing(&it.limit)), "{verified:?}");
    let how = if verified.ok {
        ""
    } else if verified.cut.is_some() {
        ", as far as the log goes"
    } else {
        ", in all that the log has"
    };
    format!("held{how}")
}

/// Keeps and prints a row of the matrix: what the fault is, as what it is seen, how the arm took
/// it, and what comes of the run.
pub(crate) fn row(name: &str, fault: &str, seen: &str, taken: &Taken, then: &str) {
    let ticks = |ticks: Option<u64>| ticks.map_or_else(|| "-".to_owned(), |it| it.to_string());
    let rests = taken.rests.map_or_else(
        || "the arm goes on".to_owned(),
        |(rests, within)| format!("{rests} of {within}"),
    );
    write(
        name,
        [
            fault,
            seen,
            &ticks(taken.detected),
            &rests,
            &taken.limits,
            then,
        ],
    );
}

/// A row of a run that is refused before its arm moves.
pub(crate) fn row_at_rest(name: &str, fault: &str, seen: &str, then: &str) {
    write(name, [fault, seen, "-", "never moved", "held", then]);
}

fn write(name: &str, cells: [&str; 6]) {
    let folder = repository().join("target/scratch/fault-matrix");
    fs::create_dir_all(&folder).unwrap();
    let row = format!("| {} |\n", cells.join(" | "));
    print!("{row}");
    fs::write(folder.join(name), row).unwrap();
}
