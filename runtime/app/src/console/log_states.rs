//! What a log says tick by tick, as text: a bounded number of bytes of a log of any length.

use std::collections::BTreeMap;

/// Ticks from one state that is kept to the next, at first.
const EVERY_TICKS: u64 = 20;

/// Bytes of states that are kept, of some ten minutes of one arm, and of scenes; of longer logs
/// they are further apart.
const STATE_BYTES_MAX: usize = 64 << 20;

/// One that is longer, bytes, is no state, scene or bus of ours, and let go.
const STATE_LEN_MAX: usize = 64 << 10;

/// States, scenes or what was said of buses, by tick, a bounded number of bytes.
#[derive(Debug)]
pub(super) struct States {
    kept: BTreeMap<u64, Box<str>>,
    bytes: usize,
    every_ticks: u64,
}

impl Default for States {
    fn default() -> Self {
        Self {
            kept: BTreeMap::new(),
            bytes: 0,
            every_ticks: EVERY_TICKS,
        }
    }
}

impl States {
    pub(super) fn is_empty(&self) -> bool {
        self.kept.is_empty()
    }

    /// What was at `tick`, or the nearest before it, or else the first; with its own tick.
    pub(super) fn at(&self, tick: u64) -> Option<(u64, &str)> {
        let before = self.kept.range(..=tick).next_back();
        let (tick, state) = before.or_else(|| self.kept.first_key_value())?;
        Some((*tick, state))
    }

    /// What was at `tick`, or the nearest before it.
    pub(super) fn before(&self, tick: u64) -> Option<&str> {
        let before = self.kept.range(..=tick).next_back();
        before.map(|(_, state)| &**state)
    }

    /// Keeps what was at `tick`, unless it is too near to what was kept before.
    pub(super) fn offer(&mut self, tick: u64, state: &str) {
        if state.len() <= STATE_LEN_MAX && self.wants(tick) {
            self.keep(tick, state.into());
        }
    }

    /// Whether `tick` is as far from the newest state as states are apart now.
    pub(super) fn wants(&self, tick: u64) -> bool {
        let newest = self.kept.last_key_value();
        newest.is_none_or(|(newest, _)| tick >= newest.saturating_add(self.every_ticks))
    }

    pub(super) fn keep(&mut self, tick: u64, state: Box<str>) {
        self.bytes += state.len();
        self.kept.insert(tick, state);
        if self.bytes > STATE_BYTES_MAX {
            self.thin_out();
        }
    }

    /// Lets those go that are less than twice as far apart as before.
    fn thin_out(&mut self) {
        self.every_ticks = self.every_ticks.saturating_mul(2);
        let (every_ticks, mut newest) = (self.every_ticks, None);
        self.kept.retain(|tick, _| {
            let keeps =
                newest.is_none_or(|newest| *tick >= u64::saturating_add(newest, every_ticks));
            newest = if keeps { Some(*tick) } else { newest };
            keeps
        });
        self.bytes = self.kept.values().map(|state| state.len()).sum();
    }
}

#[cfg(test)]
mod tests {
    use super::{EVERY_TICKS, STATE_BYTES_MAX, States};

    /// A log of hours takes no more than one of minutes: its states are further apart, from its
    /// beginning to its end.
    #[test]
    fn states_of_a_long_log_take_bounded_memory() {
        let mut states = States::default();
        let state = "x".repeat(64 << 10);
        let last = EVERY_TICKS * 5000;
        for tick in 0..=last {
            if states.wants(tick) {
                states.keep(tick, state.as_str().into());
            }
        }
        assert!(states.bytes <= STATE_BYTES_MAX && states.bytes > STATE_BYTES_MAX / 4);
        assert_eq!(states.bytes, states.kept.len() * state.len());
        let (first, newest) = (states.kept.first_key_value(), states.kept.last_key_value());
        assert_eq!(first.map(|(tick, _)| *tick), Some(0));
        assert!(newest.is_some_and(|(tick, _)| last - tick < states.every_ticks));
        let ticks: Vec<u64> = states.kept.keys().copied().collect();
        let apart = ticks.windows(2).map(|two| two[1] - two[0]);
        assert_eq!(apart.max(), Some(states.every_ticks));
    }
}
