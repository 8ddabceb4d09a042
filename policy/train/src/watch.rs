//! Who watches a run, and what it hears.

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
    /// Clouds are made; in some frames nothing wanted was in view, and their clouds lie at the origin.
    Unseen {
        /// Frames without a point.
        frames: usize,
        /// Frames of the dataset.
        of: usize,
    },
    /// The steps begin.
    Begin {
        /// Steps taken before, by the run that this one goes on with.
        step: u64,
        /// Steps of the whole run.
        steps: u64,
    },
    /// A step was taken that the watcher wants to hear of: see [`Watch::wants_step`].
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

/// Who watches a run. A function of [`Progress`] is one that never stops it and keeps nothing.
pub trait Watch {
    /// Hears where the run stands.
    fn progress(&mut self, progress: &Progress);

    /// Whether it wants to hear of the step after which `step` are done; asked after every step. Its loss is then waited for,
    /// which holds up a device whose work is queued ahead.
    fn wants_step(&mut self, step: u64) -> bool {
        let _unwanted = step;
        false
    }

    /// Whether it wants the network as it is after `step` steps; asked after every step, and where a run is gone on with.
    fn wants_network(&mut self, step: u64) -> bool {
        let _unwanted = step;
        false
    }

    /// Gets what the run would come to if it ended after `step` steps. The run goes on to the same bits whatever is done with it,
    /// provided that the network library's number of threads is left as it was.
    ///
    /// # Errors
    /// Whatever is to end the run.
    fn network(&mut self, step: u64, trained: AnyTrained) -> Result<(), TrainError> {
        drop((step, trained));
        Ok(())
    }

    /// Whether the run should keep its state and stop; asked after every step.
    fn wants_stop(&mut self) -> bool {
        false
    }

    /// Keeps the state, every [`TrainOptions::save_every`] steps and when the run is stopped.
    ///
    /// # Errors
    /// Whatever is to end the run.
    fn keep(&mut self, state: RunState) -> Result<(), TrainError> {
        drop(state);
        Ok(())
    }
}

impl<F: FnMut(&Progress)> Watch for F {
    fn progress(&mut self, progress: &Progress) {
        self(progress);
    }
}
