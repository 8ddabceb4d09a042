//! Static friction with a memory: the fingers know where the wire stuck to them.
//!
//! The engine's friction stops sliding speed but forgets the place, so what its sweeps leave unsolved adds up to a
//! creep. Here a finger that touches the wire remembers the wire's pose in its own frame, and asks the friction
//! constraint at every contact point to creep back there instead of standing still. The request goes through the same
//! Coulomb cone as all friction: a pull beyond it slides, and the memory slides along.

use hal::Pose;
use rapier3d_f64::geometry::ColliderHandle;
use rapier3d_f64::math::Pose as EnginePose;
use rapier3d_f64::pipeline::{ContactModificationContext, ModifiableContacts, PhysicsHooks};

use super::convert::engine_pose;

/// Share of the drift that is asked back in a second, 1/s.
const RETURN_RATE: f64 = 100.0;
/// Drift up to which static friction gives elastically, m; beyond it the memory slides along.
const GIVE_M: f64 = 5e-5;
/// Radius at which turning counts as drift, m: about that of the wire.
const TURN_RADIUS_M: f64 = 0.000_7;

/// The wire's pose in a finger's frame where they stuck; none while they do not touch.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Memory {
    pub(super) finger_from_needle: Option<Pose>,
}

impl Memory {
    /// Takes the poses after a step in which the finger touched the needle around `point_in_scene`, or did not touch.
    pub(super) fn update(
        &mut self,
        finger: &Pose,
        needle: &Pose,
        point_in_scene: Option<nalgebra::Point3<f64>>,
    ) {
        let Some(point) = point_in_scene else {
            self.finger_from_needle = None;
            return;
        };
        let now = finger.inverse() * needle;
        let Some(then) = self.finger_from_needle else {
            self.finger_from_needle = Some(now);
            return;
        };
        let moved = finger * then * needle.inverse();
        let drift = (moved * point - point).norm() + moved.rotation.angle() * TURN_RADIUS_M;
        if drift > GIVE_M {
            self.finger_from_needle = Some(now.lerp_slerp(&then, GIVE_M / drift));
        }
    }

    /// The motion in the scene that takes the needle from where it is to where it stuck.
    fn homing(&self, finger: &Pose, needle: &Pose) -> Option<EnginePose> {
        self.finger_from_needle
            .map(|stuck| engine_pose(&(finger * stuck * needle.inverse())))
    }
}

/// What the contacts of one step are told.
pub(super) struct Recall {
    fingers: [(ColliderHandle, Option<EnginePose>); 2],
}

impl Recall {
    /// For fingers given by collider, pose and memory at the beginning of the step.
    pub(super) fn new(fingers: [(ColliderHandle, Pose, &Memory); 2], needle: &Pose) -> Self {
        Self {
            fingers: fingers
                .map(|(collider, pose, memory)| (collider, memory.homing(&pose, needle))),
        }
    }

    fn homing(&self, collider: ColliderHandle) -> Option<&EnginePose> {
        self.fingers
            .iter()
            .find(|(finger, _)| *finger == collider)
            .and_then(|(_, homing)| homing.as_ref())
    }
}

impl PhysicsHooks for Recall {
    fn modify_solver_contacts(&self, context: &mut ContactModificationContext<'_>) {
        // The engine takes the velocity as one of the first body's surface.
        let (homing, sign) = match (
            self.homing(context.collider1),
            self.homing(context.collider2),
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
