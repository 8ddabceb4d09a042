//! How the control thread reaches its arms: through queues to a simulation, or on a bus. Hot path: bounded, no allocation,
//! no lock.

use hal::{ArmCommand, ArmError, ArmState, SafeTail, TimeNs};
use rtrb::Producer;

use crate::mailbox::MailboxReader;
use crate::per_arm::PerArm;

/// A command with the stop that the arm finishes alone if the control thread is late or gone.
pub(super) type Setpoint = (ArmCommand, SafeTail);

/// What an arm answers when it is read.
pub(super) type Measured = Result<ArmState, ArmError>;

/// The arms of a run, read and commanded once a control period.
pub(super) trait ArmLink {
    /// The newest measurements at `now`; none as long as there has never been one.
    fn read(&mut self, now: TimeNs) -> Option<PerArm<Measured>>;

    /// Hands over the commands of this period.
    fn write(&mut self, setpoints: &PerArm<Setpoint>);
}

/// Age of the newest measurement beyond which it counts as lost, ns.
///
/// A drive's watchdog on a bus is of the same size (the dVRK's is 30 ms); a shared machine without a real-time kernel can
/// take the simulation thread off its core for longer than a few periods.
const MEASUREMENT_AGE_NS_MAX: u64 = 50_000_000;

/// Simulated arms in another thread.
pub(super) struct SimLink {
    measured: MailboxReader<PerArm<ArmState>>,
    newest: Option<PerArm<ArmState>>,
    commands: Producer<PerArm<Setpoint>>,
}

impl SimLink {
    pub(super) const fn new(
        measured: MailboxReader<PerArm<ArmState>>,
        commands: Producer<PerArm<Setpoint>>,
    ) -> Self {
        Self {
            measured,
            newest: None,
            commands,
        }
    }
}

impl ArmLink for SimLink {
    fn read(&mut self, now: TimeNs) -> Option<PerArm<Measured>> {
        self.newest = self.measured.take().or(self.newest);
        Some(self.newest?.map(|state| fresh(&state, now)))
    }

    fn write(&mut self, setpoints: &PerArm<Setpoint>) {
        // Full only if the arms have not moved for a second, and then their measurements are long missing.
        let _gone = self.commands.push(*setpoints);
    }
}

/// The measurement, unless it is too old at `now`.
const fn fresh(state: &ArmState, now: TimeNs) -> Measured {
    let age_ns = now.since(state.stamp);
    if age_ns > MEASUREMENT_AGE_NS_MAX {
        Err(ArmError::MeasurementLost { age_ns })
    } else {
        Ok(*state)
    }
}
