//! What goes into a tick and what comes out of it, as plain values that a log can keep.

use core::fmt;

use hal::tail::SafeTail;
use hal::{ArmCommand, ArmError, ArmState, Chunk, TimeNs, TipTarget};

use super::gate::GateDecision;
use super::mode::{Mode, OperatorEvent};
use super::snapshot::{Reader, Snapshot, SnapshotError, Words, layout};

/// Everything that a tick may look at.
#[derive(Clone, Copy, Debug)]
pub struct TickInput<'a> {
    /// The control period.
    pub now: TimeNs,
    /// The arm's answer for this period.
    pub measured: Result<ArmState, ArmError>,
    /// The newest chunk; handing over the same one again does no harm.
    pub chunk: Option<&'a Chunk>,
    /// The operator's event since the last tick.
    pub operator: Option<OperatorEvent>,
}

/// What a tick decided.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickOutput {
    /// The setpoint for the end of this control period.
    pub command: ArmCommand,
    /// The verified stop from there, for a backend that gets no further command.
    pub tail: SafeTail,
    /// How it came about.
    pub report: TickReport,
}

/// How a command came about.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TickReport {
    /// Operating state after the tick.
    pub mode: Mode,
    /// The input gate's verdict if a chunk was handed over that it had not seen.
    pub gate: Option<GateDecision>,
    /// What the safety filter did.
    pub qp: QpOutcome,
    /// Rows of the filter that the filtered velocity touches.
    pub rows_active: u32,
    /// Length of the filter's change, each axis in units of its velocity limit, the jaw included.
    pub correction: f64,
    /// Whether the guard refused the candidate and played its verified stop.
    pub guard_intervened: bool,
    /// The aggregated target, if there was one.
    pub target: Option<TipTarget>,
    /// The fault that holds, if any.
    pub fault: Option<Fault>,
}

/// What the safety filter did.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum QpOutcome {
    /// The nominal velocity satisfied every row and passed unchanged.
    NotNeeded,
    /// The QP was solved and its answer satisfies every row.
    Solved {
        /// Iterations of the solver.
        iterations: u32,
    },
    /// No trustworthy solution; the arm stops.
    Failed,
}

/// Why the controller faulted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Fault {
    /// The measurement held NaN or infinity.
    MeasurementNotFinite,
    /// The measurement is where the instrument cannot be.
    MeasurementOutOfRange {
        /// Joint index, 6 for the jaw.
        axis: u8,
        /// Measured, rad (m).
        value: f64,
    },
    /// The backend gave no measurement.
    Arm(ArmError),
    /// The arm did not follow.
    TrackingError {
        /// From the commanded control point to the measured one, m.
        tip_m: f64,
        /// By how much the measured tip is turned against the commanded one, rad.
        turn_rad: f64,
    },
}

impl Words for Fault {
    const LAYOUT: u64 = layout(
        "Fault MeasurementNotFinite MeasurementOutOfRange axis value Arm TrackingError tip_m turn_rad",
        &[<ArmError as Words>::LAYOUT],
    );
    /// Of an arm's own error.
    const WORDS_MAX: usize = 1 + <ArmError as Words>::WORDS_MAX;

    fn put(&self, to: &mut Snapshot) {
        match self {
            Self::MeasurementNotFinite => to.push(0),
            Self::MeasurementOutOfRange { axis, value } => (1_u64, (*axis, *value)).put(to),
            Self::Arm(error) => (2_u64, *error).put(to),
            Self::TrackingError { tip_m, turn_rad } => (3_u64, (*tip_m, *turn_rad)).put(to),
        }
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
        Ok(match from.word()? {
            0 => Self::MeasurementNotFinite,
            1 => Self::MeasurementOutOfRange {
                axis: u8::take(from)?,
                value: f64::take(from)?,
            },
            2 => Self::Arm(ArmError::take(from)?),
            3 => Self::TrackingError {
                tip_m: f64::take(from)?,
                turn_rad: f64::take(from)?,
            },
            _ => return Err(SnapshotError::Impossible),
        })
    }
}

impl fmt::Display for Fault {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::MeasurementNotFinite => write!(f, "the measurement is not finite"),
            Self::MeasurementOutOfRange { axis, value } => {
                write!(f, "{} cannot be at {value}", axis_name(*axis))
            }
            Self::Arm(error) => error.fmt(f),
            Self::TrackingError { tip_m, turn_rad } => {
                write!(
                    f,
                    "the tip is {:.1} mm and {turn_rad:.3} rad away from its command",
                    1e3 * tip_m
                )
            }
        }
    }
}

fn axis_name(axis: u8) -> &'static str {
    let joint = hal::joints::JOINT_NAMES.get(usize::from(axis));
    joint.copied().unwrap_or("jaw")
}
