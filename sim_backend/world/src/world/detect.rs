//! Where two convex shapes touch or are about to: contact points with normals and gaps, few enough
//! to solve.

use nalgebra::Vector3;
use rapier3d_f64::math::{Pose as EnginePose, Vector as EngineVector};
use rapier3d_f64::parry::query::{
    ContactManifold, DefaultQueryDispatcher, PersistentQueryDispatcher,
};

use super::convert::our_vector;
use super::shapes::Body;

/// Points nearer to each other than this are one, m: far below any feature, far above rounding.
const SAME_M: f64 = 1e-5;
/// Depths that differ by less are the same, m.
const LEVEL_M: f64 = 2e-6;
/// Cosine between normals that belong to one face.
const SAME_FACE: f64 = 0.99;

/// A point where two shapes touch or are about to.
#[derive(Clone, Copy, Debug)]
pub(super) struct Found {
    /// Half-way between the surfaces, scene frame, m.
    pub(super) point: Vector3<f64>,
    /// From the first shape to the second.
    pub(super) normal: Vector3<f64>,
    /// Distance along the normal, m; negative where they overlap.
    pub(super) gap_m: f64,
}

/// Contact manifolds of pairs of shapes, with the room that they are found in.
#[derive(Default)]
pub(super) struct Detector {
    manifold: ContactManifold<(), ()>,
    /// What was found since [`Detector::clear`].
    pub(super) found: Vec<Found>,
}

/// A carrier's shape as the first of pairs: its place in the scene, forth and back.
pub(super) struct First<'a> {
    body: &'a Body,
    scene_from_shape: EnginePose,
    shape_from_scene: EnginePose,
}

impl<'a> First<'a> {
    /// `body` on a carrier at `carrier`.
    pub(super) fn new(body: &'a Body, carrier: &EnginePose) -> Self {
        let scene_from_shape = carrier * body.place;
        Self {
            body,
            scene_from_shape,
            shape_from_scene: scene_from_shape.inverse(),
        }
    }

    /// The second carrier's pose in the frame of this shape.
    pub(super) fn relative(&self, second: &EnginePose) -> EnginePose {
        self.shape_from_scene * second
    }

    /// Whether a ball about `centre` in this shape's frame is nearer than `reach_m` to the shape's
    /// box.
    pub(super) fn is_near(&self, centre: EngineVector, reach_m: f64) -> bool {
        let bounds = &self.body.bounds;
        let nearest = centre.clamp(bounds.mins, bounds.maxs);
        (centre - nearest).length_squared() <= reach_m * reach_m
    }
}

impl Detector {
    pub(super) fn clear(&mut self) {
        self.found.clear();
    }

    /// Adds where `second`, whose carrier is at `relative` in the frame of `first`, is within
    /// `reach_m` of it.
    pub(super) fn pair(
        &mut self,
        first: &First<'_>,
        second: &Body,
        relative: &EnginePose,
        reach_m: f64,
    ) {
        let centre = relative.transform_point(second.centre);
        if !first.is_near(centre, second.radius_m + reach_m) {
            return;
        }
        if self.capsule_on_face(first, second, relative, reach_m) {
            return;
        }
        let between = relative * second.place;
        self.manifold.points.clear();
        let known = DefaultQueryDispatcher.contact_manifold_convex_convex(
            &between,
            &*first.body.shape,
            &*second.shape,
            None,
            None,
            reach_m,
            &mut self.manifold,
        );
        if known.is_err() {
            return;
        }
        let normal = self.manifold.local_n1;
        for point in &self.manifold.points {
            if point.dist <= reach_m {
                let middle = (point.local_p1 + between.transform_point(point.local_p2)) * 0.5;
                self.found.push(found(first, middle, normal, point.dist));
            }
        }
    }

