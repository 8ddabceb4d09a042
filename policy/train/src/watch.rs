//! The observer of a run, and its progress.

use super::{AnyTrained, CurveRow, RunState, TrainError};

/// Where a run stands.
#[derive(Clone, Debug)]
pub enum Progress {
    /// Frames are being decoded.
    Read {
        /// Frames done.
        frames: usize,
        /// Frames of the dataset.
        of: usize,
    },
    /// Clouds are made; in some frames nothing wanted was in view, and their clouds lie at the
    /// origin.
    Unseen {
        /// Frames without a point.
        frames: usize,
        /// Frames of the dataset.
        of: usize,
    },
    /// The steps begin.
    Begin {
        /// Steps taken before, by the run that this one resumes.
        step: u64,
        /// Steps of the whole run.
        steps: u64,
    },
    /// A step that [`TrainingObserver::wants_step`] wants was taken.
    Step {
        /// Steps done.
        step: u64,
        /// Steps of the whole run.
        steps: u64,
        /// What is minimised, of this step alone.
        loss: f64,
    },
    /// Steps take longer than they could.
    Slower {
        /// Why.
        reason: String,
    },
    /// A row of the loss curve is there.
    Row {
        /// Steps of the whole run.
        steps: u64,
        /// The newest row.
        row: CurveRow,
    },
}

/// The observer of a run. A function of [`Progress`] is one that never stops it and stores nothing.
/// All methods are called on the thread that trains, which waits for them.
pub trait TrainingObserver {
    /// Reports progress.
    fn progress(&mut self, progress: &Progress);

    /// Whether to report the step after which `step` are done; called after every step. Reading its
    /// loss waits for the device.
    fn wants_step(&mut self, step: u64) -> bool {
        let _unwanted = step;
        false
    }

    /// Whether to pass the network after `step` steps to [`Self::network`]; called after every
    /// step, and when a run resumes.
    fn wants_network(&mut self, step: u64) -> bool {
        let _unwanted = step;
        false
    }

    /// Takes the outcome of the run as if it ended after `step` steps. The run continues with the
    /// same bits, provided that libtorch's number of threads is restored.
    ///
    /// # Errors
    /// Whatever is to end the run.
    fn network(&mut self, step: u64, trained: AnyTrained) -> Result<(), TrainError> {
        drop((step, trained));
        Ok(())
    }

    /// Whether the run should save its state and stop; called after every step.
    fn wants_stop(&mut self) -> bool {
        false
    }

    /// Saves the state, every [`TrainOptions::save_every`](crate::TrainOptions::save_every) steps
    /// and when the run is stopped.
    ///
    /// # Errors
    /// Whatever is to end the run.
    fn keep(&mut self, state: RunState) -> Result<(), TrainError> {
        drop(state);
        Ok(())
    }
}

impl<F: FnMut(&Progress)> TrainingObserver for F {
    fn progress(&mut self, progress: &Progress) {
        self(progress);
    }
}
