//! One tick as the log sees it: everything that the controller was given, what it answered, and how long that took.

use hal::{ArmCommand, ArmError, ArmState, TimeNs};

use crate::control::{OperatorEvent, TickReport};

/// One tick of one arm. Plain data, so that the control thread can hand it over without allocating.
#[derive(Clone, Copy, Debug)]
pub struct TickRecord {
    /// Count of the control periods, skipped ones included.
    pub tick: u64,
    /// The time that the controller was given.
    pub now: TimeNs,
    /// What the arm reported.
    pub measured: Result<ArmState, ArmError>,
    /// What the operator asked for in this tick.
    pub operator: Option<OperatorEvent>,
    /// Sequence of the chunk that the controller was given in this tick.
    pub chunk_sequence: Option<u64>,
    /// What the controller answered.
    pub command: ArmCommand,
    /// What it says about its answer.
    pub report: TickReport,
    /// How long it took; zero in lockstep.
    pub timing: TickTiming,
}

/// Host timing of one tick.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct TickTiming {
    /// Wake-up later than planned, ns.
    pub wake_ns: u64,
    /// Time spent in the controller, ns.
    pub compute_ns: u64,
}

/// One tick as it is read back: [`TickRecord`] without the controller's report, which a replay recomputes.
#[derive(Clone, Copy, Debug)]
pub struct LoggedTick {
    /// Count of the control periods, skipped ones included.
    pub tick: u64,
    /// The time that the controller was given.
    pub now: TimeNs,
    /// What the arm reported.
    pub measured: Result<ArmState, ArmError>,
    /// What the operator asked for in this tick.
    pub operator: Option<OperatorEvent>,
    /// Sequence of the chunk that the controller was given in this tick.
    pub chunk_sequence: Option<u64>,
    /// What the controller answered.
    pub command: ArmCommand,
    /// How long it took.
    pub timing: TickTiming,
}
