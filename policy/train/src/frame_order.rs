//! Which frames a step trains on.

use hal::count;
use hal::random::SplitMix64;

/// Frames in random order, each once before any comes again.
///
/// The frames of a step depend on the seed and the step alone, so that a run can resume anywhere.
pub(super) struct FrameOrder {
    /// Those that are trained on, in the dataset's order.
    frames: Vec<usize>,
    seed: u64,
    /// The newest round through all frames, and its order.
    round: Option<(u64, Vec<usize>)>,
}

impl FrameOrder {
    /// An order of `frames` that `seed` draws.
    pub(super) fn new(frames: &[usize], seed: u64) -> Self {
        Self {
            frames: frames.to_vec(),
            seed,
            round: None,
        }
    }

    /// The `count` frames of `step`, from 0, when every step has as many; none if there are no
    /// frames at all. A batch may span two rounds, and then hold a frame twice.
    pub(super) fn of_step(&mut self, step: u64, count: usize) -> Vec<usize> {
        let total = self.frames.len() as u64;
        if total == 0 {
            return Vec::new();
        }
        let first = step.saturating_mul(count as u64);
        (first..first.saturating_add(count as u64))
            .map(|drawn| {
                let place = count::index(drawn % total);
                self.round(drawn / total)[place]
            })
            .collect()
    }

    /// The frames in the order of the pass `number` over all of them.
    fn round(&mut self, number: u64) -> &[usize] {
        if self.round.as_ref().is_none_or(|(of, _)| *of != number) {
            let mut random = SplitMix64::named(&format!("train/round/{number}"), self.seed);
            let mut frames = self.frames.clone();
            random.shuffle(&mut frames);
            self.round = Some((number, frames));
        }
        self.round.as_ref().map_or(&[], |(_, frames)| frames)
    }
}

#[cfg(test)]
mod tests {
    use super::FrameOrder;

    /// A step is computed without those before it.
    #[test]
    fn each_epoch_has_each_frame_once_from_any_step_on() {
        let frames: Vec<usize> = (10..17).collect();
        let mut order = FrameOrder::new(&frames, 5);
        let steps: Vec<Vec<usize>> = (0..7).map(|step| order.of_step(step, 3)).collect();
        let drawn: Vec<usize> = steps.iter().flatten().copied().collect();
        for round in drawn.chunks(7) {
            let mut round = round.to_vec();
            round.sort_unstable();
            assert_eq!(round, frames);
        }
        assert_ne!(drawn[..7], drawn[7..14], "every round is another");
        assert_eq!(FrameOrder::new(&frames, 5).of_step(4, 3), steps[4]);
        assert_ne!(FrameOrder::new(&frames, 6).of_step(4, 3), steps[4]);
        assert!(FrameOrder::new(&[], 5).of_step(4, 3).is_empty());
    }
}