    /// A capsule whose ends both lie over one face of a box meets it under its ends: the most
    /// common pair by far, and hundreds of times cheaper so.
    fn capsule_on_face(
        &mut self,
        first: &First<'_>,
        second: &Body,
        relative: &EnginePose,
        reach_m: f64,
    ) -> bool {
        let (Some(block), Some(capsule)) =
            (first.body.shape.as_cuboid(), second.shape.as_capsule())
        else {
            return false;
        };
        let half = block.half_extents;
        let place = relative * second.place;
        let ends = [capsule.segment.a, capsule.segment.b].map(|p| place.transform_point(p));
        for axis in 0..3 {
            for sign in [1.0, -1.0] {
                let over = ends.iter().all(|end| {
                    (0..3).all(|other| {
                        if other == axis {
                            sign * end[other] > half[other]
                        } else {
                            end[other].abs() < half[other]
                        }
                    })
                });
                if !over {
                    continue;
                }
                let mut normal = EngineVector::ZERO;
                normal[axis] = sign;
                for end in ends {
                    let gap_m = sign * end[axis] - half[axis] - capsule.radius;
                    if gap_m <= reach_m {
                        let middle = end - normal * (capsule.radius + 0.5 * gap_m);
                        self.found.push(found(first, middle, normal, gap_m));
                    }
                }
                return true;
            }
        }
        false
    }

    /// Leaves of what was found what carries as well: each place once, and of each face four points
    /// at most, the deepest and those that span it.
    pub(super) fn reduce(&mut self) {
        merge(&mut self.found);
        let mut from = 0;
        while from < self.found.len() {
            let normal = self.found[from].normal;
            let mut to = from + 1;
            for index in from + 1..self.found.len() {
                if self.found[index].normal.dot(&normal) > SAME_FACE {
                    self.found.swap(to, index);
                    to += 1;
                }
            }
            let kept = span(&mut self.found[from..to]);
            self.found.drain(from + kept..to);
            from += kept;
        }
    }
}

fn found(first: &First<'_>, middle: EngineVector, normal: EngineVector, gap_m: f64) -> Found {
    let scene = &first.scene_from_shape;
    Found {
        point: our_vector(scene.transform_point(middle)),
        normal: our_vector(scene.rotation * normal),
        gap_m,
    }
}

/// Drops points that lie where another one with the same normal does; the deeper one stays.
fn merge(found: &mut Vec<Found>) {
    let mut kept: usize = 0;
    for index in 0..found.len() {
        let here = found[index];
        let same = found[..kept].iter().position(|earlier| {
            (earlier.point - here.point).norm_squared() < SAME_M * SAME_M
                && earlier.normal.dot(&here.normal) > SAME_FACE
        });
        match same {
            Some(earlier) if found[earlier].gap_m > here.gap_m => found[earlier] = here,
            Some(_) => {}
            None => {
                found[kept] = here;
                kept += 1;
            }
        }
    }
    found.truncate(kept);
}

/// Moves the points of one face that are to be kept to its front, and says how many they are.
fn span(face: &mut [Found]) -> usize {
    if face.len() <= 4 {
        return face.len();
    }
    let normal = face[0].normal;
    let mut take = |at: usize, worth: &dyn Fn(&[Found], &Found) -> f64| {
        let (before, rest) = face.split_at(at);
        let mut best = (0, f64::NEG_INFINITY);
        for (index, found) in rest.iter().enumerate() {
            let value = worth(before, found);
            if value > best.1 {
                best = (index, value);
            }
        }
        face.swap(at, at + best.0);
    };
    let area = |a: &Found, b: &Found, p: &Found| {
        normal.dot(&(b.point - a.point).cross(&(p.point - a.point)))
    };
    // Of points that are as deep as each other, the first: a choice by rounding would change from
    // step to step.
    take(0, &|_, p| -(p.gap_m / LEVEL_M).floor());
    take(1, &|kept, p| (p.point - kept[0].point).norm_squared());
    take(2, &|kept, p| area(&kept[0], &kept[1], p).abs());
    take(3, &|kept, p| {
        // How far outside of the triangle.
        let turn = area(&kept[0], &kept[1], &kept[2]).signum();
        let edges = [(0, 1), (1, 2), (2, 0)];
        let outside = edges.map(|(a, b)| -turn * area(&kept[a], &kept[b], p));
        outside.into_iter().fold(f64::NEG_INFINITY, f64::max)
    });
    4
}
