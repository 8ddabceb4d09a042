//! Hot path: bounded, no allocation, no I/O, never waits. What the control thread says of its ticks
//! to the console.
//!
//! It counts every tick and hands over the newest one with the counts fifty times a second, and at
//! once when an arm's state changes.

use hal::{ARMS_MAX, Chunk, PerArm, TICK_NS, TimeNs};
use rtrb::Producer;
use trocar_control::rows::Velocities;
use trocar_control::{
    AnyController, Fault, GateDecision, OperatingState, OperatorEvent, QpOutcome,
};
use trocar_log::{ArmRecord, TickRecord};

use crate::mailbox::MailboxWriter;
use crate::session::teleop::{Commanded, Given};

/// Ticks from one report to the next.
const EVERY_TICKS: u64 = 20;

/// Upper ends of the buckets of a histogram, us; what is longer is in one more.
pub(super) const BUCKETS_US: [u64; 16] = [
    1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 20_000, 50_000, 100_000,
];

/// The same of periods, which are about a millisecond.
pub(super) const PERIOD_BUCKETS_US: [u64; BUCKETS_US.len()] = [
    500, 800, 900, 950, 980, 990, 1000, 1010, 1020, 1050, 1100, 1200, 1500, 2000, 5000, 10_000,
];

/// Rows that are told by name.
const ROWS_MAX: usize = 8;

/// Durations in buckets.
#[derive(Clone, Copy, Debug)]
pub(super) struct Buckets {
    ends_us: &'static [u64; BUCKETS_US.len()],
    pub(super) counts: [u64; BUCKETS_US.len() + 1],
    pub(super) newest_ns: u64,
    pub(super) max_ns: u64,
}

impl Buckets {
    /// Empty ones that end at `ends_us`.
    pub(super) const fn new(ends_us: &'static [u64; BUCKETS_US.len()]) -> Self {
        Self {
            ends_us,
            counts: [0; BUCKETS_US.len() + 1],
            newest_ns: 0,
            max_ns: 0,
        }
    }

    pub(super) fn record(&mut self, duration_ns: u64) {
        let bucket = self
            .ends_us
            .partition_point(|end_us| end_us * 1000 < duration_ns);
        if let Some(count) = self.counts.get_mut(bucket) {
            *count += 1;
        }
        self.newest_ns = duration_ns;
        self.max_ns = self.max_ns.max(duration_ns);
    }
}

/// What the filter last changed.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Changed {
    /// In which tick.
    pub(super) tick: u64,
    /// The rows that held it, by their place in [`names`](trocar_control::rows::names), the first
    /// of them.
    pub(super) rows: [u16; ROWS_MAX],
    /// How many there were.
    pub(super) count: u16,
    /// By how much the velocity of each axis was changed, in its limit.
    pub(super) change: Velocities,
}

/// A chunk that the gate refused.
#[derive(Clone, Copy, Debug)]
pub(super) struct Refused {
    /// In which it was refused.
    pub(super) tick: u64,
    pub(super) arm: usize,
    pub(super) reason: GateDecision,
}

/// What was counted since the run began.
#[derive(Clone, Copy, Debug)]
pub(super) struct Counts {
    pub(super) ticks: u64,
    /// Whole periods that were skipped.
    pub(super) skipped: u64,
    pub(super) compute: Buckets,
    pub(super) wake: Buckets,
    /// From one wake-up to the next.
    pub(super) period: Buckets,
    /// From observation to chunk.
    pub(super) latency: Buckets,
    pub(super) passed: u64,
    pub(super) solved: u64,
    pub(super) failed: u64,
    pub(super) guard_interventions: u64,
    /// When the guard last intervened.
    pub(super) guard_tick: Option<u64>,
    pub(super) chunks: u64,
    pub(super) refused: u64,
    pub(super) last_refused: Option<Refused>,
    pub(super) last_changed: Option<Changed>,
    /// Share of the speed limits that is allowed, percent.
    pub(super) speed_percent: u8,
}

