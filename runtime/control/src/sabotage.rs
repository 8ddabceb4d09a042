//! What tests break in a controller, to see what the rest is worth.

use super::filter::Filtered;
use super::guard::{Decision, Request};
use super::motion::MotionState;
use super::rows::Rows;
use super::rows::planted::RowFault;
use hal::random::SplitMix64;

/// What is broken.
#[derive(Debug, Default)]
pub(crate) struct Sabotage {
    /// Every candidate goes out as it is.
    pub(crate) guard_removed: bool,
    /// Whether the guard hears nothing of how far measured arms are from their commands.
    pub(crate) lag_ignored: bool,
    /// A row of the filter is wrong.
    pub(crate) row: Option<RowFault>,
    /// The filter's answers are replaced.
    pub(crate) garbage: Option<Garbage>,
}

/// A filter that gives nonsense now and then.
#[derive(Debug)]
pub(crate) struct Garbage {
    random: SplitMix64,
    chance: f64,
    stuck: Option<Filtered>,
    /// How many answers were replaced.
    pub(crate) count: u64,
}

impl Garbage {
    pub(crate) fn new(seed: u64, chance: f64) -> Self {
        Self {
            random: SplitMix64::new(seed),
            chance,
            stuck: None,
            count: 0,
        }
    }

    fn replace(&mut self, mut filtered: Filtered) -> Filtered {
        if !self.random.happens(self.chance) {
            self.stuck = Some(filtered);
            return filtered;
        }
        self.count += 1;
        let random = &mut self.random;
        match random.next_u64() % 6 {
            0 => filtered.velocity = [f64::NAN; 14],
            1 => filtered.velocity = core::array::from_fn(|_| random.between(-1e9, 1e9)),
            2 => filtered.velocity = filtered.velocity.map(|v| -v),
            3 => filtered.velocity = core::array::from_fn(|_| random.between(-3.0, 3.0)),
            4 => filtered.velocity = filtered.velocity.map(|v| v * 1e3 + 1e-310),
            _ => filtered = self.stuck.unwrap_or(filtered),
        }
        filtered
    }
}

impl Sabotage {
    pub(super) fn rows(&self, rows: &mut Rows) {
        if let Some(fault) = &self.row {
            rows.plant(fault);
        }
    }

    pub(super) fn filtered(&mut self, filtered: Filtered) -> Filtered {
        match &mut self.garbage {
            Some(garbage) => garbage.replace(filtered),
            None => filtered,
        }
    }
}

/// What a controller without a guard would do.
pub(super) fn without_guard<const ARMS: usize>(
    commanded: &[MotionState; ARMS],
    requests: &[Request; ARMS],
) -> [Decision; ARMS] {
    core::array::from_fn(|arm| {
        let state = match requests[arm] {
            Request::Follow(Some(state)) => state,
            Request::Follow(None) | Request::Stop => commanded[arm],
        };
        Decision {
            state,
            intervened: false,
        }
    })
}
