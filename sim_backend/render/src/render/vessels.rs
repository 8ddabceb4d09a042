//! Trees of vessels, as they branch under the serosa: where they run and how wide they are.
//!
//! Trunks come up out of the depth on a scattered lattice. Points that want blood are then served
//! one after the other, the scattered ones first and the dense ones last: each by a branch that
//! leaves the nearest vessel upstream of it. Widths go by Murray's law (1926): the cube of a
//! vessel's radius is the sum of those of its branches. Lengths are mm on the surface, with the
//! middle of the square at the origin.

use hal::random::SplitMix64;

use crate::visual::Pattern;

/// How the vessels of a tissue look.
#[derive(Clone, Copy, Debug)]
pub(super) struct Supply {
    /// Mean distance of the trunks' roots, mm.
    pub(super) roots_mm: f64,
    /// Mean distance of the points that the finest twigs end in, mm.
    pub(super) tips_mm: f64,
    /// Radius of the finest twigs, mm.
    pub(super) tip_radius_mm: f64,
    /// Whether an artery runs beside each vein of some width.
    pub(super) arteries: bool,
}

impl Supply {
    /// That of a pattern, if it has vessels.
    pub(super) const fn of(pattern: Pattern) -> Option<Self> {
        let (roots_mm, tips_mm, tip_radius_mm, arteries) = match pattern {
            Pattern::Muscle => (52.0, 4.2, 0.075, true),
            Pattern::Liver => (70.0, 11.0, 0.060, false),
            Pattern::Fat => (60.0, 7.0, 0.085, true),
            Pattern::Membrane => (44.0, 5.0, 0.070, true),
            Pattern::Smooth | Pattern::Brushed | Pattern::Skin | Pattern::Cloth => return None,
        };
        Some(Self {
            roots_mm,
            tips_mm,
            tip_radius_mm,
            arteries,
        })
    }
}

/// A piece of a vessel between two points.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stretch {
    /// Its ends, mm.
    pub(super) ends_mm: [[f64; 2]; 2],
    /// Its radius, mm: a branch is as wide as itself where it leaves a wider one.
    pub(super) radius_mm: f64,
    /// What share of its colour is seen at them: less where a trunk comes up, nothing where a twig
    /// ends.
    pub(super) shares: [f64; 2],
    /// Whether it is an artery's.
    pub(super) is_artery: bool,
}

type Point = nalgebra::Vector2<f64>;

/// Distance of the points along a vessel, mm.
const STEP_MM: f64 = 0.8;
/// How far vessels are grown beyond the square, mm.
const MARGIN_MM: f64 = 10.0;
/// A branch leaves that many times its length upstream of the nearest point: at some 55 degrees.
const UPSTREAM: f64 = 0.7;
/// A trunk has come up after that length, mm.
const SURFACED_MM: f64 = 9.0;
/// A vein of that radius, mm, has an artery beside it.
const PAIRED_MM: f64 = 0.17;
/// An artery's radius over that of the vein beside it.
const ARTERY: f64 = 0.45;
/// A vessel of that radius, mm, is seen at its full colour.
const FULL_MM: f64 = 0.30;

/// A point of a tree.
struct Node {
    at: Point,
    /// None of a root.
    parent: Option<usize>,
    /// Way from the root, mm.
    way_mm: f64,
    /// How many twigs end beyond it.
    tips: f64,
}

/// All vessels of a square of the side `side_mm`; the same for the same `seed`.
pub(super) fn grown(supply: &Supply, side_mm: f64, seed: u64) -> Vec<Stretch> {
    let mut random = SplitMix64::new(seed);
    let mut trees = Trees::new(side_mm + 2.0 * MARGIN_MM);
    for root in trees.scattered(supply.roots_mm, &mut random) {
        trees.push(root, None);
    }
    let mut apart_mm = 0.5 * supply.roots_mm;
    loop {
        let mut thirsty = trees.scattered(apart_mm.max(supply.tips_mm), &mut random);
        random.shuffle(&mut thirsty);
        for at in thirsty {
            trees.serve(at, &mut random);
        }
        if apart_mm <= supply.tips_mm {
            break;
        }
        apart_mm *= 0.55;
    }
    trees.count_tips();
    trees.wind(&mut random);
    trees.stretches(supply)
}

/// Trees under way, with a grid of cells to find the nearest point in.
struct Trees {
    nodes: Vec<Node>,
    side_mm: f64,
    /// Cells along a side.
    across: usize,
    cells: Vec<Vec<usize>>,
}

/// Side of a cell, mm.
const CELL_MM: f64 = 4.0;

impl Trees {
    fn new(side_mm: f64) -> Self {
        let across = whole(side_mm / CELL_MM) + 1;
        Self {
            nodes: Vec::new(),
            side_mm,
            across,
            cells: vec![Vec::new(); across * across],
        }
    }

