//! How far the instrument is from every boundary in space. Hot path: bounded, no allocation, no
//! I/O, no lock.

use hal::psm::SHAFT_RADIUS_M;

use super::way::{Way, lowest};
use crate::config::{ArmConfig, FORBIDDEN_MAX};
use crate::instrument::{Instrument, LINKS};
use crate::region::{Block, Shape};

/// Six faces for the control point and both finger tips.
pub(super) const FACES: usize = 18;

/// The faces, then every link against each region.
pub(super) const CLEARANCES: usize = FACES + LINKS * FORBIDDEN_MAX;

/// A clearance that cannot matter, m.
const FAR_M: f64 = 10.0;

/// One distance for each boundary, m.
pub(super) type Clearances = [f64; CLEARANCES];

/// The box for the control point and the finger tips, and the shapes that no part may enter, in the
/// RCM frame.
#[derive(Clone, Debug)]
pub(super) struct Boundaries {
    workspace: Block,
    shapes: [Option<Shape>; FORBIDDEN_MAX],
}

/// Which clearances are worth looking at.
pub(super) type Wanted = [bool; CLEARANCES];

impl Boundaries {
    pub(super) fn new(arm: &ArmConfig) -> Self {
        let mut shapes = [None; FORBIDDEN_MAX];
        for (slot, region) in shapes.iter_mut().zip(&arm.forbidden) {
            *slot = Some(region.shape);
        }
        Self {
            workspace: arm.workspace,
            shapes,
        }
    }

    /// How far the instrument is from every boundary that is wanted, m; negative beyond it.
    pub(super) fn clearances(&self, instrument: &Instrument, wanted: &Wanted) -> Clearances {
        let mut clearances = [FAR_M; CLEARANCES];
        let (faces, regions) = clearances.split_at_mut(FACES);
        for (slots, point_m) in faces.chunks_exact_mut(6).zip(points(instrument)) {
            slots.copy_from_slice(&self.workspace.clearances_m(point_m));
        }
        let links = instrument.links();
        let slots = regions.chunks_exact_mut(LINKS);
        let wanted = wanted[FACES..].chunks_exact(LINKS);
        for ((slots, wanted), shape) in slots.zip(wanted).zip(&self.shapes) {
            let Some(shape) = shape else { continue };
            for ((slot, wanted), (from_m, to_m)) in slots.iter_mut().zip(wanted).zip(&links) {
                if *wanted {
                    *slot = shape.distance_m(from_m, to_m) - SHAFT_RADIUS_M;
                }
            }
        }
        clearances
    }

    /// What clearance `index` does not fall below between two samples, m.
    ///
    /// `h` is the clearance at both ends, `instruments` is where the links are then, `ways` how
    /// each link can move between them.
    pub(super) fn lowest_between(
        &self,
        index: usize,
        h: (f64, f64),
        instruments: (&Instrument, &Instrument),
        ways: &[Way; LINKS],
        enough_m: f64,
    ) -> f64 {
        let Some(at) = index.checked_sub(FACES) else {
            // The control point ends the wrist, the other two points the fingers.
            let way = &ways[if index < 6 { 1 } else { 2 }];
            return way.lowest_linear(h.0, h.1);
        };
        let way = &ways[at % LINKS];
        let Some(shape) = self.shapes.get(at / LINKS).and_then(Option::as_ref) else {
            return FAR_M;
        };
        match shape {
            Shape::Sphere { radius_m, .. } | Shape::Capsule { radius_m, .. } => {
                way.lowest_round(h.0, h.1, radius_m + SHAFT_RADIUS_M)
            }
            Shape::HalfSpace { .. } => way.lowest_linear(h.0, h.1),
            Shape::Box(block) => {
                let low = way.lowest_round(h.0, h.1, SHAFT_RADIUS_M);
                if low < enough_m {
                    low.max(lowest_beyond_faces(block, at % LINKS, instruments, way))
                } else {
                    low
                }
            }
        }
    }
}

/// What the clearance of a link to a box does not fall below, from each face's plane alone: a box
/// is behind all of them, so it is never nearer than any. This is the better bound for a link that
/// is in the box.
fn lowest_beyond_faces(
    block: &Block,
    link: usize,
    (before, after): (&Instrument, &Instrument),
    way: &Way,
) -> f64 {
    let ((from, to), (then_from, then_to)) = (before.links()[link], after.links()[link]);
    let ends = [(from, then_from), (to, then_to)]
        .map(|(now_m, then_m)| (block.clearances_m(&now_m), block.clearances_m(&then_m)));
    (0..6).fold(f64::NEG_INFINITY, |best, face| {
        let least = ends.iter().fold(f64::INFINITY, |least, (now, then)| {
            let h = (-now[face] - SHAFT_RADIUS_M, -then[face] - SHAFT_RADIUS_M);
            least.min(lowest(h.0, h.1, way.bend_m) - way.kink_m)
        });
        best.max(least)
    })
}

/// The points that stay in the workspace.
fn points(instrument: &Instrument) -> [&nalgebra::Vector3<f64>; 3] {
    let [left, right] = &instrument.fingers_m;
    [&instrument.tip_m, left, right]
}
