//! Simulated arms in another thread, reached through wait-free queues, paced by the clock. Hot
//! path: bounded, no allocation, no lock.
//!
//! Measurements come from the simulation thread through a mailbox, of which only the newest
//! matters; set-points go back through a queue, since every one of them is executed. The simulation
//! thread's side is `session::realtime::simulation_thread`.

use hal::{ArmError, ArmState, Measured, PerArm, Period, Rig, Setpoint, TimeNs};
use rtrb::Producer;

use crate::mailbox::MailboxReader;
use crate::rt::Periodic;

/// Age of the newest measurement beyond which it counts as lost, ns.
///
/// A drive's watchdog on a bus is of the same size (the dVRK's is 30 ms); a shared machine without
/// a real-time kernel can take the simulation thread off its core for longer than a few periods.
pub(crate) const MEASUREMENT_AGE_NS_MAX: u64 = 50_000_000;

/// Simulated arms in another thread.
pub(crate) struct ThreadsRig {
    /// All arms of one instant at once.
    measured: MailboxReader<PerArm<ArmState>>,
    /// What a period without a new measurement uses again, until it is too old; none before the
    /// first.
    newest: Option<PerArm<ArmState>>,
    /// Room for a second of them.
    commands: Producer<PerArm<Setpoint>>,
    /// Half a period behind the simulation's grid, so that this period's measurement is there.
    periodic: Periodic,
}

impl ThreadsRig {
    pub(crate) const fn new(
        measured: MailboxReader<PerArm<ArmState>>,
        commands: Producer<PerArm<Setpoint>>,
        periodic: Periodic,
    ) -> Self {
        Self {
            measured,
            newest: None,
            commands,
            periodic,
        }
    }
}

impl Rig for ThreadsRig {
    /// Pushes, sleeps, takes. A measurement is as old as its stamp says at the period's due time,
    /// not at the time the thread woke. Without any measurement yet the period has none.
    fn exchange(&mut self, setpoints: Option<&PerArm<Setpoint>>) -> Period {
        if let Some(setpoints) = setpoints {
            // Full only if the arms have not moved for a second, and then their measurements are
            // long missing.
            let _gone = self.commands.push(*setpoints);
        }
        let wake = self.periodic.wait();
        self.newest = self.measured.take().or(self.newest);
        let measured = self.newest;
        wake.period(measured.map(|newest| newest.map(|state| fresh(&state, wake.due))))
    }
}

/// The measurement, unless it is too old at `now`.
///
/// A stamp after `now` has the age 0.
pub(crate) const fn fresh(state: &ArmState, now: TimeNs) -> Measured {
    let age_ns = now.since(state.stamp);
    if age_ns > MEASUREMENT_AGE_NS_MAX {
        Err(ArmError::MeasurementLost { age_ns })
    } else {
        Ok(*state)
    }
}
