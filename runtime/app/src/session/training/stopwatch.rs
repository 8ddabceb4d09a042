//! How long a training has taken, over all of its parts.

use hal::TimeNs;

use crate::rt::MonotonicClock;

/// How long a training has taken.
#[derive(Clone, Copy, Debug)]
pub(super) struct Stopwatch {
    clock: MonotonicClock,
    begun: TimeNs,
    /// What it took before it was stopped the last time, s.
    before: f64,
}

impl Stopwatch {
    /// One that has run for `before` seconds.
    pub(super) fn start(before: f64) -> Self {
        let clock = MonotonicClock::new();
        let begun = clock.now();
        Self {
            clock,
            begun,
            before,
        }
    }

    /// Time since the start, s.
    pub(super) fn seconds(&self) -> f64 {
        self.before + TimeNs(self.clock.now().since(self.begun)).seconds()
    }
}
