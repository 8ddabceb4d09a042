//! What is said of a training in progress.

use super::score::Score;
use super::training_pace::Standing;

/// What is said of a training in progress.
#[derive(Clone, Copy, Debug)]
pub enum TrainingNews<'a> {
    /// A line worth reading.
    Note(&'a str),
    /// A line about what may not be meant.
    Warning(&'a str),
    /// The dataset is being decoded.
    Reading {
        /// Frames done.
        frames: usize,
        /// Frames of the dataset.
        of: usize,
        /// Time since the start, s.
        seconds: f64,
    },
    /// Steps are being taken: news of the first one, then about twice a second, and of every row of the loss curve.
    Standing(&'a Standing),
    /// The weights are being evaluated.
    Evaluating {
        /// Steps of training.
        step: u64,
        /// Trials done.
        trials: usize,
        /// Trials of the evaluation.
        of: usize,
        /// How those that are done ended.
        score: Score,
    },
}

/// The receiver of the news.
pub type OnNews<'a> = dyn FnMut(&TrainingNews<'_>) + 'a;
