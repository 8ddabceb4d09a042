//! How near the measured instruments came to their boundaries. Hot path: bounded, no allocation, no
//! I/O, no lock.
//!
//! The guard decides nothing by these figures: they are for the end of a run. `allowances`, which
//! the guard does use, is here since both go through the same parts.

use hal::ArmState;
use serde::Serialize;

use super::clearance::{Boundaries, CLEARANCES, Clearances, FACES};
use super::gaps::{Gaps, KINDS};
use crate::config::{ControlConfig, FORBIDDEN_MAX};
use crate::instrument::{KinematicState, LINKS, Link};
use crate::motion::MotionState;
use crate::snapshot::{Reader, Snapshot, SnapshotError, Words, possible, words};

/// The workspace, then each region.
const BOUNDARIES: usize = 1 + FORBIDDEN_MAX;

/// Names of the points that stay in the workspace, and of its faces.
const POINTS: [&str; 3] = ["control_point", "left_finger_tip", "right_finger_tip"];
/// In the order of `Block::clearances_m`.
const SIDES: [&str; 6] = ["x_min", "y_min", "z_min", "x_max", "y_max", "z_max"];

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
    /// Ticks in which it was beyond.
    pub ticks_beyond: u64,
}

/// The smallest clearance of one boundary.
#[derive(Clone, Copy, Debug)]
pub(super) struct Nearest {
    /// Infinite before the first tick with torque.
    clearance_m: f64,
    /// Index among the boundary's parts: of the workspace `6 * point + side`, of a region the link,
    /// of a pair the place in `KINDS`.
    part: usize,
    ticks_beyond: u64,
}

words!(Nearest {
    clearance_m: f64,
    part: usize,
    ticks_beyond: u64,
});

impl Nearest {
    /// Whether it is of one of so many `parts`.
    pub(super) const fn is_of(&self, parts: usize) -> bool {
        self.part < parts
    }

    pub(super) const NEVER: Self = Self {
        clearance_m: f64::INFINITY,
        part: 0,
        ticks_beyond: 0,
    };

    /// Takes in one tick.
    pub(super) fn add(&mut self, clearances_m: &[f64]) {
        let mut beyond = false;
        for (part, &clearance_m) in clearances_m.iter().enumerate() {
            beyond |= clearance_m < 0.0;
            if clearance_m < self.clearance_m {
                self.clearance_m = clearance_m;
                self.part = part;
            }
        }
        self.ticks_beyond += u64::from(beyond);
    }

    fn named(&self, arm: String, boundary: String, part: String) -> Option<MeasuredClearance> {
        self.clearance_m.is_finite().then_some(MeasuredClearance {
            arm,
            boundary,
            part,
            clearance_m: self.clearance_m,
            ticks_beyond: self.ticks_beyond,
        })
    }

    /// Of two arms, as [`MeasuredClearance`].
    pub(super) fn between(&self, config: &ControlConfig) -> Option<MeasuredClearance> {
        let (first, second) = KINDS[self.part];
        let names: Vec<&str> = config.arms.iter().map(|arm| arm.name.as_str()).collect();
        let part = |link: usize| Link::ALL[link].name();
        self.named(
            names.join("+"),
            "between_arms".to_owned(),
            format!("{}.{}", part(first), part(second)),
        )
    }
}

/// The smallest clearances of one arm.
#[derive(Clone, Copy, Debug)]
pub(super) struct NearestOfArm([Nearest; BOUNDARIES]);

impl Words for NearestOfArm {
    const LAYOUT: u64 = <[Nearest; BOUNDARIES] as Words>::LAYOUT;
    const WORDS_MAX: usize = <[Nearest; BOUNDARIES] as Words>::WORDS_MAX;

    fn put(&self, to: &mut Snapshot) {
        let Self(all) = self;
        all.put(to);
    }

    fn take(from: &mut Reader<'_>) -> Result<Self, SnapshotError> {
        let all: [Nearest; BOUNDARIES] = Words::take(from)?;
        let [workspace, regions @ ..] = &all;
        possible(workspace.is_of(FACES) && regions.iter().all(|region| region.is_of(LINKS)))?;
        Ok(Self(all))
    }
}

impl NearestOfArm {
    pub(super) const fn new() -> Self {
        Self([Nearest::NEVER; BOUNDARIES])
    }

    /// Takes in one tick.
    pub(super) fn add(&mut self, clearances: &Clearances) {
        let (faces, regions) = clearances.split_at(FACES);
        let all = core::iter::once(faces).chain(regions.chunks_exact(LINKS));
        for (nearest, clearances) in self.0.iter_mut().zip(all) {
            nearest.add(clearances);
        }
    }

    /// The workspace and each region of the arm at `index`; nothing of an arm that never held
    /// torque.
    pub(super) fn named(&self, config: &ControlConfig, index: usize) -> Vec<MeasuredClearance> {
        let arm = &config.arms[index];
        let [workspace, regions @ ..] = &self.0;
        let point = POINTS[workspace.part / SIDES.len()];
        let side = SIDES[workspace.part % SIDES.len()];
        let part = format!("{point}.{side}");
        let workspace = workspace.named(arm.name.clone(), "workspace".to_owned(), part);
        let regions = regions
            .iter()
            .zip(&arm.forbidden)
            .filter_map(|(nearest, region)| {
                let link = Link::ALL[nearest.part].name();
                let boundary = format!("forbidden.{}", region.name);
                nearest.named(arm.name.clone(), boundary, link.to_owned())
            });
        workspace.into_iter().chain(regions).collect()
    }
}

/// The boundaries in space that arms measured at `states` are beyond, each with what is furthest
/// beyond it. Allocates.
#[must_use]
pub fn beyond(config: &ControlConfig, states: &[ArmState]) -> Vec<MeasuredClearance> {
    let arms = config.arms.iter().zip(states).enumerate();
    let all = arms.flat_map(|(index, (arm, state))| {
        let stance = KinematicState::new(&MotionState::at_rest(state));
        let boundaries = Boundaries::new(arm);
        let mut nearest = NearestOfArm::new();
        nearest.add(&boundaries.clearances(&stance.instrument, &[true; CLEARANCES]));
        nearest.named(config, index)
    });
    all.filter(|nearest| nearest.clearance_m < 0.0).collect()
}

/// What the guard keeps beyond its margin for a deviation of each clearance's part, m.
pub(super) fn allowances(deviation: &super::Deviation) -> Clearances {
    let points_m = [
        deviation.tip_m,
        deviation.fingers_m[0],
        deviation.fingers_m[1],
    ];
    let mut allowances = [0.0; CLEARANCES];
    for (index, allowance) in allowances.iter_mut().enumerate() {
        *allowance = match index.checked_sub(FACES) {
            None => points_m[index / SIDES.len()],
            Some(at) => deviation.links_m[at % LINKS],
        };
    }
    allowances
}

/// The same for the gaps between two arms.
pub(super) fn gap_allowances(first: &super::Deviation, second: &super::Deviation) -> Gaps {
    KINDS.map(|(of_first, of_second)| first.links_m[of_first] + second.links_m[of_second])
}
