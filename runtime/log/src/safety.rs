//! The controller's report in JSON, for people and plots; a replay recomputes it and compares.
//!
//! Equal reports have equal bytes, since fields have a fixed order and each number has one text: a
//! replay compares bytes, and looks for the field only where they differ.

use hal::TipTarget;
use serde::{Deserialize, Serialize};
use serde_json::{Map, Value};

use super::exact::{Exact, numbers, target};
use super::json::{ErrorMessage, encoded};
use trocar_control::{Fault, OperatingState, QpOutcome, TickReport};

/// What an arm's safety report says that no replay is needed for.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LoggedReport {
    /// The operating state after the tick.
    pub state: OperatingState,
    /// Where the aggregated chunks wanted the tip to be, in the arm's RCM frame, and the jaw; none
    /// of an arm that nobody asked, or that is not enabled. Its numbers may be non-finite.
    pub target: Option<TipTarget>,
}

impl LoggedReport {
    /// Reads a report of [`Step::reports`](super::Step::reports); none if it lacks the state or is
    /// no report.
    #[must_use]
    pub fn read(message: &[u8]) -> Option<Self> {
        let read: ReadMessage = serde_json::from_slice(message).ok()?;
        let states = [
            OperatingState::Disabled,
            OperatingState::Enabled,
            OperatingState::Paused,
            OperatingState::Fault,
        ];
        let state = states.into_iter().find(|state| state.name() == read.mode)?;
        Some(Self {
            state,
            target: read.target.as_ref().map(target),
        })
    }
}

/// The part of `/safety` that [`LoggedReport`] reads.
#[derive(Deserialize)]
struct ReadMessage {
    mode: String,
    target: Option<[Exact; 8]>,
}

/// `/safety`.
#[derive(Debug, Serialize)]
pub(super) struct SafetyMessage {
    tick: u64,
    mode: &'static str,
    homed: bool,
    busy: bool,
    /// The decision's debug form, such as `StepTooLong { index: 3 }`.
    gate: Option<String>,
    /// `passed`, `solved` or `failed`.
    qp: &'static str,
    qp_iterations: u32,
    rows_active: u32,
    /// In units of the velocity limits.
    correction: Exact,
    guard_intervened: bool,
    target: Option<[Exact; 8]>,
    fault: Option<FaultMessage>,
}

/// As [`Fault`], with numbers that JSON can hold.
#[derive(Debug, Serialize)]
#[serde(rename_all = "snake_case")]
enum FaultMessage {
    MeasurementNotFinite,
    MeasurementOutOfRange { axis: u8, value: Exact },
    Arm(ErrorMessage),
    TrackingError { tip_m: Exact, turn_rad: Exact },
}

impl SafetyMessage {
    pub(super) fn new(tick: u64, report: &TickReport) -> Self {
        let (qp, qp_iterations) = match report.qp {
            QpOutcome::NotNeeded => ("passed", 0),
            QpOutcome::Solved { iterations } => ("solved", iterations),
            QpOutcome::Failed => ("failed", 0),
        };
        Self {
            tick,
            mode: report.mode.state.name(),
            homed: report.mode.homed,
            busy: report.mode.busy,
            gate: report.gate.map(|verdict| format!("{verdict:?}")),
            qp,
            qp_iterations,
            rows_active: report.rows_active,
            correction: Exact(report.correction),
            guard_intervened: report.guard_intervened,
            target: report.target.map(|target| numbers(&target)),
            fault: report.fault.map(FaultMessage::from),
        }
    }
}

impl From<Fault> for FaultMessage {
    fn from(fault: Fault) -> Self {
        match fault {
            Fault::MeasurementNotFinite => Self::MeasurementNotFinite,
            Fault::MeasurementOutOfRange { axis, value } => Self::MeasurementOutOfRange {
                axis,
                value: Exact(value),
            },
            Fault::Arm(error) => Self::Arm(error.into()),
            Fault::TrackingError { tip_m, turn_rad } => Self::TrackingError {
                tip_m: Exact(tip_m),
                turn_rad: Exact(turn_rad),
            },
        }
    }
}

/// A value of a report that differs: its name, as logged, as computed.
pub(super) type ReportDifference = (String, String, String);

/// Compares the logged message of `tick` with `report`.
///
/// None if they are the same to the byte. The first field that differs is named `safety.` and its
/// key; a tick without a report differs as a whole. A field that only one of them has counts as
/// different.
pub(super) fn difference(
    tick: u64,
    logged: Option<&[u8]>,
    report: &TickReport,
) -> Option<ReportDifference> {
    let computed = SafetyMessage::new(tick, report);
    let text = encoded(&computed);
    let Some(logged) = logged else {
        let found = String::from_utf8_lossy(&text).into_owned();
        return Some(("safety".to_owned(), "nothing".to_owned(), found));
    };
    if logged == text {
        return None;
    }
    let parse = |bytes: &[u8]| serde_json::from_slice::<Map<String, Value>>(bytes);
    let (Ok(logged), Ok(computed)) = (parse(logged), parse(&text)) else {
        let logged = String::from_utf8_lossy(logged).into_owned();
        return Some(("safety".to_owned(), logged, "a report in JSON".to_owned()));
    };
    let keys = computed.keys().chain(logged.keys());
    let shown = |value: Option<&Value>| value.map_or("nothing".to_owned(), Value::to_string);
    keys.map(|key| (key, logged.get(key), computed.get(key)))
        .find(|(_, logged, computed)| logged != computed)
        .map(|(key, logged, computed)| (format!("safety.{key}"), shown(logged), shown(computed)))
}
