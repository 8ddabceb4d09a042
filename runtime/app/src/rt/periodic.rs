//! A fixed grid of deadlines: absolute, so that lateness never adds up, and skipped whole when
//! missed.

use hal::{Measured, PerArm, Period, TimeNs};

use super::MonotonicClock;

/// One period's start.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Wake {
    /// Which period of the grid this is, counted from 0, skipped ones included.
    pub index: u64,
    /// When it was due; exactly on the grid.
    pub due: TimeNs,
    /// When the thread ran.
    pub woke: TimeNs,
    /// Periods skipped just before this one.
    pub skipped: u64,
}

impl Wake {
    /// How late the thread ran, ns.
    #[must_use]
    pub const fn late_ns(&self) -> u64 {
        self.woke.since(self.due)
    }

    /// The control period that begins here, with what the arms measured.
    #[must_use]
    pub const fn period(&self, measured: Option<PerArm<Measured>>) -> Period {
        Period {
            now: self.due,
            late_ns: self.late_ns(),
            skipped: self.skipped,
            measured,
        }
    }
}

/// Wakes its thread once a period.
///
/// A period that starts late by less than its length is run at once. If whole periods have passed,
/// they are skipped and counted and the phase is kept.
#[derive(Clone, Debug)]
pub struct Periodic {
    /// Of `first` and all deadlines.
    clock: MonotonicClock,
    first: TimeNs,
    period_ns: u64,
    /// The period that is due next, if it is not missed.
    next_index: u64,
    skipped: u64,
}

impl Periodic {
    /// Period 0 is due at `first` on `clock`; a period of 0 ns counts as 1 ns.
    #[must_use]
    pub fn new(clock: MonotonicClock, first: TimeNs, period_ns: u64) -> Self {
        Self {
            clock,
            first,
            period_ns: period_ns.max(1),
            next_index: 0,
            skipped: 0,
        }
    }

    /// Sleeps until the next period is due. The control thread's wait: one absolute sleep, no
    /// allocation. After an overrun it returns at once, with the newest period that has begun.
    pub fn wait(&mut self) -> Wake {
        let skipped = missed(self.due(self.next_index), self.clock.now(), self.period_ns);
        let index = self.next_index + skipped;
        let due = self.due(index);
        self.clock.wait_until(due);
        self.next_index = index + 1;
        self.skipped += skipped;
        Wake {
            index,
            due,
            woke: self.clock.now(),
            skipped,
        }
    }

    /// When the next period is due, unless it is missed.
    #[must_use]
    pub fn next(&self) -> TimeNs {
        self.due(self.next_index)
    }

    /// Periods skipped so far.
    #[must_use]
    pub const fn skipped(&self) -> u64 {
        self.skipped
    }

    /// The clock that the grid lies on.
    #[must_use]
    pub const fn clock(&self) -> &MonotonicClock {
        &self.clock
    }

    /// By multiplication, so that no rounding adds up.
    fn due(&self, index: u64) -> TimeNs {
        self.first.plus_ns(index * self.period_ns)
    }
}

/// Whole periods that have passed at `now` since `due`.
const fn missed(due: TimeNs, now: TimeNs, period_ns: u64) -> u64 {
    now.since(due) / period_ns
}

#[cfg(test)]
mod tests {
    use super::*;

    const PERIOD_NS: u64 = 2_000_000;

    #[test]
    fn only_whole_periods_are_missed() {
        let due = TimeNs(10_000);
        for (now, expected) in [
            (0, 0),
            (10_000, 0),
            (10_999, 0),
            (11_000, 1),
            (13_999, 3),
            (14_000, 4),
        ] {
            assert_eq!(missed(due, TimeNs(now), 1_000), expected, "now = {now}");
        }
    }

    #[test]
    fn overrun_skips_whole_periods_and_keeps_the_phase() {
        let clock = MonotonicClock::new();
        let first = TimeNs(clock.now().0 + 500_123);
        let mut periodic = Periodic::new(clock, first, PERIOD_NS);
        let mut last: Option<Wake> = None;
        for turn in 0..12 {
            let wake = periodic.wait();
            assert!(wake.woke >= wake.due, "{wake:?}");
            assert_eq!(
                wake.due.since(first),
                wake.index * PERIOD_NS,
                "{wake:?} is off the grid"
            );
            if let Some(last) = last {
                assert_eq!(wake.index, last.index + 1 + wake.skipped);
            }
            if turn == 6 {
                assert!(
                    wake.skipped >= 2,
                    "{wake:?} after computing for more than three periods"
                );
            }
            if turn == 5 {
                let busy_until = TimeNs(wake.due.0 + 3 * PERIOD_NS + PERIOD_NS / 2);
                while clock.now() < busy_until {
                    core::hint::spin_loop();
                }
            }
            last = Some(wake);
        }
        assert_eq!(last.map(|wake| wake.index), Some(11 + periodic.skipped()));
    }

    #[test]
    fn waiting_ends_no_earlier_than_asked_even_for_the_past() {
        let clock = MonotonicClock::new();
        clock.wait_until(TimeNs(0));
        let deadline = clock.now().plus_ns(3_000_000);
        clock.wait_until(deadline);
        assert!(clock.now() >= deadline);
        let before = clock.now();
        crate::rt::sleep_ns(1_000_000);
        assert!(clock.now().since(before) >= 1_000_000);
    }
}
