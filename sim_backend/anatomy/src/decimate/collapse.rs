//! One edge: where its vertices would go, whether that is allowed, and doing it.
//!
//! The rules, in the order in which they are asked, the cheap ones first: link condition, no two
//! triangles with the same corners, shapes, samples within the bound, no crossing. A refused trial
//! changes nothing.

use nalgebra::Point3;

use super::quadric::Quadric;
use super::state::{Kind, NONE, State, normal};
use crate::geometry::{cross, distance_squared};

/// Cosine of the most that a triangle may turn in one collapse: 60 degrees.
const TURN_MIN: f64 = 0.5;

/// Least height of a triangle to its longest side, unless it was worse before.
///
/// An equilateral triangle has 0.87.
const SHAPE_MIN: f64 = 0.08;

/// A collapse that is being looked at: `goes` becomes `stays`, at `place`.
struct Trial {
    /// The vertex that is gone afterwards.
    goes: u32,
    /// The vertex that is left; of the two the one that is held more.
    stays: u32,
    /// Where it goes, mm.
    place: Point3<f64>,
    /// Triangles at the edge, which vanish: two on a sheet, on a line as many as sheets meet there.
    vanish: Vec<u32>,
    /// Triangles that change, with their corners after it: all around both vertices but those that
    /// vanish.
    change: Vec<(u32, [Point3<f64>; 3])>,
}

/// Height over the longest side, to that side.
fn shape(corners: &[Point3<f64>; 3]) -> f64 {
    let [a, b, c] = corners;
    let longest = (b - a)
        .norm_squared()
        .max((c - b).norm_squared())
        .max((a - c).norm_squared());
    normal(corners).1 / longest
}

impl State {
    /// Where `u` and `v` may come together, if what holds them lets them; `bits` are the groups
    /// around their edge.
    ///
    /// Between two sheet vertices the least of the summed quadrics, if it is within an edge's
    /// length of the middle, else the best of both ends and the middle: in near-flat regions the
    /// least is ill-conditioned and may be far away. Between two vertices of a line an end or the
    /// middle, and only if the edge itself is on a line; a chord between two lines never collapses.
    /// A vertex at the rim of a part stays and takes nothing in, for the other part would not know.
    pub(super) fn place(&self, u: u32, v: u32, bits: u32) -> Option<Point3<f64>> {
        let [a, b] = [u, v].map(|v| self.positions[v as usize]);
        let on_line = bits.count_ones() > 2;
        match (self.kinds[u as usize], self.kinds[v as usize]) {
            (Kind::Fixed, Kind::Fixed) => None,
            (Kind::Fixed, Kind::Sheet) => (!self.is_locked(u)).then_some(a),
            (Kind::Sheet, Kind::Fixed) => (!self.is_locked(v)).then_some(b),
            (Kind::Line, Kind::Sheet) => Some(a),
            (Kind::Sheet, Kind::Line) => Some(b),
            (Kind::Fixed, Kind::Line) => (on_line && !self.is_locked(u)).then_some(a),
            (Kind::Line, Kind::Fixed) => (on_line && !self.is_locked(v)).then_some(b),
            (Kind::Line, Kind::Line) => {
                on_line.then(|| self.best(u, v, &[a, b, a + (b - a) * 0.5]))
            }
            (Kind::Sheet, Kind::Sheet) => {
                let middle = a + (b - a) * 0.5;
                let sum = self.sum(u, v);
                let near = |p: &Point3<f64>| (p - middle).norm_squared() <= (b - a).norm_squared();
                let free = sum.least(&middle).filter(near);
                Some(free.unwrap_or_else(|| self.best(u, v, &[a, b, middle])))
            }
        }
    }

    fn sum(&self, u: u32, v: u32) -> Quadric {
        let mut sum = self.quadrics[u as usize];
        sum.add(&self.quadrics[v as usize]);
        sum
    }

    /// The cheapest of `places`; the last, which is the middle, where none is cheaper than it.
    fn best(&self, u: u32, v: u32, places: &[Point3<f64>; 3]) -> Point3<f64> {
        let sum = self.sum(u, v);
        let cheaper = |a: Point3<f64>, b: &Point3<f64>| if sum.at(b) < sum.at(&a) { *b } else { a };
        places.iter().fold(places[2], cheaper)
    }

