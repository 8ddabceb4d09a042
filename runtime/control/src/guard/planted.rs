//! Faults that a test plants into the guard, one at a time, to see that some test notices.

use super::clearance::CLEARANCES;
use super::gaps::KINDS;
use crate::motion::AXES;

/// A single comparison of the guard.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Check {
    /// An axis's acceleration follows from the last one.
    AccelerationStep(usize),
    /// Its velocity does.
    VelocityStep(usize),
    /// Its position does.
    PositionStep(usize),
    /// An axis's stop stays above its lowest position.
    RangeLow(usize),
    /// It stays below its highest one.
    RangeHigh(usize),
    /// An axis's stop keeps the velocity limit.
    Velocity(usize),
    /// It keeps the acceleration limit.
    Acceleration(usize),
    /// A clearance keeps its floor: six faces for each of three points, then four links for each
    /// region.
    Clearance(usize),
    /// The control point is slow enough.
    TipSpeed,
    /// The tip turns slowly enough.
    AngularSpeed,
    /// Two links of two arms keep their floor.
    Pair(usize),
}

/// What is added for the time between samples, or for a stop that need not be sampled.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Padding {
    /// Of clearances.
    Clearance,
    /// Of the tip's speed.
    TipSpeed,
    /// Of the tip's turning speed.
    AngularSpeed,
    /// Of the clearances that a whole stop can't use up.
    Travel,
    /// Of the distance between two arms.
    Pair,
    /// Of the distance between two arms that two whole stops can't use up.
    PairTravel,
}

/// A fault.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum PlantedGuardFault {
    /// The check always passes.
    Dropped(Check),
    /// The check passes when it should fail, and the other way round.
    Negated(Check),
    /// Nothing is added.
    NoPadding(Padding),
    /// It is added with the wrong sign.
    NegatedPadding(Padding),
    /// Two stops are compared only at equal times.
    EqualTimesOnly,
    /// Two candidates are compared with one another only, and one alone with nothing.
    HeldStopsForgotten,
    /// Every finite candidate passes.
    GuardSkipped,
}

impl PlantedGuardFault {
    /// All of them.
    pub(crate) fn all() -> Vec<Self> {
        let paddings = [
            Padding::Clearance,
            Padding::TipSpeed,
            Padding::AngularSpeed,
            Padding::Travel,
            Padding::Pair,
            Padding::PairTravel,
        ];
        checks()
            .into_iter()
            .flat_map(|check| [Self::Dropped(check), Self::Negated(check)])
            .chain(
                paddings
                    .into_iter()
                    .flat_map(|padding| [Self::NoPadding(padding), Self::NegatedPadding(padding)]),
            )
            .chain([
                Self::EqualTimesOnly,
                Self::HeldStopsForgotten,
                Self::GuardSkipped,
            ])
            .collect()
    }

    /// What becomes of the verdict of a check.
    pub(super) fn judge(self, check: Check, verdict: bool) -> bool {
        if self == Self::Dropped(check) {
            true
        } else if self == Self::Negated(check) {
            !verdict
        } else {
            verdict
        }
    }

    /// What becomes of a bound that is `plain` without its padding.
    pub(super) fn pad(self, padding: Padding, plain: f64, padded: f64) -> f64 {
        if self == Self::NoPadding(padding) {
            plain
        } else if self == Self::NegatedPadding(padding) {
            2.0 * plain - padded
        } else {
            padded
        }
    }
}

fn checks() -> Vec<Check> {
    let axes = (0..AXES).flat_map(|axis| {
        [
            Check::AccelerationStep(axis),
            Check::VelocityStep(axis),
            Check::PositionStep(axis),
            Check::RangeLow(axis),
            Check::RangeHigh(axis),
            Check::Velocity(axis),
            Check::Acceleration(axis),
        ]
    });
    axes.chain((0..CLEARANCES).map(Check::Clearance))
        .chain([Check::TipSpeed, Check::AngularSpeed])
        .chain((0..KINDS.len()).map(Check::Pair))
        .collect()
}
