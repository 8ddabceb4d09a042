//! The instrument against hard ground: springs, damping and friction where its parts and the ground's solids overlap.

use hal::Pose;
use nalgebra::{Point3, Vector3};
use rapier3d_f64::geometry::SharedShape;
use rapier3d_f64::math::{Pose as EnginePose, Real};
use rapier3d_f64::parry::bounding_volume::{Aabb, BoundingVolume};
use rapier3d_f64::parry::query;

use super::chain::Wrench;
use super::config::Press;
use super::convert::{engine_pose, our_vector};
use super::scenery::Shape;
use super::solids::{engine_shape, finger, wrist};
use super::stage::PartPoses;

/// Below this tangential speed friction fades, m/s: it damps, it does not stick.
const SLIDING_M_S: f64 = 0.02;

/// The ground's solids and the instrument's parts as shapes.
pub(super) struct Obstacles {
    solids: Vec<(SharedShape, EnginePose, Aabb)>,
    parts: [(SharedShape, Pose); 3],
}

/// What the ground does to one part.
pub(super) struct Push {
    pub(super) wrench: Wrench,
    /// Sum of the normal forces, N.
    pub(super) force_n: f64,
}

impl Obstacles {
    pub(super) fn new(solids: &[Shape]) -> Self {
        let solids = solids.iter().map(|solid| {
            let (shape, pose) = engine_shape(solid);
            let pose = engine_pose(&pose);
            let bounds = shape.compute_aabb(&pose);
            (shape, pose, bounds)
        });
        Self {
            solids: solids.collect(),
            parts: [finger(1.0), finger(-1.0), wrist()],
        }
    }

    /// Force on the part `index` at `poses`, which was at `before` one millisecond ago, with its moment about `centre`.
    pub(super) fn push(
        &self,
        config: &Press,
        index: usize,
        poses: &PartPoses,
        before: &PartPoses,
        centre: &Vector3<f64>,
    ) -> Push {
        let mut push = Push {
            wrench: Wrench::zero(),
            force_n: 0.0,
        };
        let (shape, place) = &self.parts[index];
        let pose = engine_pose(&(poses[index] * place));
        let bounds = shape.compute_aabb(&pose);
        let moved = before[index] * poses[index].inverse();
        for (solid, solid_pose, solid_bounds) in &self.solids {
            if !bounds.intersects(solid_bounds) {
                continue;
            }
            let none: Real = 0.0;
            let Ok(Some(contact)) = query::contact(solid_pose, &**solid, &pose, &**shape, none)
            else {
                continue;
            };
            let normal = our_vector(contact.normal1);
            let point = Point3::from(our_vector(contact.point2));
            let velocity = (point - moved * point) * 1e3;
            let rising = velocity.dot(&normal);
            let load =
                (-config.stiffness_n_m * contact.dist - config.damping_n_s_m * rising).max(0.0);
            let sliding = velocity - normal * rising;
            let drag = sliding * (config.friction * load / sliding.norm().max(SLIDING_M_S));
            push.force_n += load;
            push.wrench
                .push(&(point.coords - centre), &(normal * load - drag));
        }
        push
    }
}
