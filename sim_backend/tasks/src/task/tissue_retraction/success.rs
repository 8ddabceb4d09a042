//! The flap's own monitor as a judge of the task.

use trocar_world::tissue::{Retraction, RetractionConfig, RetractionMonitor};

use crate::task::{Monitor, Outcome, Reason, Sight};

/// Watches the flap.
pub(super) struct SuccessMonitor {
    flap: RetractionMonitor,
}

impl SuccessMonitor {
    /// A monitor at the start of an episode.
    pub(super) fn new(config: &RetractionConfig) -> Self {
        Self {
            flap: RetractionMonitor::new(config),
        }
    }
}

impl Monitor for SuccessMonitor {
    fn observe(&mut self, sight: &Sight) -> Outcome {
        if let Some(report) = &sight.tissue {
            self.flap.observe(report);
        }
        match self.flap.state() {
            Retraction::Running => Outcome::Running,
            Retraction::Success => Outcome::Success,
            Retraction::Failure(failure) if failure.is_of_the_simulation() => {
                Outcome::Invalid(Reason::Tissue(failure))
            }
            Retraction::Failure(failure) => Outcome::Failure(Reason::Tissue(failure)),
        }
    }

    fn missing(&self) -> &'static str {
        "flap not held up at its mark"
    }
}
