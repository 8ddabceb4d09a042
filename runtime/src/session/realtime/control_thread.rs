//! The control thread of a real-time run: read, tick, write, once a period.

use std::sync::Arc;

use hal::{Chunk, TICK_NS, TimeNs};
use rtrb::Consumer;

use super::arm_link::{ArmLink, Measured};
use super::signals::{Signals, StopsAll};
use crate::control::{AnyController, OperatorEvent, TickInput};
use crate::histogram::Histogram;
use crate::log::{TickLog, TickRecord, TickTiming};
use crate::per_arm::PerArm;
use crate::rt::{MonotonicClock, Periodic, RtOptions, Wake, configure_thread};
use crate::session::tally::Tally;

/// Periods that the arms get to come to rest after the verdict: more than twice the longest stop.
const REST_TICKS: u64 = 500;

/// Priority of the control thread under `SCHED_FIFO`.
const PRIORITY: u8 = 80;

/// The control thread before it runs.
pub(super) struct ControlThread<L> {
    pub(super) controller: AnyController,
    pub(super) link: L,
    pub(super) chunks: Consumer<PerArm<Chunk>>,
    pub(super) log: Option<TickLog>,
    pub(super) signals: Arc<Signals>,
}

/// What it leaves behind.
pub(super) struct ControlEnd<L> {
    pub(super) link: L,
    pub(super) tally: Tally,
    pub(super) skipped: u64,
    pub(super) wake_p99_us: f64,
    pub(super) log_dropped: u64,
}

impl<L: ArmLink> ControlThread<L> {
    /// Runs from `first` until the arms rest after the verdict, or after a fault of any, which it does not recover from by
    /// itself.
    pub(super) fn run(mut self, clock: MonotonicClock, first: TimeNs) -> ControlEnd<L> {
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
        let mut periodic = Periodic::new(clock, first, TICK_NS);
        let mut wakes = Histogram::new();
        let mut tally = Tally::default();
        let mut rest_ticks = 0;
        let mut paused = false;
        while rest_ticks < REST_TICKS {
            let wake = periodic.wait();
            wakes.record(wake.late_ns());
            let done = signals.done();
            rest_ticks += u64::from(done);
            let Some(measured) = self.link.read(wake.due) else {
                continue;
            };
            let operator = if tally.ticks() == 0 {
                Some(OperatorEvent::Enable)
            } else {
                (done && !paused).then_some(OperatorEvent::Pause)
            };
            paused |= operator == Some(OperatorEvent::Pause);
            let Some(record) = self.tick(&wake, measured, operator, &mut tally, clock) else {
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
            link: self.link,
            tally,
            skipped: periodic.skipped(),
            wake_p99_us,
            log_dropped,
        }
    }

    /// One control period of all arms; none if there are other arms than the controller's, which `Setup` rules out.
    fn tick(
        &mut self,
        wake: &Wake,
        measured: PerArm<Measured>,
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
        let inputs = measured.map(|measured| TickInput {
            now,
            measured,
            chunk: newest.next(),
            operator,
        });
        let before = clock.now();
        let outputs = self.controller.tick(&inputs);
        let compute_ns = clock.now().since(before);
        let outputs = outputs?;
        self.link
            .write(&outputs.map(|output| (output.command, output.tail)));
        let timing = TickTiming {
            wake_ns: wake.late_ns(),
            compute_ns,
        };
        Some(TickRecord::new(now.tick(), inputs, outputs, timing))
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
