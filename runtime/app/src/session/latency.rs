//! How long after its observation a chunk is there, in lockstep: as in real time, late, unevenly,
//! and in order.

use std::collections::VecDeque;

use trocar_world::rng::Rng;

/// Time from an observation to the delivery of its chunk.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Latency {
    /// The least, ticks.
    pub ticks: u64,
    /// What may come on top, evenly distributed from nothing to this, ticks; every chunk draws its
    /// own.
    pub jitter_ticks: u64,
    /// What the draws depend on.
    pub seed: u64,
}

impl Latency {
    /// The same for every chunk.
    #[must_use]
    pub const fn fixed(ticks: u64) -> Self {
        Self {
            ticks,
            jitter_ticks: 0,
            seed: 0,
        }
    }
}

/// Chunks on their way. None overtakes another, as none does that one policy computes after
/// another.
#[derive(Debug)]
pub(super) struct Deliveries<T> {
    latency: Latency,
    random: Rng,
    /// When each is due, and what it is.
    pending: VecDeque<(u64, T)>,
}

impl<T> Deliveries<T> {
    pub(super) fn new(latency: Latency) -> Self {
        Self {
            latency,
            random: Rng::stream(latency.seed, "latency"),
            pending: VecDeque::new(),
        }
    }

    /// Sends what was observed at `tick`; says how many ticks it takes.
    pub(super) fn send(&mut self, tick: u64, chunk: T) -> u64 {
        let choices = usize::try_from(self.latency.jitter_ticks).unwrap_or(usize::MAX);
        let late = self.random.below(choices.saturating_add(1)) as u64;
        let due = tick + self.latency.ticks + late;
        let due = self
            .pending
            .back()
            .map_or(due, |(before, _)| due.max(*before));
        self.pending.push_back((due, chunk));
        due - tick
    }

    /// What is due at `tick`, one at a time.
    pub(super) fn receive(&mut self, tick: u64) -> Option<T> {
        let due = self.pending.pop_front_if(|(due, _)| *due <= tick);
        due.map(|(_, chunk)| chunk)
    }
}

#[cfg(test)]
mod tests {
    use super::{Deliveries, Latency};

    /// When each of the chunks that are sent every ten ticks arrives.
    fn arrivals(latency: Latency) -> Vec<(u64, u64)> {
        let mut deliveries = Deliveries::new(latency);
        let mut arrived = Vec::new();
        for tick in 0..2000 {
            if tick % 10 == 0 && tick < 1500 {
                deliveries.send(tick, tick);
            }
            arrived.extend(deliveries.receive(tick).map(|sent| (sent, tick)));
        }
        arrived
    }

    #[test]
    fn a_fixed_latency_is_that_of_every_chunk() {
        let arrived = arrivals(Latency::fixed(35));
        assert_eq!(arrived.len(), 150);
        assert!(arrived.iter().all(|(sent, tick)| tick - sent == 35));
    }

    /// Jitter is drawn by seed stays in its range and nothing overtakes.
    #[test]
    fn jitter_stays_in_range_and_keeps_the_order() {
        let latency = Latency {
            ticks: 30,
            jitter_ticks: 40,
            seed: 7,
        };
        let arrived = arrivals(latency);
        assert_eq!(arrived.len(), 150);
        assert!(arrived.is_sorted(), "in order");
        let delays: Vec<u64> = arrived.iter().map(|(sent, tick)| tick - sent).collect();
        // What waits for another one, and then for its turn, comes a little later than its own
        // draw.
        assert!(
            delays.iter().all(|delay| (30..=75).contains(delay)),
            "{delays:?}"
        );
        assert!(
            delays.iter().min() < Some(&40) && delays.iter().max() > Some(&60),
            "{delays:?}"
        );
        assert_eq!(arrived, arrivals(latency));
        assert_ne!(arrived, arrivals(Latency { seed: 8, ..latency }));
    }
}
