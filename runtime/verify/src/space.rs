//! One arm's boundaries in space: its workspace, and the regions that no part of it may touch.
//!
//! The workspace is for the three points that work, each coordinate by itself; a region is for all
//! four parts along their whole length. The margins of filter and guard do not enter: a command may
//! go up to the boundary.

use super::boundary::{Boundary, Moment};
use super::chain::{Instrument, LINK_NAMES, LINKS, POINT_NAMES};
use super::distance::{Shape, least_gap_m};
use super::ledger::Ledger;
use super::limits::{ArmLimits, Limits};

/// The boundaries of one arm.
#[derive(Clone, Debug)]
pub(super) struct Space {
    /// For each point and axis the least and the greatest coordinate.
    walls: [[[Boundary; 2]; 3]; 3],
    /// For each region the gap between it and each part.
    regions: Vec<(Shape, [Boundary; LINKS])>,
}

impl Space {
    pub(super) fn new(ledger: &mut Ledger, limits: &Limits, arm: &ArmLimits) -> Self {
        let recovery_m = limits.recovery_m;
        let walls = POINT_NAMES.map(|point| {
            [("x", 0), ("y", 1), ("z", 2)].map(|(letter, axis)| {
                let name = |side| format!("workspace.{point}.{letter}_{side}");
                let (low, high) = (arm.box_low_m[axis], arm.box_high_m[axis]);
                [
                    Boundary::at_least(ledger, &arm.name, &name("min"), low, recovery_m),
                    Boundary::at_most(ledger, &arm.name, &name("max"), high, recovery_m),
                ]
            })
        });
        let mut regions = Vec::with_capacity(limits.regions.len());
        for region in &limits.regions {
            let boundaries = LINK_NAMES.map(|link| {
                let name = format!("forbidden.{}.{link}", region.name);
                Boundary::at_least(ledger, &arm.name, &name, 0.0, recovery_m)
            });
            regions.push((region.shape, boundaries));
        }
        Self { walls, regions }
    }

    /// A region costs a search for each part; it ends once the gap is proven to be larger than the
    /// smallest one so far.
    pub(super) fn check(&mut self, ledger: &mut Ledger, moment: Moment, at: &Instrument) {
        for (walls, point) in self.walls.iter_mut().zip(at.points()) {
            for (pair, &value) in walls.iter_mut().zip(point.iter()) {
                for wall in pair {
                    wall.check(ledger, moment, value);
                }
            }
        }
        for (shape, boundaries) in &mut self.regions {
            for (boundary, (start, end)) in boundaries.iter_mut().zip(at.links()) {
                let enough_m = boundary.enough(ledger, moment);
                match least_gap_m(shape, &start, &end, enough_m) {
                    Some(gap_m) => boundary.check(ledger, moment, gap_m),
                    None => boundary.is_clear(moment),
                }
            }
        }
    }

    /// The next command may be outside, and sets how far out later ones may be.
    pub(super) fn forget(&mut self) {
        let walls = self.walls.iter_mut().flatten().flatten();
        let regions = self.regions.iter_mut().flat_map(|(_, each)| each);
        walls.chain(regions).for_each(Boundary::forget);
    }
}
