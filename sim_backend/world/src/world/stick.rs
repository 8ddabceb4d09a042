//! Static friction with a memory: the fingers know where a thing stuck to them.
//!
//! A friction cone stops sliding speed but forgets the place, so what regularisation lets slip adds
//! up to a creep. Here a finger that touches a thing remembers its pose in its own frame, and
//! friction at every contact point aims at going back there instead of standing still. It goes
//! through the same Coulomb cone: a pull beyond it slides, and the memory slides along.

use hal::Pose;
use nalgebra::{Point3, Vector3};

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
    /// Takes the poses after a step in which the finger touched the thing around `point_in_scene`,
    /// or did not touch.
    pub(super) fn update(
        &mut self,
        finger: &Pose,
        thing: &Pose,
        point_in_scene: Option<Point3<f64>>,
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

    /// Velocity that brings the thing's `point` (scene frame) back to where it stuck to the finger,
    /// along the surface with `normal`, m/s; and the spin about the normal that turns it back,
    /// rad/s. Both 0 without a memory.
    pub(super) fn homing(
        &self,
        (finger, thing): (&Pose, &Pose),
        point: &Vector3<f64>,
        normal: &Vector3<f64>,
    ) -> (Vector3<f64>, f64) {
        let Some(stuck) = &self.finger_from_thing else {
            return (Vector3::zeros(), 0.0);
        };
        let home = finger * stuck * thing.inverse();
        let back = (home * Point3::from(*point)).coords - point;
        let spin = home.rotation.scaled_axis().dot(normal);
        (
            (back - normal * back.dot(normal)) * RETURN_RATE,
            spin * RETURN_RATE,
        )
    }
}
