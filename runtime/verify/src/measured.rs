//! Where the measured arms are: commands keep their distance, and an arm that lags behind its
//! commands may still come too near.
//!
//! Commands keep their distance by the guard's margin; a measured arm may use that margin up, and
//! is judged by the boundary itself. A part can break a limit only once it has been within by the
//! margin since the arm got its torque: an arm that is switched on beyond a boundary breaks nothing
//! by being there.

use hal::ArmState;
use serde::Serialize;

use super::boundary::TOLERANCE;
use super::chain::{Instrument, LINK_NAMES, LINKS, POINT_NAMES};
use super::distance::{Shape, least_gap_m};
use super::ledger::{Ledger, LimitId};
use super::limits::{ArmLimits, Limits};

/// How near a measured instrument came to a boundary while it held torque.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MeasuredClearance {
    /// The arm; both with a `+` between them where the boundary is between two.
    pub arm: String,
    /// The boundary: `workspace`, `forbidden.vessel`, `between_arms`.
    pub boundary: String,
    /// What came nearest: `left_finger_tip.z_min`, `wrist`, `shaft.shaft`.
    pub part: String,
    /// The smallest clearance, m; negative beyond the boundary.
    pub clearance_m: f64,
    /// The tick in which it was smallest.
    pub tick: u64,
    /// Ticks in which it was beyond.
    pub ticks_beyond: u64,
}

/// One boundary with all parts that it is for.
#[derive(Clone, Debug)]
pub(super) struct Nearest {
    arm: String,
    boundary: String,
    /// For the workspace point by point six faces, for a region the links, for a pair the gaps.
    parts: Vec<Part>,
    /// The smallest clearance, m, with its tick and part.
    least: Option<(f64, u64, usize)>,
    ticks_beyond: u64,
}

#[derive(Clone, Debug)]
struct Part {
    name: String,
    limit: LimitId,
    /// Whether it was well within its boundary since the arm got its torque: only then can it be
    /// said to have gone out.
    was_within: bool,
}

impl Nearest {
    pub(super) fn new(
        ledger: &mut Ledger,
        arm: &str,
        boundary: &str,
        parts: impl Iterator<Item = String>,
    ) -> Self {
        let parts = parts.map(|name| Part {
            limit: ledger.open(arm, format!("measured.{boundary}.{name}")),
            name,
            was_within: false,
        });
        Self {
            arm: arm.to_owned(),
            boundary: boundary.to_owned(),
            parts: parts.collect(),
            least: None,
            ticks_beyond: 0,
        }
    }

    /// Takes in one tick; `clearance_m` gives that of a part, or none if it is more than what it is
    /// asked for.
    pub(super) fn tick(
        &mut self,
        ledger: &mut Ledger,
        within_m: f64,
        clearance_m: impl Fn(usize, f64) -> Option<f64>,
    ) {
        let mut beyond = false;
        for (index, part) in self.parts.iter_mut().enumerate() {
            let least_m = self.least.map_or(f64::INFINITY, |(least_m, ..)| least_m);
            let wanted_m = if part.was_within { 0.0 } else { within_m };
            let Some(clearance_m) = clearance_m(index, least_m.max(wanted_m)) else {
                part.was_within = true;
                continue;
            };
            if clearance_m < least_m {
                self.least = Some((clearance_m, ledger.tick, index));
            }
            part.was_within |= clearance_m >= within_m;
            beyond |= clearance_m < -TOLERANCE;
            if part.was_within {
                ledger.judge(part.limit, -clearance_m, TOLERANCE, clearance_m, 0.0);
            }
        }
        self.ticks_beyond += u64::from(beyond);
    }

    /// Says that the arm got its torque, or may have.
    pub(super) fn begin(&mut self) {
        self.parts
            .iter_mut()
            .for_each(|part| part.was_within = false);
    }

    pub(super) fn found(&self) -> Option<MeasuredClearance> {
        let (clearance_m, tick, part) = self.least?;
        Some(MeasuredClearance {
            arm: self.arm.clone(),
            boundary: self.boundary.clone(),
            part: self.parts.get(part)?.name.clone(),
            clearance_m,
            tick,
            ticks_beyond: self.ticks_beyond,
        })
    }
}

/// The boundaries of one measured arm.
#[derive(Clone, Debug)]
pub(super) struct Measured {
    /// The workspace box, scene frame, m.
    low_m: [f64; 3],
    high_m: [f64; 3],
    workspace: Nearest,
    regions: Vec<(Shape, Nearest)>,
    /// From so far on a part is well within a boundary: what stops keep, m.
    within_m: f64,
}

impl Measured {
    pub(super) fn new(ledger: &mut Ledger, limits: &Limits, arm: &ArmLimits) -> Self {
        let sides = ["x_min", "y_min", "z_min", "x_max", "y_max", "z_max"];
        let walls = POINT_NAMES
            .iter()
            .flat_map(|point| sides.map(|side| format!("{point}.{side}")));
        let workspace = Nearest::new(ledger, &arm.name, "workspace", walls);
        let regions = limits.regions.iter().map(|region| {
            let boundary = format!("forbidden.{}", region.name);
            let links = LINK_NAMES.iter().map(|&link| link.to_owned());
            let nearest = Nearest::new(ledger, &arm.name, &boundary, links);
            (region.shape, nearest)
        });
        Self {
            low_m: arm.box_low_m.into(),
            high_m: arm.box_high_m.into(),
            regions: regions.collect(),
            workspace,
            within_m: limits.guard_m,
        }
    }

    /// Takes in where the arm is measured in a tick.
    pub(super) fn tick(&mut self, ledger: &mut Ledger, at: &Instrument) {
        let points = at.points();
        let (low_m, high_m) = (self.low_m, self.high_m);
        self.workspace.tick(ledger, self.within_m, |index, _| {
            let (point, side) = (&points[index / 6], index % 6);
            let axis = side % 3;
            Some(if side < 3 {
                point[axis] - low_m[axis]
            } else {
                high_m[axis] - point[axis]
            })
        });
        let links: [_; LINKS] = at.links();
        for (shape, nearest) in &mut self.regions {
            nearest.tick(ledger, self.within_m, |index, enough_m| {
                let (start, end) = &links[index];
                least_gap_m(shape, start, end, enough_m)
            });
        }
    }

    pub(super) fn begin(&mut self) {
        self.workspace.begin();
        self.regions
            .iter_mut()
            .for_each(|(_, nearest)| nearest.begin());
    }

    pub(super) fn found(&self) -> impl Iterator<Item = MeasuredClearance> + '_ {
        let regions = self.regions.iter().map(|(_, nearest)| nearest);
        core::iter::once(&self.workspace)
            .chain(regions)
            .filter_map(Nearest::found)
    }
}

/// A measurement of where an instrument can be.
///
/// None if it is lost, not finite, or out of the mechanism's range.
pub(super) fn possible<E>(measured: &Result<ArmState, E>) -> Option<&ArmState> {
    let state = measured.as_ref().ok()?;
    (state.is_finite() && state.impossible().is_none()).then_some(state)
}
