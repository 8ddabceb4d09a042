//! The bodies in the physics engine: things, ground, and the instruments' moving parts.

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
use super::scenery::{Ground, Meets, Piece, Shape, Thing};
use crate::organ::OrganShape;

/// Width of a finger along its hinge, m.
pub(super) const FINGER_WIDTH_M: f64 = 0.003;
/// Thickness of a finger from its inner to its outer face, m.
pub(crate) const FINGER_THICKNESS_M: f64 = 0.001_5;
/// Radius of the wrist links, m.
pub(super) const WRIST_RADIUS_M: f64 = 0.002_5;

/// Top of the table that the tissue lies on, m; a needle pushed over the edge stops there.
const TABLE_HEIGHT_M: f64 = -0.02;

/// A thing near which no instrument is falls asleep once no point of it has moved by twice this in a second, m/s, for
/// [`REST_S`]; it then stays where it is to the bit until an instrument comes near. A slide slower than that ends there.
const REST_M_S: f64 = 1e-5;
/// How long it lies that still before it falls asleep, s.
const REST_S: f64 = 0.1;

const INSTRUMENT: Group = Group::GROUP_1;
const GRIPPED: Group = Group::GROUP_2;
const GROUND: Group = Group::GROUP_3;
const RESTING: Group = Group::GROUP_4;

/// One moving part of the instrument in the engine.
pub(super) struct Part {
    pub(super) body: RigidBodyHandle,
    pub(super) collider: ColliderHandle,
}

fn groups(of: Group, with: Group) -> InteractionGroups {
    InteractionGroups::new(of, with, InteractionTestMode::And)
}

/// A shape for the engine, with its place in the frame that its points are in. A hull without volume becomes a ball
/// about its first point, and nothing joined to nothing one about the origin; no task has them.
pub(super) fn engine_shape(shape: &Shape) -> (SharedShape, Pose) {
    match shape {
        Shape::Ball { centre, radius_m } => (
            SharedShape::ball(*radius_m),
            Pose::translation(centre.x, centre.y, centre.z),
        ),
        Shape::Capsule { from, to, radius_m } => (
            SharedShape::capsule(
                engine_vector(&from.coords),
                engine_vector(&to.coords),
                *radius_m,
            ),
            Pose::identity(),
        ),
        Shape::Block { low, high } => {
            let half = (high - low) * 0.5;
            let middle = low + half;
            (
                SharedShape::cuboid(half.x, half.y, half.z),
                Pose::translation(middle.x, middle.y, middle.z),
            )
        }
        Shape::Hull(points) => {
            let corners: Vec<_> = points.iter().map(|p| engine_vector(&p.coords)).collect();
            let hull = SharedShape::convex_hull(&corners);
            (
                hull.unwrap_or_else(|| SharedShape::ball(1e-3)),
                Pose::identity(),
            )
        }
        Shape::Joined(shapes) if shapes.is_empty() => (SharedShape::ball(1e-3), Pose::identity()),
        Shape::Joined(shapes) => {
            let parts = shapes.iter().map(|shape| {
                let (shape, pose) = engine_shape(shape);
                (engine_pose(&pose), shape)
            });
            (SharedShape::compound(parts.collect()), Pose::identity())
        }
    }
}

pub(super) fn insert_thing(
    engine: &mut PhysicsWorld,
    config: &WorldConfig,
    thing: &Thing,
) -> RigidBodyHandle {
    let axes = Pose::from_parts([0.0; 3].into(), thing.axes);
    let properties = MassProperties::with_principal_inertia_frame(
        engine_vector(&thing.centre.coords),
        thing.mass_kg,
        engine_vector(&thing.inertia),
        engine_pose(&axes).rotation,
    );
    let mut body = RigidBodyBuilder::dynamic()
        .pose(engine_pose(&thing.in_scene))
        .additional_mass_properties(properties)
        .build();
    body.activation_mut().normalized_linear_threshold = REST_M_S / config.length_unit_m;
    body.activation_mut().time_until_sleep = REST_S;
    let handle = engine.insert_body(body);
    for piece in &thing.pieces {
        engine.insert_collider(collider(piece), Some(handle));
    }
    handle
}

fn collider(piece: &Piece) -> ColliderBuilder {
    let (of, with) = match piece.meets {
        Meets::Instrument => (GRIPPED, INSTRUMENT),
        Meets::Ground => (RESTING, GROUND),
        Meets::Both => (GRIPPED | RESTING, INSTRUMENT | GROUND),
    };
    let (shape, pose) = engine_shape(&piece.shape);
    ColliderBuilder::new(shape)
        .position(engine_pose(&pose))
        .density(0.0)
        .friction(piece.friction)
        .collision_groups(groups(of, with))
}

pub(super) fn insert_ground(engine: &mut PhysicsWorld, config: &WorldConfig, ground: &Ground) {
    match ground {
        Ground::Organ(organ) => insert_organ(engine, config, organ),
        Ground::Bed(_) => {}
        Ground::Solids(solids) => {
            let body = engine.insert_body(RigidBodyBuilder::fixed().build());
            for solid in solids {
                let (shape, pose) = engine_shape(solid);
                let solid = ColliderBuilder::new(shape)
                    .position(engine_pose(&pose))
                    .friction(config.tissue.friction)
                    .collision_groups(groups(GROUND, RESTING));
                engine.insert_collider(solid, Some(body));
            }
        }
    }
}

fn insert_organ(engine: &mut PhysicsWorld, config: &WorldConfig, organ: &OrganShape) {
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
            .collision_groups(groups(GROUND, RESTING));
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
        .collision_groups(groups(INSTRUMENT, GRIPPED));
    Part {
        body,
        collider: engine.insert_collider(collider, Some(body)),
    }
}
