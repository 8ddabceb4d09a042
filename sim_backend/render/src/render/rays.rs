//! Rays against triangles, to bake with: a tree of boxes.
//!
//! A bounding volume hierarchy, split at the median along the longest side of the box: not the best
//! tree, but always balanced and always the same. In single precision; it is for shading alone.
//! Physics has its own queries.

use hal::Mesh;
use hal::count::count_u32;
use nalgebra::Vector3;

type Vec3 = Vector3<f32>;

/// Most triangles of a box that is not split.
const LEAF: usize = 4;

/// Triangles in boxes in boxes.
pub(super) struct Rays {
    /// In preorder, the root first. Never empty: of no triangle there is one leaf without any.
    nodes: Vec<Node>,
    /// Those of a leaf stand together.
    triangles: Vec<Triangle>,
}

/// A corner, and the two sides from there.
#[derive(Clone, Copy)]
struct Triangle {
    corner: Vec3,
    sides: [Vec3; 2],
}

/// A box with its triangles, or two boxes: the next one in the list, and `second`.
struct Node {
    /// The lower corner of its box.
    low: Vec3,
    /// The upper corner of its box.
    high: Vec3,
    /// Of a leaf, its first triangle.
    first: u32,
    /// Of a leaf, how many there are.
    count: u32,
    /// Place of the second box; 0 of a leaf, since the root is no node's second.
    second: u32,
}

impl Triangle {
    /// What triangles are sorted by.
    fn middle(&self) -> Vec3 {
        self.corner + (self.sides[0] + self.sides[1]) / 3.0
    }

    fn corners(&self) -> [Vec3; 3] {
        let [first, second] = self.sides;
        [self.corner, self.corner + first, self.corner + second]
    }

    /// Where a ray meets it, from either side; Möller and Trumbore.
    ///
    /// T. Möller and B. Trumbore (1997). The distance may be negative, behind the start.
    fn hit(&self, from: &Vec3, along: &Vec3) -> Option<f32> {
        let [first, second] = self.sides;
        let across = along.cross(&second);
        let size = first.dot(&across);
        // Along it, or it has no area.
        if size.abs() < 1e-20 {
            return None;
        }
        let to = from - self.corner;
        let u = to.dot(&across) / size;
        let round = to.cross(&first);
        let v = along.dot(&round) / size;
        let inside = u >= 0.0 && v >= 0.0 && u + v <= 1.0;
        inside.then_some(second.dot(&round) / size)
    }
}

impl Node {
    /// Whether a ray, of which `inverse` is one over its direction, passes through nearer than
    /// `reach`.
    ///
    /// The slab test. Of an axis that the ray is parallel to `inverse` is infinite, which the
    /// comparisons take as they should.
    fn is_met(&self, from: &Vec3, inverse: &Vec3, reach: f32) -> bool {
        let (mut enters, mut leaves) = (0.0_f32, reach);
        for axis in 0..3 {
            let a = (self.low[axis] - from[axis]) * inverse[axis];
            let b = (self.high[axis] - from[axis]) * inverse[axis];
            // NaN, of a ray within a face of the box, narrows nothing.
            enters = enters.max(a.min(b));
            leaves = leaves.min(a.max(b));
        }
        enters <= leaves
    }
}

