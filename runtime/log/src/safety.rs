//! The controller's report in JSON, for people and plots; a replay recomputes it, so nothing reads it back.

use hal::TipTarget;
use serde::Serialize;

use super::exact::Exact;
use super::json::ErrorMessage;
use trocar_control::{Fault, QpOutcome, TickReport};

/// `/safety`.
#[derive(Debug, Serialize)]
pub(super) struct SafetyMessage {
    tick: u64,
    mode: &'static str,
    homed: bool,
    busy: bool,
    gate: Option<String>,
    qp: &'static str,
    qp_iterations: u32,
    rows_active: u32,
    correction: Exact,
    guard_intervened: bool,
    target: Option<[Exact; 8]>,
    fault: Option<FaultMessage>,
}

#[derive(Debug, Serialize)]
#[serde(rename_all = "snake_case")]
enum FaultMessage {
    MeasurementNotFinite,
    MeasurementOutOfRange { axis: u8, value: Exact },
    Arm(ErrorMessage),
    TrackingError { joint: u8, error: Exact },
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
            fault: report.fault.map(|fault| match fault {
                Fault::MeasurementNotFinite => FaultMessage::MeasurementNotFinite,
                Fault::MeasurementOutOfRange { axis, value } => {
                    FaultMessage::MeasurementOutOfRange {
                        axis,
                        value: Exact(value),
                    }
                }
                Fault::Arm(error) => FaultMessage::Arm(error.into()),
                Fault::TrackingError { joint, error } => FaultMessage::TrackingError {
                    joint,
                    error: Exact(error),
                },
            }),
        }
    }
}

/// A target as position x, y, z, quaternion x, y, z, w, jaw.
pub(super) fn numbers(target: &TipTarget) -> [Exact; 8] {
    let ([x, y, z], [qx, qy, qz, qw]) = (target.position_m, target.rotation_xyzw);
    [x, y, z, qx, qy, qz, qw, target.jaw].map(Exact)
}
