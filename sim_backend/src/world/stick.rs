//! Static friction with a memory: the fingers know where a thing stuck to them.
//!
//! The engine's friction stops sliding speed but forgets the place, so what its sweeps leave unsolved adds up to a
//! creep. Here a finger that touches a thing remembers its pose in its own frame, and asks the friction
//! constraint at every contact point to creep back there instead of standing still. The request goes through the same
//! Coulomb cone as all friction: a pull beyond it slides, and the memory slides along.

use hal::Pose;
use rapier3d_f64::dynamics::RigidBodyHandle;
use rapier3d_f64::geometry::ColliderHandle;
use rapier3d_f64::math::Pose as EnginePose;
use rapier3d_f64::pipeline::{ContactModificationContext, ModifiableContacts, PhysicsHooks};

use super::contacts::merge;
use super::convert::engine_pose;

/// Share of the drift that is asked back in a second, 1/s.
const RETURN_RATE: f64 = 100.0;
/// Drift up to which static friction gives elastically, m; beyond it the memory slides along.
const GIVE_M: f64 = 5e-5;
/// Radius at which turning counts as drift, m: about that of a needle's wire.
const TURN_RADIUS_M: f64 = 0.000_7;

/// A thing's pose in a finger's frame where they stuck; none while they do not touch.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Memory {
    pub(super) finger_from_thing: Option<Pose>,
}

impl Memory {
    /// Takes the poses after a step in which the finger touched the thing around `point_in_scene`, or did not touch.
    pub(super) fn update(
        &mut self,
        finger: &Pose,
        thing: &Pose,
        point_in_scene: Option<nalgebra::Point3<f64>>,
    ) {
        let Some(point) = point_in_scene else {
            self.finger_from_thing = None;
            return;
        };
        let now = finger.inverse() * thing;
        let Some(then) = self.finger_from_thing else {
            self.finger_from_thing = Some(now);
            return;
        };
        let moved = finger * then * thing.inverse();
        let drift = (moved * point - point).norm() + moved.rotation.angle() * TURN_RADIUS_M;
        if drift > GIVE_M {
            self.finger_from_thing = Some(now.lerp_slerp(&then, GIVE_M / drift));
        }
    }

    /// The motion in the scene that takes the thing from where it is to where it stuck.
    fn homing(&self, finger: &Pose, thing: &Pose) -> Option<EnginePose> {
        self.finger_from_thing
            .map(|stuck| engine_pose(&(finger * stuck * thing.inverse())))
    }
}

/// What the contacts of one step are told.
#[derive(Default)]
pub(super) struct Recall {
    homings: Vec<(ColliderHandle, RigidBodyHandle, EnginePose)>,
}

impl Recall {
    /// Tells the contacts between `finger` and `thing` what the finger remembers, given both poses at the beginning of
    /// the step.
    pub(super) fn add(
        &mut self,
        finger: (ColliderHandle, &Pose),
        thing: (RigidBodyHandle, &Pose),
        memory: &Memory,
    ) {
        if let Some(homing) = memory.homing(finger.1, thing.1) {
            self.homings.push((finger.0, thing.0, homing));
        }
    }

    fn homing(
        &self,
        finger: ColliderHandle,
        thing: Option<RigidBodyHandle>,
    ) -> Option<&EnginePose> {
        self.homings
            .iter()
            .find(|(collider, body, _)| *collider == finger && Some(*body) == thing)
            .map(|(_, _, homing)| homing)
    }
}

impl PhysicsHooks for Recall {
    fn modify_solver_contacts(&self, context: &mut ContactModificationContext<'_>) {
        if let ModifiableContacts::Rigid(manifold) = &mut context.contacts {
            merge(manifold.solver_contacts);
        }
        // The engine takes the velocity as one of the first body's surface.
        let (homing, sign) = match (
            self.homing(context.collider1, context.rigid_body2),
            self.homing(context.collider2, context.rigid_body1),
        ) {
            (Some(homing), _) => (homing, RETURN_RATE),
            (None, Some(homing)) => (homing, -RETURN_RATE),
            (None, None) => return,
        };
        let ModifiableContacts::Rigid(manifold) = &mut context.contacts else {
            return;
        };
        let normal = *manifold.normal;
        for contact in manifold.solver_contacts.iter_mut() {
            let point = (contact.anchor1 + contact.anchor2) * 0.5;
            let back = homing.transform_point(point) - point;
            contact.tangent_velocity = (back - normal * back.dot(normal)) * sign;
        }
    }
}