    /// Collapses the edge from `u` to `v` if every rule holds; the vertex that stays.
    pub(super) fn collapse(&mut self, u: u32, v: u32, error_mm: f64) -> Option<u32> {
        // The one that is held more stays.
        let rank = |v: u32| match self.kinds[v as usize] {
            Kind::Sheet => 0,
            Kind::Line => 1,
            Kind::Fixed => 2,
        };
        let (goes, stays) = if rank(u) > rank(v) { (v, u) } else { (u, v) };
        let trial = self.trial(goes, stays)?;
        let allowed =
            self.links_allow(&trial) && self.no_two_alike(&trial) && self.shapes_allow(&trial);
        let moves = if allowed {
            self.samples_allow(&trial, error_mm)?
        } else {
            return None;
        };
        if !self.crosses_nothing(&trial) {
            return None;
        }
        self.execute(&trial, &moves);
        Some(stays)
    }

    /// None if the kinds of the vertices forbid it.
    fn trial(&self, goes: u32, stays: u32) -> Option<Trial> {
        let star = |v: u32| self.around[v as usize].iter().copied();
        let vanish: Vec<u32> = star(goes)
            .filter(|t| self.triangles[*t as usize].contains(&stays))
            .collect();
        let bits = vanish.iter().fold(0, |bits, t| bits | self.side_bits(*t));
        let place = self.place(goes.min(stays), goes.max(stays), bits)?;
        let changed = star(goes)
            .chain(star(stays))
            .filter(|t| !vanish.contains(t));
        let after = |t: u32| {
            self.triangles[t as usize].map(|v| {
                if v == goes || v == stays {
                    place
                } else {
                    self.positions[v as usize]
                }
            })
        };
        let change = changed.map(|t| (t, after(t))).collect();
        Some(Trial {
            goes,
            stays,
            place,
            vanish,
            change,
        })
    }

    /// Neighbours of `v` on the surface of each group, as (group, neighbour).
    fn neighbours(&self, v: u32) -> Vec<(u8, u32)> {
        let mut all = Vec::with_capacity(4 * self.around[v as usize].len());
        for &t in &self.around[v as usize] {
            let others = self.triangles[t as usize].into_iter().filter(|w| *w != v);
            all.extend(others.flat_map(|w| self.sides[t as usize].map(|side| (side, w))));
        }
        all.sort_unstable();
        all.dedup();
        all
    }

    /// The link condition on the surface of every group that both vertices touch: they have two
    /// triangles in common there, and no neighbours besides these triangles' corners.
    ///
    /// The condition is that of T. Dey, H. Edelsbrunner, S. Guha and D. Nekhayev, "Topology
    /// preserving edge contraction" (1999), for a closed 2-manifold: with it each group's surface
    /// keeps its topology.
    fn links_allow(&self, trial: &Trial) -> bool {
        let opposite = |t: &u32| {
            let corners = self.triangles[*t as usize];
            let third = corners
                .into_iter()
                .find(|v| *v != trial.goes && *v != trial.stays);
            third.map(|third| self.sides[*t as usize].map(|side| (side, third)))
        };
        let mut expected: Vec<(u8, u32)> =
            trial.vanish.iter().filter_map(opposite).flatten().collect();
        expected.sort_unstable();
        let both = self.groups[trial.goes as usize] & self.groups[trial.stays as usize];
        let of_group = |group: u8| expected.iter().filter(|(side, _)| *side == group).count();
        if (0..32).any(|group| both >> group & 1 == 1 && of_group(group) != 2) {
            return false;
        }
        let (a, b) = (self.neighbours(trial.goes), self.neighbours(trial.stays));
        let common = a.into_iter().filter(|entry| b.binary_search(entry).is_ok());
        common.eq(expected)
    }

    /// Whether the triangles that are left differ in their corners.
    fn no_two_alike(&self, trial: &Trial) -> bool {
        let is_end = |v: u32| v == trial.goes || v == trial.stays;
        let mut pairs: Vec<[u32; 2]> = trial
            .change
            .iter()
            .map(|(t, _)| {
                let mut others = self.triangles[*t as usize]
                    .into_iter()
                    .filter(|v| !is_end(*v));
                let pair = [others.next().unwrap_or(NONE), others.next().unwrap_or(NONE)];
                [pair[0].min(pair[1]), pair[0].max(pair[1])]
            })
            .collect();
        pairs.sort_unstable();
        pairs.windows(2).all(|pair| pair[0] != pair[1])
    }

