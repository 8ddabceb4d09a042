//! The control thread of a real-time run: read, tick, write, once a period.

use std::sync::Arc;

use hal::{ArmCommand, ArmError, ArmState, Chunk, SafeTail, TICK_NS, TimeNs};
use rtrb::{Consumer, Producer};

use super::signals::{Signals, StopsAll};
use crate::control::{Controller, OperatorEvent, TickInput};
use crate::histogram::Histogram;
use crate::log::{ArmRecord, TickLog, TickRecord, TickTiming};
use crate::mailbox::MailboxReader;
use crate::per_arm::PerArm;
use crate::rt::{MonotonicClock, Periodic, RtOptions, Wake, configure_thread};
use crate::session::tally::Tally;

/// Age of the newest measurement beyond which it counts as lost, ns.
///
/// A drive's watchdog on a bus is of the same size (the dVRK's is 30 ms); a shared machine without a real-time kernel can
/// take the simulation thread off its core for longer than a few periods.
const MEASUREMENT_AGE_NS_MAX: u64 = 50_000_000;

/// Periods that the arm gets to come to rest after the verdict: more than twice the longest stop.
const REST_TICKS: u64 = 500;

/// Priority of the control thread under `SCHED_FIFO`.
const PRIORITY: u8 = 80;

/// The control thread before it runs.
pub(super) struct ControlThread {
    pub(super) controller: Box<Controller>,
    pub(super) measured: MailboxReader<ArmState>,
    pub(super) chunks: Consumer<Chunk>,
    /// Each command with the stop that the arm finishes alone if this thread is late or gone.
    pub(super) commands: Producer<(ArmCommand, SafeTail)>,
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
    /// Runs until the arm rests after the verdict, or after a fault, which it does not recover from by itself.
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
        let mut newest: Option<ArmState> = None;
        while rest_ticks < REST_TICKS {
            let wake = periodic.wait();
            wakes.record(wake.late_ns());
            let done = signals.done();
            rest_ticks += u64::from(done);
            newest = self.measured.take().or(newest);
            let Some(state) = newest else { continue };
            let operator = if tally.ticks() == 0 {
                Some(OperatorEvent::Enable)
            } else {
                (done && !paused).then_some(OperatorEvent::Pause)
            };
            paused |= operator == Some(OperatorEvent::Pause);
            let record = self.tick(&wake, &state, operator, &mut tally, clock);
            tally.tick(&record);
            if let Some(log) = &mut self.log {
                log.tick(&record);
            }
            if record.arms.first.report.fault.is_some() {
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

    fn tick(
        &mut self,
        wake: &Wake,
        state: &ArmState,
        operator: Option<OperatorEvent>,
        tally: &mut Tally,
        clock: MonotonicClock,
    ) -> TickRecord {
        let now = wake.due;
        let age_ns = now.since(state.stamp);
        let measured = if age_ns > MEASUREMENT_AGE_NS_MAX {
            Err(ArmError::MeasurementLost { age_ns })
        } else {
            Ok(*state)
        };
        let chunk = if self.chunks.peek().is_ok_and(|chunk| is_ahead(chunk, wake)) {
            None
        } else {
            self.chunks.pop().ok()
        };
        if let (Some(log), Some(chunk)) = (&mut self.log, &chunk) {
            log.chunk(0, chunk);
        }
        if let Some(chunk) = &chunk {
            tally.delivery(now.since(chunk.observed_at));
        }
        let before = clock.now();
        let output = self.controller.tick(&TickInput {
            now,
            measured,
            chunk: chunk.as_ref(),
            operator,
        });
        let compute_ns = clock.now().since(before);
        // Full only if the arm has not moved for a second, and then its measurement is long missing.
        let _gone = self.commands.push((output.command, output.tail));
        TickRecord {
            tick: now.tick(),
            now,
            arms: PerArm::one(ArmRecord {
                measured,
                operator,
                chunk_sequence: chunk.map(|chunk| chunk.sequence),
                command: output.command,
                report: output.report,
            }),
            timing: TickTiming {
                wake_ns: wake.late_ns(),
                compute_ns,
            },
        }
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