    /// A point in each square of the side `apart_mm`.
    fn scattered(&self, apart_mm: f64, random: &mut SplitMix64) -> Vec<Point> {
        let count = whole(self.side_mm / apart_mm).max(1);
        let apart_mm = self.side_mm / real(count);
        let mut points = Vec::with_capacity(count * count);
        for row in 0..count {
            for column in 0..count {
                let cell = Point::new(real(column), real(row));
                let within = Point::new(random.between(0.1, 0.9), random.between(0.1, 0.9));
                points.push((cell + within) * apart_mm - Point::repeat(0.5 * self.side_mm));
            }
        }
        points
    }

    /// Column and row of the cell that `at` is in.
    fn cell(&self, at: &Point) -> [usize; 2] {
        [at.x, at.y].map(|along| {
            let cells = (along + 0.5 * self.side_mm) / CELL_MM;
            whole(cells.max(0.0)).min(self.across - 1)
        })
    }

    fn push(&mut self, at: Point, parent: Option<usize>) -> usize {
        let way_mm = parent.map_or(0.0, |parent| {
            let parent = &self.nodes[parent];
            parent.way_mm + (at - parent.at).norm()
        });
        let index = self.nodes.len();
        let [column, row] = self.cell(&at);
        self.cells[row * self.across + column].push(index);
        self.nodes.push(Node {
            at,
            parent,
            way_mm,
            tips: 0.0,
        });
        index
    }

    /// The point of a tree that is nearest to `at`: in rings of cells, until none can be nearer.
    fn nearest(&self, at: &Point) -> Option<usize> {
        let [column, row] = self.cell(at);
        let mut best: Option<(f64, usize)> = None;
        for ring in 0..self.across {
            if best.is_some_and(|(d, _)| d <= (real(ring) - 1.0).max(0.0) * CELL_MM) {
                break;
            }
            let rows = row.saturating_sub(ring)..=(row + ring).min(self.across - 1);
            for y in rows {
                let columns = column.saturating_sub(ring)..=(column + ring).min(self.across - 1);
                let on_ring = |x: &usize| y.abs_diff(row) == ring || x.abs_diff(column) == ring;
                for x in columns.filter(on_ring) {
                    for &index in &self.cells[y * self.across + x] {
                        let distance = (self.nodes[index].at - at).norm();
                        if best.is_none_or(|(d, _)| distance < d) {
                            best = Some((distance, index));
                        }
                    }
                }
            }
        }
        best.map(|(_, index)| index)
    }

    /// Grows a branch to `at`, a little curved: it begins in the direction of the vessel that it
    /// leaves.
    fn serve(&mut self, at: Point, random: &mut SplitMix64) {
        let Some(mut from) = self.nearest(&at) else {
            return;
        };
        let distance_mm = (self.nodes[from].at - at).norm();
        if distance_mm < STEP_MM {
            return;
        }
        let upstream_mm = self.nodes[from].way_mm - UPSTREAM * distance_mm;
        while let Some(parent) = self.nodes[from].parent
            && self.nodes[from].way_mm > upstream_mm
        {
            from = parent;
        }
        let start = self.nodes[from].at;
        let across = at - start;
        let before = self.nodes[from].parent;
        let ahead = before
            .and_then(|parent| (start - self.nodes[parent].at).try_normalize(1e-9))
            .unwrap_or_else(|| 0.5 * Point::new(random.signed_unit(), random.signed_unit()));
        let bend = start + 0.30 * across + 0.28 * across.norm() * ahead;
        let count = whole(across.norm() / STEP_MM).max(1);
        for step in 1..=count {
            let t = real(step) / real(count);
            let s = 1.0 - t;
            let point = s * s * start + 2.0 * s * t * bend + t * t * at;
            from = self.push(point, Some(from));
        }
    }

    /// How many twigs end beyond each point; children come after their parents.
    fn count_tips(&mut self) {
        for index in (0..self.nodes.len()).rev() {
            let tips = self.nodes[index].tips.max(1.0);
            self.nodes[index].tips = tips;
            if let Some(parent) = self.nodes[index].parent {
                self.nodes[parent].tips += tips;
            }
        }
    }

    /// Bends the plane, and all vessels in it: they wind.
    fn wind(&mut self, random: &mut SplitMix64) {
        let waves: [Wave; 9] = core::array::from_fn(|index| {
            let (length_mm, by_mm) = [(23.0, 1.3), (9.0, 0.55), (4.2, 0.26)][index / 3];
            Wave::new(length_mm * random.between(0.8, 1.25), by_mm, random)
        });
        for node in &mut self.nodes {
            let by = waves.iter().map(|wave| wave.by(&node.at)).sum::<Point>();
            node.at += by;
        }
    }

    /// What share of a vessel's colour is seen at `node`, whose radius is `radius_mm`.
    fn share(node: &Node, radius_mm: f64) -> f64 {
        let surfaced = (node.way_mm / SURFACED_MM).clamp(0.0, 1.0);
        surfaced * (radius_mm / FULL_MM).clamp(0.3, 1.0)
    }

