//! Progress of a training.

use super::pace::TrainingStatus;
use crate::session::score::Score;

/// Progress of a training.
#[derive(Clone, Copy, Debug)]
pub enum TrainingProgress<'a> {
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
    /// Steps are being taken: sent after the first one, then about twice a second, and for every
    /// row of the loss curve.
    Status(&'a TrainingStatus),
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

/// The progress callback.
pub type OnProgress<'a> = dyn FnMut(&TrainingProgress<'_>) + 'a;
