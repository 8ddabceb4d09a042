//! The flap's own monitor as a judge of the task.
//!
//! What counts and what is lost is decided in `trocar_world::tissue`; here its states become
//! outcomes, faults of the simulation the invalid ones, and its numbers criteria. No `Safeguard` is
//! needed: the flap's monitor has its own limits of force, stretch and speed.

use trocar_world::tissue::{Retraction, RetractionConfig, RetractionMonitor};

use crate::task::{Criteria, Monitor, MonitorInput, Outcome, Reason};

/// Watches the flap.
pub(super) struct SuccessMonitor {
    config: RetractionConfig,
    flap: RetractionMonitor,
}

impl SuccessMonitor {
    /// A monitor at the start of an episode.
    pub(super) fn new(config: &RetractionConfig) -> Self {
        Self {
            config: config.clone(),
            flap: RetractionMonitor::new(config),
        }
    }
}

impl Monitor for SuccessMonitor {
    fn observe(&mut self, sight: &MonitorInput) -> Outcome {
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

    fn criteria(&self, sight: &MonitorInput) -> Criteria {
        let Some(report) = &sight.tissue else {
            return Criteria::default();
        };
        let config = &self.config;
        let beside_m = report
            .grasp
            .map_or(f64::INFINITY, |grasp| grasp.beside_mark_m);
        // A sum of milliseconds.
        let held_s = (self.flap.held_s() * 1e3).round() / 1e3;
        Criteria::default()
            .so("flap in a jaw", report.grasp.is_some())
            .at_most("from the mark", "m", beside_m, config.mark_distance_m)
            .at_least(
                "mark above where it lay",
                "m",
                report.mark_rise_m,
                config.lift_height_m,
            )
            .at_least("for so long", "s", held_s, config.hold_s)
    }
}
