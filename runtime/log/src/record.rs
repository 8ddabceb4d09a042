//! One tick as the log sees it: everything that the controller was given, what it answered, and how
//! long that took.

use hal::{ArmCommand, ArmError, ArmState, TimeNs};

use hal::PerArm;
use trocar_control::{OperatorEvent, TickInput, TickOutput, TickReport};

/// One tick of all arms. Plain data, so that the control thread can hand it over without
/// allocating.
#[derive(Clone, Copy, Debug)]
pub struct TickRecord {
    /// Count of the control periods, skipped ones included.
    pub tick: u64,
    /// The time that the controller was given.
    pub now: TimeNs,
    /// What it was given and answered for each arm.
    pub arms: PerArm<ArmRecord>,
    /// How long it took; zero in lockstep.
    pub timing: TickTiming,
}

impl TickRecord {
    /// The record of a tick in which the controller answered `inputs` with `outputs`; the arms
    /// share the first one's time.
    #[must_use]
    pub fn new(
        tick: u64,
        inputs: PerArm<TickInput<'_>>,
        outputs: PerArm<TickOutput>,
        timing: TickTiming,
    ) -> Self {
        Self {
            tick,
            now: inputs.first.now,
            arms: inputs.zip(outputs).map(|(input, output)| ArmRecord {
                measured: input.measured,
                operator: input.operator,
                chunk_sequence: input.chunk.map(|chunk| chunk.sequence),
                command: output.command,
                report: output.report,
            }),
            timing,
        }
    }

    /// Whether any arm has a fault.
    #[must_use]
    pub fn has_fault(&self) -> bool {
        self.arms.iter().any(|arm| arm.report.fault.is_some())
    }
}

/// One arm in one tick.
#[derive(Clone, Copy, Debug)]
pub struct ArmRecord {
    /// What the arm reported.
    pub measured: Result<ArmState, ArmError>,
    /// The operator's event in this tick.
    pub operator: Option<OperatorEvent>,
    /// Sequence of the chunk that the controller was given in this tick.
    pub chunk_sequence: Option<u64>,
    /// What the controller answered.
    pub command: ArmCommand,
    /// What it says about its answer.
    pub report: TickReport,
}

/// Host timing of one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TickTiming {
    /// Wake-up later than planned, ns.
    pub wake_ns: u64,
    /// Time spent in the controller, ns.
    pub compute_ns: u64,
}

/// One tick as it is read back: [`TickRecord`] without the controller's reports, which a replay
/// recomputes.
#[derive(Clone, Copy, Debug)]
pub struct LoggedTick {
    /// Count of the control periods, skipped ones included.
    pub tick: u64,
    /// The time that the controller was given.
    pub now: TimeNs,
    /// What it was given and answered for each arm.
    pub arms: PerArm<LoggedArm>,
    /// How long it took.
    pub timing: TickTiming,
}

/// One arm in one tick as it is read back.
#[derive(Clone, Copy, Debug)]
pub struct LoggedArm {
    /// What the arm reported.
    pub measured: Result<ArmState, ArmError>,
    /// The operator's event in this tick.
    pub operator: Option<OperatorEvent>,
    /// Sequence of the chunk that the controller was given in this tick.
    pub chunk_sequence: Option<u64>,
    /// What the controller answered.
    pub command: ArmCommand,
}