    /// Whether no triangle turns over or becomes a sliver.
    fn shapes_allow(&self, trial: &Trial) -> bool {
        trial.change.iter().all(|(t, after)| {
            let before = self.corners(*t);
            let turn = normal(&before).0.dot(&normal(after).0);
            let had_area = normal(&before).1 > 1e-9;
            (turn > TURN_MIN || !had_area) && shape(after) > SHAPE_MIN.min(0.5 * shape(&before))
        })
    }

    /// Where each sample of the triangles goes, if all stay within the bound.
    ///
    /// Only triangles of the trial between the same two groups are looked at, so a sample that
    /// another triangle is nearer to may refuse a collapse; never the reverse.
    fn samples_allow(&self, trial: &Trial, error_mm: f64) -> Option<Vec<(u32, u32)>> {
        let bound = error_mm * error_mm;
        let mut moves = Vec::new();
        let changed = trial.change.iter().map(|(t, _)| t);
        for from in trial.vanish.iter().chain(changed) {
            let sides = self.sides[*from as usize];
            let mut sample = self.first[*from as usize];
            while sample != NONE {
                let p = &self.samples[sample as usize];
                let mut best = (f64::INFINITY, NONE);
                for (t, after) in &trial.change {
                    let other = self.sides[*t as usize];
                    if other == sides || other == [sides[1], sides[0]] {
                        let distance = distance_squared(p, after);
                        if distance < best.0 {
                            best = (distance, *t);
                        }
                    }
                }
                if best.0 > bound {
                    return None;
                }
                moves.push((sample, best.1));
                sample = self.next[sample as usize];
            }
        }
        Some(moves)
    }

    /// Whether the changed triangles cross neither others nor each other.
    ///
    /// The costliest rule, so the last. Corners are renamed first, so that triangles that will
    /// share the vertex are known to. Where groups have surfaces of their own only those of the
    /// same group count.
    fn crosses_nothing(&self, trial: &Trial) -> bool {
        let points: Vec<_> = trial.change.iter().flat_map(|(_, after)| *after).collect();
        let sides = trial.change.first().map(|(t, _)| self.sides[*t as usize]);
        let counts = |t: &u32| {
            let is_own = !self.apart || Some(self.sides[*t as usize]) == sides;
            is_own && self.alive[*t as usize] && !trial.vanish.contains(t)
        };
        let renamed = |t: u32| {
            self.triangles[t as usize].map(|v| if v == trial.goes { trial.stays } else { v })
        };
        let others: Vec<u32> = self
            .cells
            .near(&points)
            .into_iter()
            .filter(counts)
            .collect();
        let changed = |t: &u32| trial.change.iter().find(|(changed, _)| changed == t);
        let place = |t: &u32| changed(t).map_or_else(|| self.corners(*t), |(_, after)| *after);
        let others: Vec<_> = others.iter().map(|t| (renamed(*t), place(t))).collect();
        trial.change.iter().all(|(t, after)| {
            let numbers = renamed(*t);
            let crossed = |(other, at): &([u32; 3], _)| cross((&numbers, after), (other, at));
            !others.iter().any(crossed)
        })
    }

    /// Carries the trial out: cells, corners, quadrics, groups and samples.
    fn execute(&mut self, trial: &Trial, moves: &[(u32, u32)]) {
        let (goes, stays) = (trial.goes as usize, trial.stays as usize);
        for (t, after) in &trial.change {
            let before = self.corners(*t);
            self.cells.change(*t, &before, after, &self.alive);
        }
        self.positions[stays] = trial.place;
        self.quadrics[stays] = self.sum(trial.goes, trial.stays);
        self.groups[stays] |= self.groups[goes];
        for &t in &trial.vanish {
            self.alive[t as usize] = false;
            self.first[t as usize] = NONE;
            for v in self.triangles[t as usize] {
                self.around[v as usize].retain(|other| *other != t);
            }
        }
        for t in std::mem::take(&mut self.around[goes]) {
            for v in &mut self.triangles[t as usize] {
                if *v == trial.goes {
                    *v = trial.stays;
                }
            }
            self.around[stays].push(t);
        }
        for (t, _) in &trial.change {
            self.first[*t as usize] = NONE;
        }
        for &(sample, t) in moves {
            self.next[sample as usize] = self.first[t as usize];
            self.first[t as usize] = sample;
        }
    }
}