impl Rays {
    /// Against all triangles of `meshes`, which lie in one frame.
    ///
    /// Triangles with indices past the last vertex are left out. O(n log^2 n).
    pub(super) fn new<'a>(meshes: impl IntoIterator<Item = &'a Mesh>) -> Self {
        let mut triangles = Vec::new();
        for mesh in meshes {
            let at = |index: &u32| mesh.positions.get(*index as usize).copied();
            for [a, b, c] in mesh.indices.as_chunks::<3>().0 {
                if let (Some(a), Some(b), Some(c)) = (at(a), at(b), at(c)) {
                    let [a, b, c] = [a, b, c].map(Vec3::from);
                    let sides = [b - a, c - a];
                    triangles.push(Triangle { corner: a, sides });
                }
            }
        }
        let mut rays = Self {
            nodes: Vec::new(),
            triangles: Vec::new(),
        };
        rays.add(&mut triangles);
        rays
    }

    /// Adds a box around `triangles`, and those in it; its place.
    ///
    /// Recursive; median splits bound the depth by the logarithm of the number of triangles.
    fn add(&mut self, triangles: &mut [Triangle]) -> u32 {
        let corners = || triangles.iter().flat_map(Triangle::corners);
        let low = corners().fold(Vec3::repeat(f32::MAX), |low, p| low.inf(&p));
        let high = corners().fold(Vec3::repeat(f32::MIN), |high, p| high.sup(&p));
        let place = self.nodes.len();
        self.nodes.push(Node {
            low,
            high,
            first: count_u32(self.triangles.len()),
            count: 0,
            second: 0,
        });
        if triangles.len() <= LEAF {
            self.nodes[place].count = count_u32(triangles.len());
            self.triangles.extend_from_slice(triangles);
            return count_u32(place);
        }
        let axis = (high - low).imax();
        triangles.sort_unstable_by(|a, b| a.middle()[axis].total_cmp(&b.middle()[axis]));
        let (near, far) = triangles.split_at_mut(triangles.len() / 2);
        self.add(near);
        self.nodes[place].second = self.add(far);
        count_u32(place)
    }

    /// How far it is from `from` along the unit vector `along` to the first triangle that is nearer
    /// than `reach`.
    ///
    /// Both sides of triangles count. Allocates its stack of places.
    pub(super) fn nearest(&self, from: &Vec3, along: &Vec3, reach: f32) -> Option<f32> {
        let inverse = along.map(|it| 1.0 / it);
        let mut found = reach;
        let mut left = vec![0_u32];
        while let Some(place) = left.pop() {
            let Some(node) = self.nodes.get(place as usize) else {
                continue;
            };
            if !node.is_met(from, &inverse, found) {
                continue;
            }
            if node.second > 0 {
                left.extend([node.second, place + 1]);
                continue;
            }
            let first = node.first as usize;
            for triangle in &self.triangles[first..first + node.count as usize] {
                if let Some(distance) = triangle.hit(from, along)
                    && distance > 0.0
                {
                    found = found.min(distance);
                }
            }
        }
        (found < reach).then_some(found)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shapes::sphere;

    /// From places inside and outside of a ball, in many directions, against the formula; and
    /// against all triangles one by one.
    #[test]
    fn rays_meet_a_ball_where_it_is() {
        let rays = Rays::new([&sphere(0.01, 64)]);
        let mut hits = 0;
        for step in 0..2000_u32 {
            let t = 0.1 * f64::from(step);
            let along = Vector3::new(t.sin(), (1.7 * t).cos(), (0.6 * t + 1.0).sin()).normalize();
            let from = Vector3::new((2.3 * t).cos(), (0.9 * t).sin(), (1.3 * t).cos()) * 0.012;
            let half = -from.dot(&along);
            let root = half * half - (from.norm_squared() - 1e-4);
            let ends = (root > 0.0).then(|| [half - root.sqrt(), half + root.sqrt()]);
            let expected = ends.and_then(|ends| ends.into_iter().find(|&end| end > 0.0));
            let [from, along] = [from, along].map(|v| Vec3::from(hal::mesh::single(&v)));
            let found = rays.nearest(&from, &along, 1.0);
            let all = rays.triangles.iter().filter_map(|it| it.hit(&from, &along));
            let all = all.filter(|&it| it > 0.0).reduce(f32::min);
            assert_eq!(found, all);
            // Not where it only just touches: the ball has corners.
            if let (Some(found), Some(expected)) = (found, expected)
                && root > 2e-5
            {
                assert!(
                    (f64::from(found) - expected).abs() < 2e-4,
                    "{found} {expected}"
                );
                hits += 1;
            }
        }
        assert!(hits > 300, "{hits}");
        let up = Vec3::z();
        assert_eq!(rays.nearest(&Vec3::new(0.0, 0.0, -0.05), &up, 0.03), None);
        assert_eq!(Rays::new([]).nearest(&Vec3::zeros(), &up, 1.0), None);
    }
}