/// The newest tick with what was counted up to it. Plain data.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sample {
    pub(super) record: TickRecord,
    pub(super) counts: Counts,
}

type States = [Option<(OperatingState, bool)>; ARMS_MAX];

/// The control thread's end.
#[derive(Debug)]
pub struct ControlTap {
    to: MailboxWriter<Sample>,
    commanded: MailboxWriter<Commanded>,
    chunks: MailboxWriter<PerArm<Chunk>>,
    given: Given,
    counts: Counts,
    /// When the tick before woke up.
    woke: Option<TimeNs>,
    /// When it last reported, and in which states the arms were.
    reported: Option<(u64, States)>,
    /// For ticks in which something happened; one that finds no room is not told of.
    noted: Producer<TickRecord>,
    /// Whether the guard intervened in the tick before, and in which states the arms were.
    was: (bool, States),
}

impl ControlTap {
    pub(super) fn new(
        to: MailboxWriter<Sample>,
        commanded: MailboxWriter<Commanded>,
        chunks: MailboxWriter<PerArm<Chunk>>,
        noted: Producer<TickRecord>,
    ) -> Self {
        Self {
            to,
            commanded,
            chunks,
            given: Given::nothing(),
            counts: Counts {
                ticks: 0,
                skipped: 0,
                compute: Buckets::new(&BUCKETS_US),
                wake: Buckets::new(&BUCKETS_US),
                period: Buckets::new(&PERIOD_BUCKETS_US),
                latency: Buckets::new(&BUCKETS_US),
                passed: 0,
                solved: 0,
                failed: 0,
                guard_interventions: 0,
                guard_tick: None,
                chunks: 0,
                refused: 0,
                last_refused: None,
                last_changed: None,
                speed_percent: 100,
            },
            woke: None,
            reported: None,
            noted,
            was: (false, [None; ARMS_MAX]),
        }
    }

    /// These chunks were handed to the controller, so long after their observation.
    ///
    /// Called by the control thread before the tick that takes them.
    pub fn chunk(&mut self, chunks: &PerArm<Chunk>, latency_ns: u64) {
        self.chunks.put(*chunks);
        self.counts.chunks += 1;
        self.counts.latency.record(latency_ns);
    }

    /// A tick is over, and so many periods have been skipped since the run began. Called by the
    /// control thread at the end of each tick: constant time, but for one pass over the filter's
    /// rows every ten ticks at most.
    pub fn tick(&mut self, record: &TickRecord, controller: &AnyController, skipped: u64) {
        self.note_rows(record, controller);
        self.count(record, skipped);
        self.tell_commanded(record);
        let states = states(record);
        self.note(record, &states);
        let due = self
            .reported
            .is_none_or(|(tick, before)| record.tick >= tick + EVERY_TICKS || before != states);
        if due {
            self.reported = Some((record.tick, states));
            self.to.put(self.sample(record));
        }
    }

    /// Notes a tick in which the operator said something, an arm's state changed, the guard began
    /// to intervene or a chunk was refused.
    fn note(&mut self, record: &TickRecord, states: &States) {
        let any = |what: fn(&ArmRecord) -> bool| record.arms.iter().any(what);
        let guard = any(|arm| arm.report.guard_intervened);
        let before = core::mem::replace(&mut self.was, (guard, *states));
        let refused = |arm: &ArmRecord| arm.report.gate.is_some_and(|gate| !gate.is_accepted());
        if before.1 != *states
            || (guard && !before.0)
            || any(|arm| arm.operator.is_some())
            || any(refused)
        {
            let _full = self.noted.push(*record);
        }
    }

    /// Every tick's, since hands that take the clutch begin from there.
    fn tell_commanded(&mut self, record: &TickRecord) {
        let commanded = Commanded::after(record, &mut self.given);
        self.commanded.put(commanded);
    }

    /// A tick with what was counted up to now.
    pub(super) const fn sample(&self, record: &TickRecord) -> Sample {
        Sample {
            record: *record,
            counts: self.counts,
        }
    }

