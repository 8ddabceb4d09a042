//! The interface to all arms of a session with their clock: a simulation, drives on buses, another
//! controller's console.

use crate::{ArmCommand, ArmError, ArmState, PerArm, SafeTail, TimeNs};

/// A command with the stop that the arm finishes alone if no other command comes.
pub type Setpoint = (ArmCommand, SafeTail);

/// What an arm answers when it is read.
pub type Measured = Result<ArmState, ArmError>;

/// One control period, as a rig begins it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Period {
    /// When it is due, on the grid of control periods. Commands that answer it bear this stamp.
    pub now: TimeNs,
    /// How late the loop woke for it, ns; 0 where time is virtual.
    pub late_ns: u64,
    /// Whole periods that were skipped before it.
    pub skipped: u64,
    /// What each arm measured; none as long as no measurement has ever come.
    pub measured: Option<PerArm<Measured>>,
}

/// The arms of a session, one or two, with what paces them.
///
/// The rig says when a period begins: a simulation in lockstep at once, when its step is computed;
/// one that runs beside the loop, and drives on buses, when the clock says so. So the same loop
/// drives them all, and a command leaves as soon as it is computed, not with the beginning of the
/// next period.
pub trait Rig {
    /// Sends the set-points of the period that ends, if it has some, and begins the next one: waits
    /// until it is due, and reads.
    ///
    /// A set-point that can't be sent is reported as its arm's next measurement. An arm that is
    /// sent none plays the rest of its last tail; before the first it holds the position at which
    /// it was found.
    fn exchange(&mut self, setpoints: Option<&PerArm<Setpoint>>) -> Period;
}
