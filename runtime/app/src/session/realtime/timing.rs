//! How punctual a control thread was, and what befell it.

use hal::Period;

use crate::histogram::Histogram;
use crate::rt::{
    self, Held, RtOptions, RtReport, ThreadFaults, configure_thread, thread_allocations,
    thread_faults,
};
use crate::session::summary::{PercentilesUs, RealTimeCounts, ThreadCounts};

/// Counts of the calling thread's loop. [`Self::woke`] is on the hot path: bounded, no allocation.
#[derive(Debug)]
pub(super) struct LoopTiming {
    granted: RtReport,
    faults: ThreadFaults,
    allocations: u64,
    skipped: u64,
    wakes: Histogram,
    periods: Histogram,
    /// When the thread last woke, ns.
    woke_ns: Option<u64>,
}

impl LoopTiming {
    /// Makes the calling thread what `options` ask for, as far as the system grants it, and begins to count; `held` is what the process
    /// got.
    pub(super) fn begin(options: &RtOptions, held: &Held) -> Self {
        let (wakes, periods) = (Histogram::new(), Histogram::new());
        let mut granted = configure_thread(options).unwrap_or_else(|refused| refused.0);
        if !granted.memory.is_refused() {
            granted.memory = held.memory.clone();
        }
        granted.cpu_latency = held.cpu_latency.clone();
        Self {
            granted,
            skipped: 0,
            wakes,
            periods,
            woke_ns: None,
            faults: thread_faults(),
            allocations: thread_allocations(),
        }
    }

    /// Counts a period that has begun.
    pub(super) fn woke(&mut self, period: &Period) {
        self.skipped += period.skipped;
        self.wakes.record(period.late_ns);
        let woke_ns = period.now.0.saturating_add(period.late_ns);
        if let Some(before) = self.woke_ns.replace(woke_ns) {
            self.periods.record(woke_ns.saturating_sub(before));
        }
    }

    /// Whole periods skipped so far.
    pub(super) const fn skipped(&self) -> u64 {
        self.skipped
    }

    /// The counts; `log_dropped` is 0, since only the log knows it.
    pub(super) fn end(self) -> RealTimeCounts {
        let allocations = thread_allocations().wrapping_sub(self.allocations);
        RealTimeCounts {
            overruns: self.skipped,
            wake_us: PercentilesUs::of(&self.wakes),
            period_us: PercentilesUs::of(&self.periods),
            thread: ThreadCounts {
                allocations,
                faults: thread_faults().since(&self.faults),
                granted: self.granted,
            },
            log_dropped: 0,
            slow_motion: rt::slow_motion(),
        }
    }
}
