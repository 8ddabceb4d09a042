//! Arms that another process leads, reached through wait-free queues to the threads that are on its
//! topics, paced by the clock. Hot path: bounded, no allocation, no lock; its system call wakes the
//! thread that sends.
//!
//! The topics themselves are read and written by two threads of
//! `session::realtime::remote_arms::topics`: publishing may take a lock or a system call, which a
//! control thread must not.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::thread::Thread;

use hal::{ArmError, Measured, PerArm, Period, Rig, Setpoint, TimeNs};
use rtrb::Producer;

use super::threads::{MEASUREMENT_AGE_NS_MAX, fresh};
use crate::mailbox::MailboxReader;
use crate::rt::Periodic;

/// The way to the thread that sends set-points.
pub(crate) struct ToSender {
    /// Set-points in order; while it is full new ones are dropped.
    pub(crate) queue: Producer<PerArm<Setpoint>>,
    /// Unparked once a period, whether it sleeps or not.
    pub(crate) thread: Thread,
    /// Whether that thread, or the one that takes feedback, has ended.
    ///
    /// From then on every measurement counts as lost, so that the controller faults instead of
    /// commanding arms that do not hear.
    pub(crate) broken: Arc<AtomicBool>,
}

/// Arms on topics.
pub(crate) struct TopicsRig {
    /// With errors that the receiving thread found, such as a lost arm.
    measured: MailboxReader<PerArm<Measured>>,
    /// Used again in periods without feedback, until it is too old.
    newest: Option<PerArm<Measured>>,
    sender: ToSender,
    periodic: Periodic,
}

impl TopicsRig {
    /// Set-points go to the `sender`, which is then woken.
    pub(crate) fn new(
        measured: MailboxReader<PerArm<Measured>>,
        sender: ToSender,
        periodic: Periodic,
    ) -> Self {
        Self {
            measured,
            newest: None,
            sender,
            periodic,
        }
    }
}

impl Rig for TopicsRig {
    /// As [`super::threads::ThreadsRig`]: set-points out, sleep, newest feedback in. The age is
    /// checked at the period's due time.
    fn exchange(&mut self, setpoints: Option<&PerArm<Setpoint>>) -> Period {
        if let Some(setpoints) = setpoints {
            // Full only if nothing was sent for long, and then the arms have stopped by themselves.
            let _gone = self.sender.queue.push(*setpoints);
            self.sender.thread.unpark();
        }
        let wake = self.periodic.wait();
        self.newest = self.measured.take().or(self.newest);
        let broken = self.sender.broken.load(Ordering::Acquire);
        let measured = self.newest;
        wake.period(measured.map(|newest| {
            newest.map(|measured| match of_now(measured, wake.due) {
                Ok(state) if broken => Err(ArmError::MeasurementLost {
                    age_ns: wake.due.since(state.stamp),
                }),
                measured => measured,
            })
        }))
    }
}

/// The measurement, unless it is too old at `now`, or from beyond it.
///
/// Clocks of two processes on one machine agree; a stamp far ahead is another clock's, and no age
/// can be told from it.
fn of_now(measured: Measured, now: TimeNs) -> Measured {
    let state = measured?;
    if state.stamp.since(now) > MEASUREMENT_AGE_NS_MAX {
        return Err(ArmError::MeasurementLost { age_ns: 0 });
    }
    fresh(&state, now)
}

#[cfg(test)]
mod tests {
    use hal::{ArmState, JointVector};

    use super::*;

    #[test]
    fn a_measurement_of_another_time_is_lost_and_a_fault_stays_one() {
        let now = TimeNs(1_000_000_000);
        let at = |stamp: u64| {
            let state = ArmState::at_rest(TimeNs(stamp), JointVector::zeros(), 0.0);
            of_now(Ok(state), now).is_ok()
        };
        assert!(at(now.0) && at(now.0 - MEASUREMENT_AGE_NS_MAX) && at(now.0 + 1_000_000));
        assert!(!at(now.0 - MEASUREMENT_AGE_NS_MAX - 1));
        assert!(!at(now.0 + MEASUREMENT_AGE_NS_MAX + 1));
        let fault = Err(ArmError::DriveFault { axis: 1, code: 2 });
        assert_eq!(of_now(fault, now), fault);
    }
}
