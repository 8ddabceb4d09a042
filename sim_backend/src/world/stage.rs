//! The physics engine's side of the world: steps it, and reads what the instrument feels.

use hal::Pose;
use nalgebra::{Point3, Vector3};
use rapier3d_f64::dynamics::{
    FrictionModel, IntegrationParameters, RigidBodyHandle, SpringCoefficients,
};
use rapier3d_f64::geometry::{ColliderHandle, ContactPair};
use rapier3d_f64::pipeline::PhysicsWorld;

use super::chain::Wrench;
use super::config::WorldConfig;
use super::convert::{engine_pose, engine_vector, our_pose, our_vector};
use super::solids::{Part, finger, insert_ground, insert_needle, insert_part, wrist};
use super::stick::{Memory, Recall};
use crate::needle::NeedleShape;
use crate::organ::OrganShape;

/// Least force that counts as touching, N.
pub(super) const TOUCH_N: f64 = 1e-3;

/// What one part of the instrument feels from the needle.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch {
    /// Force and moment about the tip frame's origin, on the part.
    pub(super) wrench: Wrench,
    /// Sum of the normal forces, N.
    pub(super) force_n: f64,
    /// Deepest overlap, m.
    pub(super) penetration_m: f64,
    /// Sum of the contact points weighed by their forces, N m; the force's share is the middle of the touch.
    weighed_points: Vector3<f64>,
}

impl Touch {
    const NONE: Self = Self {
        wrench: Wrench::zero(),
        force_n: 0.0,
        penetration_m: 0.0,
        weighed_points: Vector3::new(0.0, 0.0, 0.0),
    };

    /// The middle of the touch in the scene, if there is one.
    fn middle(&self) -> Option<Point3<f64>> {
        (self.force_n > TOUCH_N).then(|| Point3::from(self.weighed_points / self.force_n))
    }
}

/// Poses of the instrument's moving parts for one step, in the order left finger, right finger, wrist.
pub(super) type PartPoses = [Pose; 3];

/// The engine with everything in it.
pub(super) struct Stage {
    engine: PhysicsWorld,
    parts: [Part; 3],
    poses: PartPoses,
    needle: RigidBodyHandle,
    memories: [Memory; 2],
    touches: [Touch; 3],
}

impl Stage {
    pub(super) fn new(
        config: &WorldConfig,
        needle: &NeedleShape,
        organ: &OrganShape,
        needle_in_scene: &Pose,
        parts: &PartPoses,
    ) -> Self {
        let mut engine = PhysicsWorld::new();
        engine.gravity = engine_vector(&Vector3::new(0.0, 0.0, -config.gravity_m_s2));
        engine.integration_parameters = parameters(config);
        let needle = insert_needle(&mut engine, config, needle, needle_in_scene);
        insert_ground(&mut engine, config, organ);
        let shapes = [finger(1.0), finger(-1.0), wrist()];
        let mut index = 0;
        let handles = shapes.map(|shape| {
            let part = insert_part(&mut engine, config, shape, &parts[index]);
            index += 1;
            part
        });
        Self {
            engine,
            parts: handles,
            poses: *parts,
            needle,
            memories: [Memory::default(); 2],
            touches: [Touch::NONE; 3],
        }
    }

    /// Moves the instrument to `poses` within one step and lets the needle follow; moments are then taken about
    /// `centre`.
    pub(super) fn step(&mut self, poses: &PartPoses, centre: &Vector3<f64>) {
        for (part, pose) in self.parts.iter().zip(poses) {
            if let Some(body) = self.engine.bodies.get_mut(part.body) {
                body.set_next_kinematic_position(engine_pose(pose));
            }
        }
        let fingers = [0, 1].map(|side| {
            (
                self.parts[side].collider,
                self.poses[side],
                &self.memories[side],
            )
        });
        let recall = Recall::new(fingers, &self.needle_in_scene());
        self.engine.step_with_events(&recall, &());
        self.poses = *poses;
        self.touches = [0, 1, 2].map(|index| self.touch(self.parts[index].collider, centre));
        let needle = self.needle_in_scene();
        for (side, memory) in self.memories.iter_mut().enumerate() {
            memory.update(&poses[side], &needle, self.touches[side].middle());
        }
    }

    /// What the parts felt in the newest step, in the order of [`PartPoses`].
    pub(super) const fn touches(&self) -> &[Touch; 3] {
        &self.touches
    }

    /// Where the fingers remember the needle, for hashing.
    pub(super) fn memory_numbers(&self) -> impl Iterator<Item = f64> + '_ {
        self.memories
            .iter()
            .filter_map(|memory| memory.finger_from_needle)
            .flat_map(|pose| {
                let q = pose.rotation.quaternion().coords;
                let t = pose.translation.vector;
                [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
            })
    }

    pub(super) fn needle_in_scene(&self) -> Pose {
        self.engine
            .bodies
            .get(self.needle)
            .map_or_else(Pose::identity, |body| our_pose(body.position()))
    }

    /// Linear and angular velocity of the needle.
    pub(super) fn needle_velocity(&self) -> [Vector3<f64>; 2] {
        let velocity = self
            .engine
            .bodies
            .get(self.needle)
            .map(|body| [body.linvel(), body.angvel()]);
        velocity.map_or_else(|| [Vector3::zeros(); 2], |pair| pair.map(our_vector))
    }

    fn touch(&self, collider: ColliderHandle, centre: &Vector3<f64>) -> Touch {
        let mut touch = Touch::NONE;
        for pair in self.engine.narrow_phase.contact_pairs_with(collider) {
            self.add_pair(&mut touch, pair, collider, centre);
        }
        touch
    }

    fn add_pair(
        &self,
        touch: &mut Touch,
        pair: &ContactPair,
        part: ColliderHandle,
        centre: &Vector3<f64>,
    ) {
        let Some(first) = self.engine.colliders.get(pair.collider1) else {
            return;
        };
        let inverse_dt = self.engine.integration_parameters.inv_dt();
        // Normals point from the first collider to the second; a contact pushes them apart.
        let sign = if pair.collider1 == part {
            -inverse_dt
        } else {
            inverse_dt
        };
        for manifold in pair.solver_manifolds() {
            let normal = our_vector(manifold.data.normal);
            for point in &manifold.points {
                touch.penetration_m = touch.penetration_m.max(-point.dist);
                if point.data.impulse > 0.0 {
                    let at = our_vector(first.position().transform_point(point.local_p1));
                    let force_n = point.data.impulse * inverse_dt;
                    touch.force_n += force_n;
                    touch.weighed_points += at * force_n;
                    touch
                        .wrench
                        .push(&(at - centre), &(normal * (sign * point.data.impulse)));
                }
            }
        }
    }
}

fn parameters(config: &WorldConfig) -> IntegrationParameters {
    IntegrationParameters {
        dt: 1e-3,
        min_ccd_dt: 1e-5,
        contact_softness: SpringCoefficients::new(
            config.grip.frequency_hz,
            config.grip.damping_ratio,
        ),
        static_contact_softness: SpringCoefficients::new(
            config.tissue.frequency_hz,
            config.tissue.damping_ratio,
        ),
        length_unit: config.length_unit_m,
        num_solver_iterations: config.solver_substeps as usize,
        num_internal_pgs_iterations: config.solver_sweeps as usize,
        // A grasp is not a pile of crates: contacts are found anew every step, and friction acts in every pass.
        contact_recycling: false,
        friction_in_bias_pass: true,
        friction_model: FrictionModel::Coulomb,
        ..IntegrationParameters::default()
    }
}
