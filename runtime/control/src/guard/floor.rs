//! What must be kept from a boundary. Hot path: bounded, no allocation, no I/O, no lock.

use crate::config::Margins;

/// Who is no further beyond a boundary than this has come out: another's arithmetic may have him at either side, m.
const OUT_M: f64 = 5e-7;

/// The rule by which a boundary moves to an arm that was enabled beyond it, and comes back with it.
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

    /// What an arm that has the clearance `h` must keep, m; never more than `h`.
    pub(super) fn below(&self, h: f64) -> f64 {
        // Stops are bounded from below, so a boundary right at the arm would let it move neither on nor back.
        let behind = (h - self.recovery_m).min(self.margin_m);
        if h < 0.0 { behind } else { behind.max(0.0) }
    }

    /// What an arm that was beyond a boundary, and has come back to the clearance `h`, must keep from now on, m: it closes in behind it.
    pub(super) fn behind(&self, h: f64) -> f64 {
        if h > -OUT_M { -OUT_M } else { self.below(h) }
    }

    /// What a stop must keep while the measured arm deviates by `deviation_m`, m: what is `required` in any case, and of margin and
    /// deviation together as much as the stops before it kept, which is `kept`.
    pub(super) fn widened(&self, required: f64, kept: f64, deviation_m: f64) -> f64 {
        required.max(kept.min(self.margin_m + deviation_m))
    }

    /// What stops keep of margin and deviation together once one of them kept `h`, m, after `kept`. An arm whose deviation grew beyond what
    /// it is away comes no nearer than it is, but for what bounds from below need.
    pub(super) fn kept(&self, kept: f64, h: f64, deviation_m: f64) -> f64 {
        let most = self.margin_m + deviation_m;
        kept.max(h - self.recovery_m).min(most)
    }

    /// What an arm keeps that was enabled well within its boundaries, m.
    pub(super) const fn margin_m(&self) -> f64 {
        self.margin_m
    }

    /// How much worse a stop of an arm that was enabled beyond a boundary may get, m.
    pub(super) const fn recovery_m(&self) -> f64 {
        self.recovery_m
    }

    /// A clearance from which on it does not matter what it is, m.
    pub(super) fn enough_m(&self) -> f64 {
        self.margin_m + self.recovery_m
    }
}
