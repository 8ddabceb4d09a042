//! The bodies in the physics engine: the needle, the ground, and the instrument's moving parts.

use hal::Pose;
use hal::psm::{FINGER_M, WRIST_M};
use nalgebra::Vector3;
use rapier3d_f64::dynamics::{MassProperties, RigidBodyBuilder, RigidBodyHandle};
use rapier3d_f64::geometry::{
    ColliderBuilder, ColliderHandle, Group, InteractionGroups, InteractionTestMode, SharedShape,
};
use rapier3d_f64::parry::utils::Array2;
use rapier3d_f64::pipeline::{ActiveHooks, PhysicsWorld};

use super::chain::z_from_y;
use super::config::WorldConfig;
use super::convert::{engine_pose, engine_vector};
use crate::needle::NeedleShape;
use crate::organ::OrganShape;

/// Width of a finger along its hinge, m.
pub(super) const FINGER_WIDTH_M: f64 = 0.003;
/// Thickness of a finger from its inner to its outer face, m.
pub(super) const FINGER_THICKNESS_M: f64 = 0.001_5;
/// Radius of the wrist links, m.
pub(super) const WRIST_RADIUS_M: f64 = 0.002_5;

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

/// One moving part of the instrument in the engine.
pub(super) struct Part {
    pub(super) body: RigidBodyHandle,
    pub(super) collider: ColliderHandle,
}

fn groups(of: Group, with: Group) -> InteractionGroups {
    InteractionGroups::new(of, with, InteractionTestMode::And)
}

pub(super) fn insert_needle(
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

pub(super) fn insert_ground(engine: &mut PhysicsWorld, config: &WorldConfig, organ: &OrganShape) {
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
pub(super) fn finger(side: f64) -> (SharedShape, Pose) {
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
pub(super) fn wrist() -> (SharedShape, Pose) {
    let (from, to) = (Vector3::zeros(), Vector3::new(WRIST_M, 0.0, 0.0));
    (
        SharedShape::capsule(engine_vector(&from), engine_vector(&to), WRIST_RADIUS_M),
        Pose::identity(),
    )
}

pub(super) fn insert_part(
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
