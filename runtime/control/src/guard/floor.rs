//! The clearance that a stop must keep from a boundary. Hot path: bounded, no allocation, no I/O,
//! no lock.

use crate::config::Margins;

/// An arm no further beyond a boundary than this counts as out of it: the verifier's rounding may
/// put it at either side, m.
const OUT_M: f64 = 5e-7;

/// How a boundary moves to an arm that was enabled beyond it, and returns with the arm.
#[derive(Clone, Copy, Debug)]
pub(super) struct Floor {
    margin_m: f64,
    recovery_m: f64,
}

impl Floor {
    pub(super) const fn new(margins: &Margins) -> Self {
        Self {
            margin_m: margins.guard_m,
            recovery_m: margins.recovery_m,
        }
    }

    /// The clearance that an arm at the clearance `h` must keep, m; never more than `h`.
    pub(super) fn below(&self, h: f64) -> f64 {
        // Stops are bounded from below, so a boundary right at the arm would let it move neither on
        // nor back.
        let behind = (h - self.recovery_m).min(self.margin_m);
        if h < 0.0 { behind } else { behind.max(0.0) }
    }

    /// The clearance that an arm which was beyond a boundary, and has returned to `h`, must keep
    /// from now on, m.
    pub(super) fn behind(&self, h: f64) -> f64 {
        if h > -OUT_M { -OUT_M } else { self.below(h) }
    }

    /// The clearance that a stop must keep while the measured arm deviates by `deviation_m`, m: at
    /// least `required`, and of margin plus deviation as much as the stops before it `kept`.
    pub(super) fn widened(&self, required: f64, kept: f64, deviation_m: f64) -> f64 {
        required.max(kept.min(self.margin_m + deviation_m))
    }

    /// What stops keep of margin plus deviation once one of them kept `h`, m, after `kept`. An arm
    /// whose deviation exceeds its clearance comes no nearer, but for the recovery margin.
    pub(super) fn kept(&self, kept: f64, h: f64, deviation_m: f64) -> f64 {
        let most = self.margin_m + deviation_m;
        kept.max(h - self.recovery_m).min(most)
    }

    /// The clearance of an arm that was enabled within its boundaries, m.
    pub(super) const fn margin_m(&self) -> f64 {
        self.margin_m
    }

    /// How much further beyond a boundary a stop may get after the arm was enabled beyond it, m.
    pub(super) const fn recovery_m(&self) -> f64 {
        self.recovery_m
    }

    /// Larger clearances need not be known exactly, m.
    pub(super) fn enough_m(&self) -> f64 {
        self.margin_m + self.recovery_m
    }
}
