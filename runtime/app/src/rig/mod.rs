//! The rigs: simulated arms in lockstep, simulated arms in another thread, drives on CAN, arms on
//! topics; and the controller's tick in all of them.
//!
//! A session's loop is the same for all: [`hal::Rig::exchange`], [`control`], again.
//!
//! A rig knows when a period begins and where measurements and set-points travel; it knows nothing
//! of tasks, policies or logs. A new kind of arms is a new [`hal::Rig`] here; the loop and the
//! controller stay as they are.

pub(crate) mod can;
pub(crate) mod can_clock;
pub(crate) mod can_traffic;
pub(crate) mod lockstep;
pub(crate) mod threads;
pub(crate) mod topics;

use hal::{ArmState, Chunk, Measured, PerArm, Period, Rig, Setpoint};
use trocar_control::{AnyController, OperatorEvent, TickInput};
use trocar_log::{TickRecord, TickTiming};

use crate::mailbox::MailboxWriter;
use crate::rt::MonotonicClock;

/// The controller's tick in `period` with what all of its arms measured: what the log keeps of it,
/// and the set-points that answer it. Hot path: bounded, no allocation, no I/O.
///
/// `chunks` are new ones only, one an arm, each consumed by the tick that gets it; `operator` goes
/// to every arm. The number of arms in `measured` is the controller's. `clock` measures how long
/// the tick computes, which only the record's timing has: no decision is based on it, so that a
/// replay gives the same set-points.
pub(crate) fn control(
    controller: &mut AnyController,
    period: &Period,
    measured: PerArm<Measured>,
    chunks: Option<&PerArm<Chunk>>,
    operator: Option<OperatorEvent>,
    clock: MonotonicClock,
) -> (TickRecord, PerArm<Setpoint>) {
    let now = period.now;
    let mut newest = chunks.into_iter().flat_map(PerArm::iter);
    let inputs = measured.map(|measured| TickInput {
        now,
        measured,
        chunk: newest.next(),
        operator,
    });
    let before = clock.now();
    let outputs = controller.tick(&inputs);
    let compute_ns = clock.now().since(before);
    let timing = TickTiming {
        wake_ns: period.late_ns,
        compute_ns,
    };
    let setpoints = outputs.map(|output| (output.command, output.tail));
    (
        TickRecord::new(now.tick(), inputs, outputs, timing),
        setpoints,
    )
}

/// A rig, and whoever else wants to know what its arms measure.
///
/// The threads that observe arms outside of this process get their states here, past the
/// controller, from one mailbox write a period.
pub(crate) struct ObservedRig<R> {
    pub(crate) rig: R,
    /// How many arms it has measured.
    ///
    /// Of the newest period that measured any; 0 before.
    pub(crate) arms: usize,
    /// Only whole sets: a period in which an arm's measurement is missing puts nothing in.
    measured: MailboxWriter<PerArm<ArmState>>,
}

impl<R> ObservedRig<R> {
    /// `measured` is read by one observing thread.
    pub(crate) const fn new(rig: R, measured: MailboxWriter<PerArm<ArmState>>) -> Self {
        Self {
            rig,
            arms: 0,
            measured,
        }
    }
}

impl<R: Rig> Rig for ObservedRig<R> {
    fn exchange(&mut self, setpoints: Option<&PerArm<Setpoint>>) -> Period {
        let period = self.rig.exchange(setpoints);
        if let Some(measured) = &period.measured {
            self.arms = measured.count();
            if let Some(states) = all_measured(measured) {
                self.measured.put(states);
            }
        }
        period
    }
}

/// What all arms measured, if none of them failed to.
fn all_measured(measured: &PerArm<Measured>) -> Option<PerArm<ArmState>> {
    let second = match measured.second {
        None => None,
        Some(state) => Some(state.ok()?),
    };
    let first = measured.first.ok()?;
    Some(PerArm { first, second })
}
