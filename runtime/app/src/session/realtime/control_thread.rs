//! The control thread of a real-time run: exchange with the rig, tick, once a period.
//!
//! Hot path: bounded, no allocation, no lock, no I/O but the rig's. The loop knows no task: it runs
//! until `signals` say that the run is done, then gives the arms [`REST_TICKS`] to stop, and in the
//! last [`RELEASE_TICKS`] of them takes their torque.

use std::sync::Arc;

use hal::{Chunk, Measured, PerArm, Period, Rig, Setpoint};
use rtrb::Consumer;
use trocar_control::{AnyController, OperatorEvent};
use trocar_log::{TickLog, TickRecord};

use super::channels::ControlChannels;
use super::drivers::Drivers;
use super::hold::Hold;
use super::signals::{Signals, StopsAll};
use super::timing::{LoopEnd, LoopTiming};
use crate::rig;
use crate::rt::{Held, MonotonicClock, RtOptions};
use crate::session::operator::OperatorPort;
use crate::session::plan::Arms;
use crate::session::tally::Tally;
use crate::session::teleop::TeleopCommand;
use crate::session::{Plan, SessionError};

/// Periods that the arms get to come to rest after the verdict: more than twice the longest stop.
const REST_TICKS: u64 = 500;

/// Of these, the last ones are for their drives to lose torque.
const RELEASE_TICKS: u64 = 10;

/// The control thread before it runs, without its rig.
pub(super) struct ControlThread {
    /// Of as many arms as the rig measures.
    controller: AnyController,
    /// Whose chunks are consumed: the policy's or an operator's.
    drivers: Drivers,
    /// Never waits: a full log drops ticks and counts them.
    log: Option<TickLog>,
    signals: Arc<Signals>,
    /// Commands in, status out, both without waiting.
    operator: OperatorPort,
    clock: MonotonicClock,
    /// What the thread asks of the system; of strict wishes
    /// [`RtProfile::check`](crate::rt::RtProfile::check) knows before there is a run.
    profile: RtOptions,
    /// What the process holds of the system, as long as the thread lives.
    held: Held,
    /// How many periods it may skip within a second.
    overruns_max: Option<u64>,
    /// Whether the run ends with a fault; else the arms hold until the operator clears it.
    fault_ends_run: bool,
}

/// What it leaves behind.
pub(super) struct ControlEnd<R> {
    pub(super) rig: R,
    /// Counts of the whole run, with what the controller measured.
    pub(super) tally: Tally,
    /// The loop's timing, without what the log dropped.
    pub(super) timing: LoopEnd,
    /// Messages that found the log's queue full.
    pub(super) log_dropped: u64,
}

impl<R> ControlEnd<R> {
    /// The same, with what `change` makes of the rig.
    pub(super) fn with_rig<S>(self, change: impl FnOnce(R) -> S) -> ControlEnd<S> {
        let Self {
            rig,
            tally,
            timing,
            log_dropped,
        } = self;
        ControlEnd {
            rig: change(rig),
            tally,
            timing,
            log_dropped,
        }
    }
}

impl ControlThread {
    /// That of a run of `plan`, with these `channels`; `hands` may take over from the policy.
    ///
    /// Allocates everything that the loop needs.
    ///
    /// # Errors
    /// If the controller's configuration is invalid, or a strict profile is refused what it asks of
    /// the system.
    pub(super) fn new<S: Arms>(
        plan: &Plan<S>,
        channels: ControlChannels,
        hands: Option<Consumer<TeleopCommand>>,
    ) -> Result<Self, SessionError> {
        let ControlChannels {
            chunks,
            log,
            signals,
            operator,
            clock,
        } = channels;
        let robot = plan.setup.robot();
        Ok(Self {
            controller: robot.controller()?,
            drivers: Drivers::new(chunks, hands),
            log,
            signals,
            operator,
            clock,
            profile: plan.real_time.control,
            held: plan.real_time.hold()?,
            overruns_max: plan.real_time.overruns_per_s_max,
            fault_ends_run: robot.control.fault_ends_run,
        })
    }

    /// What it shares with the other threads.
    pub(super) const fn signals(&self) -> &Arc<Signals> {
        &self.signals
    }

    /// What it asks of the system.
    pub(super) const fn profile(&self) -> &RtOptions {
        &self.profile
    }

    /// Runs with `rig` until the arms rest without torque after the verdict, or after a fault of
    /// any that ends the run.
    pub(super) fn run<R: Rig>(mut self, mut rig: R) -> ControlEnd<R> {
        let signals = Arc::clone(&self.signals);
        let _stops = StopsAll(&signals);
        let mut tally = Tally::default();
        let mut rest_ticks = 0;
        let mut hold = Hold::default();
        let mut setpoints = None;
        let mut timing = LoopTiming::begin(&self.profile, &self.held, self.overruns_max);
        while rest_ticks < REST_TICKS {
            let period = rig.exchange(setpoints.take().as_ref());
            if let Some(skipped) = timing.woke(&period) {
                signals.overran(skipped);
            }
            let done = signals.done();
            rest_ticks += u64::from(done);
            let Some(measured) = period.measured else {
                continue;
            };
            // A rig of one's own may have another number of arms, at any time: `run_rig` says so.
            if measured.count() != self.controller.arm_count() {
                break;
            }
            let operator = match (tally.ticks(), done) {
                (0, false) => Some(OperatorEvent::Enable),
                (0, true) => None,
                (_, true) => hold.end(REST_TICKS - rest_ticks <= RELEASE_TICKS),
                (_, false) => hold.next(signals.held(), || self.operator.next()),
            };
            let (record, answer) = self.tick(&period, measured, operator, &mut tally);
            setpoints = Some(answer);
            tally.tick(&record);
            self.operator
                .report(&record, &self.controller, timing.skipped());
            if let Some(log) = &mut self.log {
                log.tick(&record);
                log.snapshot(&self.controller);
            }
            if record.has_fault() {
                hold.faulted(record.arms.count() > 1);
                if self.fault_ends_run {
                    signals.end_run();
                }
            }
        }
        let timing = timing.end();
        // The arms hear of every command that the log has.
        rig.exchange(setpoints.as_ref());
        tally.measured(&self.controller);
        let log_dropped = self.log.as_ref().map_or(0, TickLog::dropped);
        ControlEnd {
            rig,
            tally,
            timing,
            log_dropped,
        }
    }

    /// The controller's tick with the chunks that have come.
    ///
    /// At most one answer is consumed a period, the oldest in the queue. The delivery time is
    /// counted from the observation to this period's due time.
    fn tick(
        &mut self,
        period: &Period,
        measured: PerArm<Measured>,
        operator: Option<OperatorEvent>,
        tally: &mut Tally,
    ) -> (TickRecord, PerArm<Setpoint>) {
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
            self.clock,
        )
    }
}

/// Whether `chunk` was observed after the period of a thread that woke late, though not after it
/// woke.
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
