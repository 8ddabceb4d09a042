//! Time that did not pass for the drives, since their process was kept from running.
//!
//! A report of a late stop would otherwise blame the master or the drives for what the machine's
//! load did.

use std::collections::VecDeque;

use hal::TimeNs;

/// As many are remembered; older ones are only summed up.
const NEWEST: usize = 256;

/// When it did not pass, in the drives' time, and for how long.
#[derive(Clone, Debug)]
pub(super) struct Stalls {
    /// Oldest first; allocated once.
    newest: VecDeque<(TimeNs, u64)>,
    /// Also of those that are forgotten.
    total_ns: u64,
}

impl Stalls {
    pub(super) fn new() -> Self {
        Self {
            newest: VecDeque::with_capacity(NEWEST),
            total_ns: 0,
        }
    }

    /// At `at` so much time did not pass, ns.
    ///
    /// Time is not negative: 0 is not kept.
    pub(super) fn note(&mut self, at: TimeNs, ns: u64) {
        if ns == 0 {
            return;
        }
        if self.newest.len() == NEWEST {
            self.newest.pop_front();
        }
        self.newest.push_back((at, ns));
        self.total_ns += ns;
    }

    /// How much did not pass from `start` on, ns.
    ///
    /// Less than the truth if more than 256 have come since `start`.
    pub(super) fn since(&self, start: TimeNs) -> u64 {
        let newer = self.newest.iter().filter(|(at, _)| *at >= start);
        newer.map(|(_, ns)| ns).sum()
    }

    /// How much did not pass at all, ns.
    pub(super) const fn total_ns(&self) -> u64 {
        self.total_ns
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_stall_counts_for_what_began_before_it() {
        let mut stalls = Stalls::new();
        for n in 0..1000 {
            stalls.note(TimeNs(n * 10), 3);
            stalls.note(TimeNs(n * 10), 0);
        }
        assert_eq!(stalls.total_ns(), 3000);
        assert_eq!(stalls.since(TimeNs(9970)), 9);
        assert_eq!(stalls.since(TimeNs(9991)), 0);
        assert_eq!(stalls.since(TimeNs(0)), 3 * 256);
    }
}
