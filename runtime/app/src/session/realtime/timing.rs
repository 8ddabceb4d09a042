//! How punctual a control thread was, and what befell it.

use hal::{Period, count};

use crate::histogram::Histogram;
use crate::rt::{
    self, Held, RtOptions, RtReport, ThreadFaults, configure_thread, thread_allocations,
    thread_faults,
};
use crate::session::summary::{
    BucketsUs, LoopHistograms, PercentilesUs, RealTimeCounts, ThreadCounts,
};

/// Parts of the second in which overruns are counted.
const PARTS: usize = 20;

/// How long each is, ns.
const PART_NS: u64 = 1_000_000_000 / PARTS as u64;

/// Periods skipped within the last second, give or take a part of it. Hot path: bounded, no
/// allocation.
#[derive(Debug, Default)]
struct Recent {
    parts: [u64; PARTS],
    /// Which part, counted from time 0, the newest is.
    newest: u64,
}

impl Recent {
    /// Takes in what was skipped by `now`, ns; how many there are now.
    fn add(&mut self, now: u64, skipped: u64) -> u64 {
        let part = (now / PART_NS).max(self.newest);
        let passed = (part - self.newest).min(PARTS as u64);
        for past in 0..passed {
            self.parts[index(part - past)] = 0;
        }
        self.newest = part;
        self.parts[index(part)] += skipped;
        self.parts.iter().sum()
    }
}

fn index(part: u64) -> usize {
    count::index(part % PARTS as u64)
}

/// Counts of the calling thread's loop. [`Self::woke`] is on the hot path: bounded, no allocation.
#[derive(Debug)]
pub(super) struct LoopTiming {
    granted: RtReport,
    faults: ThreadFaults,
    allocations: u64,
    skipped: u64,
    recent: Recent,
    limit: Option<u64>,
    wakes: Histogram,
    periods: Histogram,
    /// When the thread last woke, ns.
    woke_ns: Option<u64>,
}

impl LoopTiming {
    /// Makes the calling thread what `options` ask for, as far as the system grants it, and begins
    /// to count; `held` is what the process got. More than `limit` overruns within a second are too
    /// many.
    pub(super) fn begin(options: &RtOptions, held: &Held, limit: Option<u64>) -> Self {
        let (wakes, periods) = (Histogram::new(), Histogram::new());
        let mut granted = configure_thread(options).unwrap_or_else(|refused| refused.0);
        if !granted.memory.is_refused() {
            granted.memory = held.memory.clone();
        }
        granted.cpu_latency = held.cpu_latency.clone();
        Self {
            granted,
            skipped: 0,
            recent: Recent::default(),
            limit,
            wakes,
            periods,
            woke_ns: None,
            faults: thread_faults(),
            allocations: thread_allocations(),
        }
    }

    /// Counts a period that has begun; how many were skipped within the last second, if they are
    /// too many.
    pub(super) fn woke(&mut self, period: &Period) -> Option<u64> {
        // What the thread took to start is no overrun of the loop.
        let skipped = self.woke_ns.map_or(0, |_| period.skipped);
        self.skipped += period.skipped;
        self.wakes.record(period.late_ns);
        let woke_ns = period.now.0.saturating_add(period.late_ns);
        if let Some(before) = self.woke_ns.replace(woke_ns) {
            self.periods.record(woke_ns.saturating_sub(before));
        }
        let limit = self.limit?;
        let recent = self.recent.add(period.now.0, skipped);
        (recent > limit).then_some(recent)
    }

    /// Whole periods skipped so far.
    pub(super) const fn skipped(&self) -> u64 {
        self.skipped
    }

    /// What the thread's loop came to: the thread asks for no memory for it.
    pub(super) fn end(self) -> LoopEnd {
        LoopEnd {
            faults: thread_faults().since(&self.faults),
            allocations: thread_allocations().wrapping_sub(self.allocations),
            granted: self.granted,
            skipped: self.skipped,
            wakes: self.wakes,
            periods: self.periods,
        }
    }
}

/// The counts of a loop that is over.
#[derive(Debug)]
pub(super) struct LoopEnd {
    granted: RtReport,
    faults: ThreadFaults,
    allocations: u64,
    skipped: u64,
    wakes: Histogram,
    periods: Histogram,
}

impl LoopEnd {
    /// The same for people; `log_dropped` is 0, since only the log knows it, and of the ticks'
    /// compute time there is no histogram yet.
    pub(super) fn counts(&self) -> RealTimeCounts {
        RealTimeCounts {
            overruns: self.skipped,
            wake_us: PercentilesUs::of(&self.wakes),
            period_us: PercentilesUs::of(&self.periods),
            histograms: LoopHistograms {
                tick: BucketsUs::default(),
                wake: BucketsUs::of(&self.wakes),
                period: BucketsUs::of(&self.periods),
            },
            thread: ThreadCounts {
                allocations: self.allocations,
                faults: self.faults,
                granted: self.granted.clone(),
            },
            log_dropped: 0,
            slow_motion: rt::slow_motion(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::Recent;

    #[test]
    fn overruns_count_for_a_second() {
        let mut recent = Recent::default();
        let mut add = |ms: u64, skipped| recent.add(ms * 1_000_000, skipped);
        assert_eq!([add(10, 3), add(20, 4), add(700, 5)], [3, 7, 12]);
        // Those of the first 50 ms are forgotten a second later, and nothing counts twice.
        assert_eq!([add(999, 0), add(1049, 0), add(1699, 1)], [12, 5, 6]);
        assert_eq!([add(1700, 0), add(60_000, 2), add(61_000, 0)], [1, 2, 0]);
        // A clock does not go back, and if it did, nothing breaks.
        assert_eq!(add(1, 1), 1);
    }
}
