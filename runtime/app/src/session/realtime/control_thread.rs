//! The control thread of a real-time run: exchange with the rig, tick, once a period.

use std::sync::Arc;

use hal::{Chunk, Measured, PerArm, Period, Rig, Setpoint};
use trocar_control::{AnyController, OperatorEvent};
use trocar_log::{TickLog, TickRecord};

use super::drivers::Drivers;
use super::hold::Hold;
use super::signals::{Signals, StopsAll};
use super::timing::LoopTiming;
use crate::rig;
use crate::rt::{Held, MonotonicClock, RtOptions};
use crate::session::operator::OperatorPort;
use crate::session::summary::RealTimeCounts;
use crate::session::tally::Tally;

/// Periods that the arms get to come to rest after the verdict: more than twice the longest stop.
const REST_TICKS: u64 = 500;

/// Of these, the last ones are for their drives to lose torque.
const RELEASE_TICKS: u64 = 10;

/// The control thread before it runs.
pub(super) struct ControlThread<R> {
    pub(super) controller: AnyController,
    pub(super) rig: R,
    pub(super) drivers: Drivers,
    pub(super) log: Option<TickLog>,
    pub(super) signals: Arc<Signals>,
    pub(super) operator: OperatorPort,
    /// What the thread asks of the system; of strict wishes [`RtProfile::check`](crate::rt::RtProfile::check) knows before there is a run.
    pub(super) profile: RtOptions,
    /// What the process holds of the system, as long as the thread lives.
    pub(super) held: Held,
    /// How many periods it may skip within a second.
    pub(super) overruns_max: Option<u64>,
    /// Whether the run ends with a fault; else the arms hold until the operator clears it.
    pub(super) fault_ends_run: bool,
}

/// What it leaves behind.
pub(super) struct ControlEnd<R> {
    pub(super) rig: R,
    pub(super) tally: Tally,
    /// The loop's timing, without what the log dropped.
    pub(super) counts: RealTimeCounts,
    pub(super) log_dropped: u64,
}

impl<R> ControlEnd<R> {
    /// The same, with what `change` makes of the rig.
    pub(super) fn with_rig<S>(self, change: impl FnOnce(R) -> S) -> ControlEnd<S> {
        let Self {
            rig,
            tally,
            counts,
            log_dropped,
        } = self;
        ControlEnd {
            rig: change(rig),
            tally,
            counts,
            log_dropped,
        }
    }
}

impl<R: Rig> ControlThread<R> {
    /// Runs until the arms rest without torque after the verdict, or after a fault of any that ends the run.
    pub(super) fn run(mut self, clock: MonotonicClock) -> ControlEnd<R> {
        let signals = Arc::clone(&self.signals);
        let _stops = StopsAll(&signals);
        let mut tally = Tally::default();
        let mut rest_ticks = 0;
        let mut hold = Hold::default();
        let mut setpoints = None;
        let mut timing = LoopTiming::begin(&self.profile, &self.held, self.overruns_max);
        while rest_ticks < REST_TICKS {
            let period = self.rig.exchange(setpoints.take().as_ref());
            if let Some(skipped) = timing.woke(&period) {
                signals.overran(skipped);
            }
            let done = signals.done();
            rest_ticks += u64::from(done);
            let Some(measured) = period.measured else {
                continue;
            };
            let operator = match (tally.ticks(), done) {
                (0, false) => Some(OperatorEvent::Enable),
                (0, true) => None,
                (_, true) => hold.end(REST_TICKS - rest_ticks <= RELEASE_TICKS),
                (_, false) => hold.next(signals.held(), || self.operator.next()),
            };
            let ticked = self.tick(&period, measured, operator, &mut tally, clock);
            let Some((record, answer)) = ticked else {
                break;
            };
            setpoints = Some(answer);
            tally.tick(&record);
            self.operator
                .report(&record, &self.controller, timing.skipped());
            if let Some(log) = &mut self.log {
                log.tick(&record);
            }
            if record.has_fault() {
                hold.faulted(record.arms.count() > 1);
                if self.fault_ends_run {
                    signals.end_run();
                }
            }
        }
        let counts = timing.end();
        // The arms hear of every command that the log has.
        self.rig.exchange(setpoints.as_ref());
        tally.measured(&self.controller);
        let log_dropped = self.log.as_ref().map_or(0, TickLog::dropped);
        ControlEnd {
            rig: self.rig,
            tally,
            counts,
            log_dropped,
        }
    }

    /// The controller's tick with the chunks that have come; none if there are other arms than the controller's, which `Setup` rules
    /// out.
    fn tick(
        &mut self,
        period: &Period,
        measured: PerArm<Measured>,
        operator: Option<OperatorEvent>,
        tally: &mut Tally,
        clock: MonotonicClock,
    ) -> Option<(TickRecord, PerArm<Setpoint>)> {
        let waits = |chunks: &PerArm<Chunk>| is_ahead(&chunks.first, period);
        let (chunks, change) = self.drivers.next(waits, operator.is_none());
        let operator = operator.or(change);
        if let Some(chunks) = &chunks {
            let latency_ns = period.now.since(chunks.first.observed_at);
            // What the result says of chunks is the policy's.
            if self.drivers.is_policy() {
                tally.delivery(latency_ns);
            }
            self.operator.chunk(chunks, latency_ns);
            if let Some(log) = &mut self.log {
                for (arm, chunk) in chunks.iter().enumerate() {
                    log.chunk(arm, chunk);
                }
            }
        }
        let controller = &mut self.controller;
        rig::control(
            controller,
            period,
            measured,
            chunks.as_ref(),
            operator,
            clock,
        )
    }
}

/// Whether `chunk` was observed after the period of a thread that woke late, though not after it woke.
///
/// The next period takes it. One from beyond the clock is nonsense, for the gate to refuse.
const fn is_ahead(chunk: &Chunk, period: &Period) -> bool {
    let woke = period.now.plus_ns(period.late_ns);
    period.now.0 < chunk.observed_at.0 && chunk.observed_at.0 <= woke.0
}

#[cfg(test)]
mod tests {
    use hal::{TICK_NS, TimeNs};

    use super::*;

    /// Only an observation that a late thread slept past is waited for.
    #[test]
    fn late_thread_waits_for_the_observation_it_missed() {
        let period = Period {
            now: TimeNs(50 * TICK_NS),
            late_ns: 3 * TICK_NS,
            skipped: 0,
            measured: None,
        };
        let woke = period.now.plus_ns(period.late_ns);
        for (observed_at, expected) in [
            (period.now.0 - 1, false),
            (period.now.0, false),
            (period.now.0 + TICK_NS / 2, true),
            (woke.0, true),
            (woke.0 + 1, false),
            (u64::MAX, false),
        ] {
            let chunk = Chunk::new(TimeNs(observed_at), 1, TICK_NS, &[]);
            assert_eq!(is_ahead(&chunk, &period), expected, "{observed_at}");
        }
    }
}
