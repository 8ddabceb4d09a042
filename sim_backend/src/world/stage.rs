//! The physics engine's side of the world: the instrument's moving shapes, the needle and the tissue.

use hal::Pose;
use hal::psm::{FINGER_M, WRIST_M};
use nalgebra::{Point3, Vector3};
use rapier3d_f64::dynamics::{
    FrictionModel, IntegrationParameters, MassProperties, RigidBodyBuilder, RigidBodyHandle,
    SpringCoefficients,
};
use rapier3d_f64::geometry::{
    ColliderBuilder, ColliderHandle, ContactPair, Group, InteractionGroups, InteractionTestMode,
    SharedShape,
};
use rapier3d_f64::parry::utils::Array2;
use rapier3d_f64::pipeline::{ActiveHooks, PhysicsWorld};

use super::chain::{Wrench, z_from_y};
use super::config::WorldConfig;
use super::convert::{engine_pose, engine_vector, our_pose, our_vector};
use super::stick::{Memory, Recall};
use crate::needle::NeedleShape;
use crate::organ::OrganShape;

/// Width of a finger along its hinge, m.
pub(super) const FINGER_WIDTH_M: f64 = 0.003;
/// Thickness of a finger from its inner to its outer face, m.
pub(super) const FINGER_THICKNESS_M: f64 = 0.001_5;
/// Radius of the wrist links, m.
pub(super) const WRIST_RADIUS_M: f64 = 0.002_5;

/// Least force that counts as touching, N.
pub(super) const TOUCH_N: f64 = 1e-3;

/// Length of the capsules that make up the needle, m, at most.
const NEEDLE_CAPSULE_M: f64 = 0.002_6;
/// The needle's inertia over that of its shape. A contact is as stiff as the mass it finds at its lever is large, so a
/// slender wire held away from its middle would rock in the jaws; like the raised mass, this stays far below what the
/// grip carries.
const NEEDLE_INERTIA: f64 = 3.0;
/// Balls along the needle that rest on the tissue: a ball meets a smooth surface in one point, and three carry it.
const NEEDLE_BEADS: usize = 9;
/// Top of the table that the tissue lies on, m; a needle pushed over the edge stops there.
const TABLE_HEIGHT_M: f64 = -0.02;

const INSTRUMENT: Group = Group::GROUP_1;
const NEEDLE: Group = Group::GROUP_2;
const GROUND: Group = Group::GROUP_3;
const BEADS: Group = Group::GROUP_4;

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

struct Part {
    body: RigidBodyHandle,
    collider: ColliderHandle,
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

fn groups(of: Group, with: Group) -> InteractionGroups {
    InteractionGroups::new(of, with, InteractionTestMode::And)
}

fn insert_needle(
    engine: &mut PhysicsWorld,
    config: &WorldConfig,
    shape: &NeedleShape,
    pose: &Pose,
) -> RigidBodyHandle {
    let mass = shape.mass_properties();
    let inertia = mass.inertia * NEEDLE_INERTIA;
    let properties = MassProperties::new(
        engine_vector(&mass.centre.coords),
        shape.mass_kg,
        engine_vector(&inertia),
    );
    let body = RigidBodyBuilder::dynamic()
        .pose(engine_pose(pose))
        .additional_mass_properties(properties)
        .can_sleep(false)
        .build();
    let handle = engine.insert_body(body);
    let points = shape.centre_line(capsule_count(shape) + 1);
    for pair in points.windows(2) {
        let (from, to) = (
            engine_vector(&pair[0].coords),
            engine_vector(&pair[1].coords),
        );
        let capsule = ColliderBuilder::capsule_from_endpoints(from, to, shape.wire_radius_m)
            .density(0.0)
            .friction(config.grip.friction)
            .collision_groups(groups(NEEDLE, INSTRUMENT));
        engine.insert_collider(capsule, Some(handle));
    }
    for bead in shape.centre_line(NEEDLE_BEADS) {
        let bead = ColliderBuilder::ball(shape.wire_radius_m)
            .translation(engine_vector(&bead.coords))
            .density(0.0)
            .friction(config.tissue.friction)
            .collision_groups(groups(BEADS, GROUND));
        engine.insert_collider(bead, Some(handle));
    }
    handle
}

/// Odd, so that a capsule lies across the middle of the arc.
fn capsule_count(shape: &NeedleShape) -> usize {
    let length_m = shape.arc_radius_m * shape.arc_angle_rad;
    let fits = |count: &usize| crate::needle::ratio(1, *count) * length_m <= NEEDLE_CAPSULE_M;
    (1..=41).step_by(2).find(fits).unwrap_or(41)
}

fn insert_ground(engine: &mut PhysicsWorld, config: &WorldConfig, organ: &OrganShape) {
    let rows = organ.contact_heights();
    let (row_count, column_count) = (rows.len(), rows.first().map_or(0, Vec::len));
    // The engine's height field rises along y and counts rows along z, which becomes -y here: last row first.
    let mut heights = Array2::zeros(row_count, column_count);
    for (row, values) in rows.iter().rev().enumerate() {
        for (column, &height) in values.iter().enumerate() {
            heights[(row, column)] = height;
        }
    }
    let scale = engine_vector(&Vector3::new(organ.length_m, 1.0, organ.width_m));
    let field = ColliderBuilder::heightfield(heights, scale);
    let table = ColliderBuilder::cuboid(0.25, 0.005, 0.25).translation(engine_vector(
        &Vector3::new(0.0, TABLE_HEIGHT_M - 0.005, 0.0),
    ));
    let body = engine.insert_body(
        RigidBodyBuilder::fixed()
            .pose(engine_pose(&Pose::from_parts([0.0; 3].into(), z_from_y())))
            .build(),
    );
    for ground in [field, table] {
        let ground = ground
            .friction(config.tissue.friction)
            .collision_groups(groups(GROUND, BEADS));
        engine.insert_collider(ground, Some(body));
    }
}

/// A box from the hinge to the finger's end whose inner face passes through the hinge.
fn finger(side: f64) -> (SharedShape, Pose) {
    let shape = SharedShape::cuboid(
        0.5 * FINGER_WIDTH_M,
        0.5 * FINGER_THICKNESS_M,
        0.5 * FINGER_M,
    );
    (
        shape,
        Pose::translation(0.0, 0.5 * side * FINGER_THICKNESS_M, 0.5 * FINGER_M),
    )
}

/// A capsule from the wrist-pitch axis to the wrist-yaw axis, in the wrist-pitch frame.
fn wrist() -> (SharedShape, Pose) {
    let (from, to) = (Vector3::zeros(), Vector3::new(WRIST_M, 0.0, 0.0));
    (
        SharedShape::capsule(engine_vector(&from), engine_vector(&to), WRIST_RADIUS_M),
        Pose::identity(),
    )
}

fn insert_part(
    engine: &mut PhysicsWorld,
    config: &WorldConfig,
    shape: (SharedShape, Pose),
    pose: &Pose,
) -> Part {
    let body = RigidBodyBuilder::kinematic_position_based()
        .pose(engine_pose(pose))
        .can_sleep(false)
        .build();
    let body = engine.insert_body(body);
    let collider = ColliderBuilder::new(shape.0)
        .position(engine_pose(&shape.1))
        .density(0.0)
        .friction(config.grip.friction)
        .active_hooks(ActiveHooks::MODIFY_SOLVER_CONTACTS)
        .collision_groups(groups(INSTRUMENT, NEEDLE));
    Part {
        body,
        collider: engine.insert_collider(collider, Some(body)),
    }
}