    /// Veins first, then the arteries beside them.
    fn stretches(&self, supply: &Supply) -> Vec<Stretch> {
        let width_mm = |node: &Node| supply.tip_radius_mm * node.tips.cbrt();
        let mut ends = vec![true; self.nodes.len()];
        for parent in self.nodes.iter().filter_map(|node| node.parent) {
            ends[parent] = false;
        }
        let mut veins = Vec::new();
        let mut arteries = Vec::new();
        for (node, is_end) in self.nodes.iter().zip(ends) {
            let Some(parent) = node.parent.map(|parent| &self.nodes[parent]) else {
                continue;
            };
            let radius_mm = width_mm(node);
            let last = if is_end { 0.0 } else { 1.0 };
            let shares = [
                Self::share(parent, radius_mm),
                last * Self::share(node, radius_mm),
            ];
            veins.push(Stretch {
                ends_mm: [parent.at.into(), node.at.into()],
                radius_mm,
                shares,
                is_artery: false,
            });
            if supply.arteries && radius_mm > PAIRED_MM {
                arteries.push(Stretch {
                    ends_mm: [parent, node].map(|end| self.beside(end, width_mm(end)).into()),
                    radius_mm: ARTERY * radius_mm,
                    shares,
                    is_artery: true,
                });
            }
        }
        veins.append(&mut arteries);
        veins
    }

    /// Where the artery beside `node` is; it winds about the vein, at times across it.
    fn beside(&self, node: &Node, radius_mm: f64) -> Point {
        let ahead = node
            .parent
            .and_then(|parent| (node.at - self.nodes[parent].at).try_normalize(1e-9))
            .unwrap_or_else(Point::x);
        let winding = (0.23 * node.way_mm).sin() + 0.5 * (0.61 * node.way_mm).sin();
        let aside_mm = (2.0 * radius_mm + 0.35) * (0.75 + 0.35 * winding);
        node.at + aside_mm * Point::new(-ahead.y, ahead.x)
    }
}

/// Moves points by a sine of the place.
struct Wave {
    /// Radians per mm.
    along: Point,
    phase: f64,
    by_mm: Point,
}

impl Wave {
    fn new(length_mm: f64, by_mm: f64, random: &mut SplitMix64) -> Self {
        let mut direction = || {
            let wished = Point::new(random.normal(), random.normal());
            wished.try_normalize(1e-9).unwrap_or_else(Point::x)
        };
        let along = core::f64::consts::TAU / length_mm * direction();
        let by_mm = by_mm * direction();
        Self {
            along,
            phase: random.between(0.0, core::f64::consts::TAU),
            by_mm,
        }
    }

    fn by(&self, at: &Point) -> Point {
        (self.along.dot(at) + self.phase).sin() * self.by_mm
    }
}

/// Whole numbers below `value`, which is not negative and small.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "counts of cells of a square"
)]
fn whole(value: f64) -> usize {
    value as usize
}

#[expect(clippy::cast_precision_loss, reason = "counts of cells of a square")]
fn real(count: usize) -> f64 {
    count as f64
}

#[cfg(test)]
mod tests {
    use super::{Stretch, Supply, grown};

    const SUPPLY: Supply = Supply {
        roots_mm: 55.0,
        tips_mm: 5.0,
        tip_radius_mm: 0.08,
        arteries: false,
    };

    fn veins() -> Vec<Stretch> {
        grown(&SUPPLY, 180.0, 3)
    }

    #[test]
    fn every_place_has_a_vessel_near() {
        let veins = veins();
        for row in -17..=17 {
            for column in -17..=17 {
                let at = [5.0 * f64::from(column), 5.0 * f64::from(row)];
                let near = veins.iter().any(|vein| {
                    let [x, y] = vein.ends_mm[1];
                    (x - at[0]).hypot(y - at[1]) < 2.0 * SUPPLY.tips_mm
                });
                assert!(near, "nothing at {at:?}");
            }
        }
    }

    /// Murray's law: the cubes of the radii beyond a branching add up to the one before it.
    #[test]
    fn cubes_of_the_radii_of_branches_add_up() {
        let bits = |end: [f64; 2]| end.map(f64::to_bits);
        let veins = veins();
        let mut branchings = 0;
        for vein in veins.iter().filter(|vein| vein.radius_mm > 0.2) {
            let beyond = veins
                .iter()
                .filter(|other| bits(other.ends_mm[0]) == bits(vein.ends_mm[1]));
            let radii: Vec<f64> = beyond.map(|branch| branch.radius_mm).collect();
            if radii.len() > 1 {
                branchings += 1;
                let cubes: f64 = radii.iter().map(|radius| radius.powi(3)).sum();
                let cube = vein.radius_mm.powi(3);
                assert!((cube - cubes).abs() < 1e-9 * cube, "{cube} {cubes}");
            }
        }
        assert!(branchings > 20, "{branchings} branchings");
    }

    #[test]
    fn no_vessel_comes_back_to_itself() {
        let mut ends: Vec<[u64; 2]> = veins()
            .iter()
            .map(|vein| vein.ends_mm[1].map(f64::to_bits))
            .collect();
        let count = ends.len();
        ends.sort_unstable();
        ends.dedup();
        assert_eq!(ends.len(), count, "a point is reached by two vessels");
    }

    #[test]
    fn the_same_seed_grows_the_same_trees_and_another_seed_others() {
        assert_eq!(veins(), veins());
        assert_ne!(veins(), grown(&SUPPLY, 180.0, 4));
    }
}
