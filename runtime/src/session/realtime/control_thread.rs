//! The control thread of a real-time run: read, tick, write, once a period.

use std::sync::Arc;

use hal::{ArmCommand, ArmError, ArmState, Chunk, SafeTail, TICK_NS, TimeNs};
use rtrb::{Consumer, Producer};

use super::signals::{Signals, StopsAll};
use crate::control::{AnyController, OperatorEvent, TickInput};
use crate::histogram::Histogram;
use crate::log::{TickLog, TickRecord, TickTiming};
use crate::mailbox::MailboxReader;
use crate::per_arm::PerArm;
use crate::rt::{MonotonicClock, Periodic, RtOptions, Wake, configure_thread};
use crate::session::tally::Tally;

/// Age of the newest measurement beyond which it counts as lost, ns.
///
/// A drive's watchdog on a bus is of the same size (the dVRK's is 30 ms); a shared machine without a real-time kernel can
/// take the simulation thread off its core for longer than a few periods.
const MEASUREMENT_AGE_NS_MAX: u64 = 50_000_000;

/// Periods that the arms get to come to rest after the verdict: more than twice the longest stop.
const REST_TICKS: u64 = 500;

/// Priority of the control thread under `SCHED_FIFO`.
const PRIORITY: u8 = 80;

/// A command with the stop that the arm finishes alone if this thread is late or gone.
pub(super) type Setpoint = (ArmCommand, SafeTail);

/// The control thread before it runs.
pub(super) struct ControlThread {
    pub(super) controller: AnyController,
    pub(super) measured: MailboxReader<PerArm<ArmState>>,
    pub(super) chunks: Consumer<PerArm<Chunk>>,
    pub(super) commands: Producer<PerArm<Setpoint>>,
    pub(super) log: Option<TickLog>,
    pub(super) signals: Arc<Signals>,
}

/// What it leaves behind.
pub(super) struct ControlEnd {
    pub(super) tally: Tally,
    pub(super) skipped: u64,
    pub(super) wake_p99_us: f64,
    pub(super) log_dropped: u64,
}

impl ControlThread {
    /// Runs until the arms rest after the verdict, or after a fault of any, which it does not recover from by itself.
    ///
    /// Wakes half a period after the simulation, so that it sees this period's measurement.
    pub(super) fn run(mut self, clock: MonotonicClock, first: TimeNs) -> ControlEnd {
        let signals = Arc::clone(&self.signals);
        let _stops = StopsAll(&signals);
        let options = RtOptions {
            priority: Some(PRIORITY),
            cpu: None,
            lock_memory: false,
            strict: false,
        };
        // Not strict, so a refusal is only reported; `trocar doctor` tells what to change.
        let _granted = configure_thread(&options);
        let mut periodic = Periodic::new(clock, first.plus_ns(TICK_NS / 2), TICK_NS);
        let mut wakes = Histogram::new();
        let mut tally = Tally::default();
        let mut rest_ticks = 0;
        let mut paused = false;
        let mut newest: Option<PerArm<ArmState>> = None;
        while rest_ticks < REST_TICKS {
            let wake = periodic.wait();
            wakes.record(wake.late_ns());
            let done = signals.done();
            rest_ticks += u64::from(done);
            newest = self.measured.take().or(newest);
            let Some(states) = newest else { continue };
            let operator = if tally.ticks() == 0 {
                Some(OperatorEvent::Enable)
            } else {
                (done && !paused).then_some(OperatorEvent::Pause)
            };
            paused |= operator == Some(OperatorEvent::Pause);
            let Some(record) = self.tick(&wake, &states, operator, &mut tally, clock) else {
                break;
            };
            tally.tick(&record);
            if let Some(log) = &mut self.log {
                log.tick(&record);
            }
            if record.has_fault() {
                signals.end_run();
            }
        }
        let log_dropped = self.log.as_ref().map_or(0, TickLog::dropped);
        #[expect(clippy::cast_precision_loss, reason = "a delay is exact in f64")]
        let wake_p99_us = wakes.percentile(0.99) as f64 * 1e-3;
        ControlEnd {
            tally,
            skipped: periodic.skipped(),
            wake_p99_us,
            log_dropped,
        }
    }

    /// One control period of all arms; none if the simulation has other arms than the controller, which `Setup` rules out.
    fn tick(
        &mut self,
        wake: &Wake,
        states: &PerArm<ArmState>,
        operator: Option<OperatorEvent>,
        tally: &mut Tally,
        clock: MonotonicClock,
    ) -> Option<TickRecord> {
        let now = wake.due;
        let waits = |chunks: &PerArm<Chunk>| is_ahead(&chunks.first, wake);
        let chunks = if self.chunks.peek().is_ok_and(waits) {
            None
        } else {
            self.chunks.pop().ok()
        };
        if let Some(chunks) = &chunks {
            tally.delivery(now.since(chunks.first.observed_at));
            if let Some(log) = &mut self.log {
                for (arm, chunk) in chunks.iter().enumerate() {
                    log.chunk(arm, chunk);
                }
            }
        }
        let mut newest = chunks.iter().flat_map(PerArm::iter);
        let inputs = states.map(|state| TickInput {
            now,
            measured: fresh(&state, now),
            chunk: newest.next(),
            operator,
        });
        let before = clock.now();
        let outputs = self.controller.tick(&inputs);
        let compute_ns = clock.now().since(before);
        let outputs = outputs?;
        // Full only if the arms have not moved for a second, and then their measurements are long missing.
        let _gone = self
            .commands
            .push(outputs.map(|output| (output.command, output.tail)));
        let timing = TickTiming {
            wake_ns: wake.late_ns(),
            compute_ns,
        };
        Some(TickRecord::new(now.tick(), inputs, outputs, timing))
    }
}

/// The measurement, unless it is too old at `now`.
const fn fresh(state: &ArmState, now: TimeNs) -> Result<ArmState, ArmError> {
    let age_ns = now.since(state.stamp);
    if age_ns > MEASUREMENT_AGE_NS_MAX {
        Err(ArmError::MeasurementLost { age_ns })
    } else {
        Ok(*state)
    }
}

/// Whether `chunk` was observed after the period of a thread that woke late, though not after it woke.
///
/// The next period takes it. One from beyond the clock is nonsense, for the gate to refuse.
const fn is_ahead(chunk: &Chunk, wake: &Wake) -> bool {
    wake.due.0 < chunk.observed_at.0 && chunk.observed_at.0 <= wake.woke.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_an_observation_that_a_late_thread_slept_past_is_waited_for() {
        let wake = Wake {
            index: 50,
            due: TimeNs(50 * TICK_NS),
            woke: TimeNs(53 * TICK_NS),
            skipped: 0,
        };
        for (observed_at, expected) in [
            (wake.due.0 - 1, false),
            (wake.due.0, false),
            (wake.due.0 + TICK_NS / 2, true),
            (wake.woke.0, true),
            (wake.woke.0 + 1, false),
            (u64::MAX, false),
        ] {
            let chunk = Chunk::new(TimeNs(observed_at), 1, TICK_NS, &[]);
            assert_eq!(is_ahead(&chunk, &wake), expected, "{observed_at}");
        }
    }
}