    /// A tick counts once for all arms: as failed if any arm's QP failed, else as solved if any
    /// was.
    fn count(&mut self, record: &TickRecord, skipped: u64) {
        let counts = &mut self.counts;
        counts.ticks += 1;
        counts.skipped = skipped;
        counts.compute.record(record.timing.compute_ns);
        counts.wake.record(record.timing.wake_ns);
        let woke = record.now.plus_ns(record.timing.wake_ns);
        if let Some(before) = self.woke.replace(woke) {
            counts.period.record(woke.since(before));
        }
        let any = |what: fn(QpOutcome) -> bool| record.arms.iter().any(|arm| what(arm.report.qp));
        if any(|qp| qp == QpOutcome::Failed) {
            counts.failed += 1;
        } else if any(|qp| matches!(qp, QpOutcome::Solved { .. })) {
            counts.solved += 1;
        } else {
            counts.passed += 1;
        }
        if record.arms.iter().any(|arm| arm.report.guard_intervened) {
            counts.guard_interventions += 1;
            counts.guard_tick = Some(record.tick);
        }
        for (arm, given) in record.arms.iter().enumerate() {
            if let Some(reason) = given.report.gate.filter(|gate| !gate.is_accepted()) {
                counts.refused += 1;
                counts.last_refused = Some(Refused {
                    tick: record.tick,
                    arm,
                    reason,
                });
            }
        }
        if let Some(OperatorEvent::Speed { percent }) = record.arms.first.operator {
            counts.speed_percent = percent.min(100);
        }
    }

    /// Which rows held the filter's answer; not in every tick, since that is a pass over all rows.
    fn note_rows(&mut self, record: &TickRecord, controller: &AnyController) {
        let solved = |qp| matches!(qp, QpOutcome::Solved { .. });
        let fresh = self
            .counts
            .last_changed
            .is_some_and(|changed| record.tick < changed.tick + EVERY_TICKS / 2);
        if fresh || !record.arms.iter().any(|arm| solved(arm.report.qp)) {
            return;
        }
        let change = *controller.solution();
        let mut changed = Changed {
            tick: record.tick,
            change,
            ..Changed::default()
        };
        for index in controller.problem().active(&change) {
            if let (Some(row), Ok(index)) = (
                changed.rows.get_mut(usize::from(changed.count)),
                u16::try_from(index),
            ) {
                *row = index;
            }
            changed.count += 1;
        }
        self.counts.last_changed = Some(changed);
    }
}

/// Each arm's operating state and whether it has a fault; none for an arm that is not there.
fn states(record: &TickRecord) -> States {
    let mut states = [None; ARMS_MAX];
    for (state, arm) in states.iter_mut().zip(record.arms.iter()) {
        let fault: Option<Fault> = arm.report.fault;
        *state = Some((arm.report.mode.state, fault.is_some()));
    }
    states
}

/// Ticks as seconds.
pub(super) fn seconds(tick: u64) -> f64 {
    hal::TimeNs(tick.saturating_mul(TICK_NS)).seconds()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn durations_are_in_the_bucket_that_ends_at_or_after_them() {
        let mut buckets = Buckets::new(&BUCKETS_US);
        for (duration_ns, bucket) in [
            (0, 0),
            (1000, 0),
            (1001, 1),
            (2000, 1),
            (49_999, 5),
            (100_000_000, 15),
            (u64::MAX, 16),
        ] {
            let before = buckets.counts;
            buckets.record(duration_ns);
            assert_eq!(buckets.counts[bucket], before[bucket] + 1, "{duration_ns}");
        }
        assert_eq!(buckets.max_ns, u64::MAX);
        let mut periods = Buckets::new(&PERIOD_BUCKETS_US);
        for (period_ns, bucket) in [
            (999_000, 6),
            (1_000_000, 6),
            (1_015_000, 8),
            (3_000_000, 14),
        ] {
            let before = periods.counts;
            periods.record(period_ns);
            assert_eq!(periods.counts[bucket], before[bucket] + 1, "{period_ns}");
        }
    }
}
