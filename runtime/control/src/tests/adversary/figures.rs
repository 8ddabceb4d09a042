//! What an attack came to, in numbers.

use core::fmt;

use super::judge::Nearest;
use crate::{OperatingState, QpOutcome, TickOutput};

/// Figures of all arms together.
#[derive(Debug, Default)]
pub(super) struct Figures {
    pub(super) ticks: u64,
    /// What Clarabel said, where it was asked.
    pub(super) opinions: super::opinions::ReferenceSolutions,
    /// Arm-ticks in which the arm followed.
    pub(super) enabled: u64,
    /// Of these, those in which it stood still.
    pub(super) still: u64,
    /// Arm-ticks in which the guard played its stop.
    pub(super) interventions: u64,
    /// Arm-ticks in which the filter had to solve.
    pub(super) solved: u64,
    /// Arm-ticks in which the filter had no answer.
    pub(super) failed: u64,
    pub(super) faults: u64,
    pub(super) accepted: u64,
    pub(super) refused: u64,
    /// Periods that the controller missed.
    pub(super) missed: u64,
    /// Answers of the filter that were replaced.
    pub(super) garbage: u64,
    /// Ticks whose tails were followed to rest.
    pub(super) tails: u64,
    /// How near the measured arms came to any boundary, mm.
    pub(super) measured_mm: f64,
    /// How near the commands came to the limits.
    pub(super) nearest: Option<Nearest>,
    faulted: [bool; 2],
}

impl Figures {
    /// Takes in a tick.
    pub(super) fn count(&mut self, outputs: &[TickOutput]) {
        self.ticks += 1;
        for (output, faulted) in outputs.iter().zip(&mut self.faulted) {
            let report = &output.report;
            if report.mode.state == OperatingState::Enabled {
                self.enabled += 1;
                self.still += u64::from(!report.mode.busy);
            }
            self.interventions += u64::from(report.guard_intervened);
            match report.qp {
                QpOutcome::NotNeeded => {}
                QpOutcome::Solved { .. } => self.solved += 1,
                QpOutcome::Failed => self.failed += 1,
            }
            let before = core::mem::replace(faulted, report.fault.is_some());
            self.faults += u64::from(report.fault.is_some() && !before);
        }
    }
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "{} ticks: following {}, still {}, solved {}, no answer {}, guard {}, garbage {}, faults {}, missed {}, chunks {} + {} refused, \
             tails {}",
            self.ticks,
            self.enabled,
            self.still,
            self.solved,
            self.failed,
            self.interventions,
            self.garbage,
            self.faults,
            self.missed,
            self.accepted,
            self.refused,
            self.tails,
        )?;
        let Some(nearest) = &self.nearest else {
            return Ok(());
        };
        let ([v, a, j], [speed, turn]) = (nearest.derivatives, nearest.tip);
        write!(
            f,
            " | v {v:.6} a {a:.6} j {j:.6} tip {speed:.6} turn {turn:.6}, range {:.1e}, places {:.4} mm",
            nearest.range, nearest.place_mm
        )?;
        if nearest.between_mm.is_finite() {
            write!(f, ", arms {:.4} mm", nearest.between_mm)?;
        }
        Ok(())
    }
}
