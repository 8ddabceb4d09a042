//! A rigid body that moves: pose, velocity, and whether it sleeps.

use hal::Pose;
use nalgebra::{Matrix3, Point3, Translation3, UnitQuaternion, Vector3};

use super::contact::THING_DOF;
use super::newton::ThingMass;
use super::scenery::RigidBody;
use super::shapes::Body;

/// A thing near which no instrument is falls asleep once no point of it has been faster than this,
/// m/s, for 0.1 s; it then stays where it is to the bit until an instrument comes near. A slide
/// slower than that ends there.
pub const REST_M_S: f64 = 2e-5;
/// How long it lies that still before it falls asleep, s.
const REST_S: f64 = 0.1;

/// A rigid body in motion.
pub(super) struct Moving {
    /// The thing's frame in the scene.
    pub(super) pose: Pose,
    /// Velocity of the centre of mass, m/s, and angular velocity, rad/s, scene frame.
    pub(super) velocity: [Vector3<f64>; 2],
    mass_kg: f64,
    /// Centre of mass in the thing's frame.
    centre: Point3<f64>,
    /// Inertia about the centre of mass in the thing's frame, kg m².
    inertia: Matrix3<f64>,
    inverse_inertia: Matrix3<f64>,
    /// Greatest distance of a point of it from the centre of mass, m.
    pub(super) extent_m: f64,
    still_s: f64,
    asleep: bool,
}

impl Moving {
    pub(super) fn new(thing: &RigidBody) -> Self {
        let turn = thing.axes.to_rotation_matrix().into_inner();
        let inertia = turn * Matrix3::from_diagonal(&thing.inertia) * turn.transpose();
        let inverse = thing.inertia.map(|moment| 1.0 / moment);
        let inverse_inertia = turn * Matrix3::from_diagonal(&inverse) * turn.transpose();
        let reach = thing.pieces.iter().map(|piece| {
            let body = Body::of(&piece.shape);
            let centre = Point3::from(super::convert::our_vector(body.centre));
            (centre - thing.centre).norm() + body.radius_m
        });
        Self {
            pose: thing.in_scene,
            velocity: [Vector3::zeros(); 2],
            mass_kg: thing.mass_kg,
            centre: thing.centre,
            inertia,
            inverse_inertia,
            extent_m: reach.fold(0.0, f64::max),
            still_s: 0.0,
            asleep: false,
        }
    }

    /// The centre of mass in the scene.
    pub(super) fn centre(&self) -> Vector3<f64> {
        (self.pose * self.centre).coords
    }

    /// Inertia about the centre of mass in the scene and its inverse.
    pub(super) fn inertia_in_scene(&self) -> [Matrix3<f64>; 2] {
        let turn = self.pose.rotation.to_rotation_matrix().into_inner();
        [&self.inertia, &self.inverse_inertia].map(|inertia| turn * inertia * turn.transpose())
    }

    /// Its row of the mass matrix for a sub-step of `step_s` in which only `gravity` (m/s²) acts,
    /// with the inertia `in_scene` and its inverse.
    pub(super) fn free(
        &self,
        [inertia, inverse]: &[Matrix3<f64>; 2],
        gravity: &Vector3<f64>,
        step_s: f64,
    ) -> ThingMass {
        let [linear, angular] = &self.velocity;
        let linear = linear + gravity * step_s;
        let angular = angular - inverse * angular.cross(&(inertia * angular)) * step_s;
        let mut free = [0.0; THING_DOF];
        for axis in 0..3 {
            free[axis] = linear[axis];
            free[3 + axis] = angular[axis];
        }
        ThingMass {
            mass_kg: self.mass_kg,
            inertia: *inertia,
            free,
        }
    }

    /// Mobility of the point at `arm` from the centre of mass along `direction`, 1/kg.
    pub(super) fn mobility(
        &self,
        inverse: &Matrix3<f64>,
        arm: &Vector3<f64>,
        direction: &Vector3<f64>,
    ) -> f64 {
        let turn = arm.cross(direction);
        1.0 / self.mass_kg + turn.dot(&(inverse * turn))
    }

    /// Goes on for `step_s` with the velocities `v`.
    pub(super) fn advance(&mut self, v: &[f64], step_s: f64) {
        let linear = Vector3::new(v[0], v[1], v[2]);
        let angular = Vector3::new(v[3], v[4], v[5]);
        let centre = self.centre() + linear * step_s;
        let turn = UnitQuaternion::from_scaled_axis(angular * step_s);
        let mut rotation = turn * self.pose.rotation;
        rotation.renormalize_fast();
        let origin = centre - rotation * self.centre.coords;
        self.pose = Pose::from_parts(Translation3::from(origin), rotation);
        self.velocity = [linear, angular];
    }

    /// Greatest speed of any point of it, at most, m/s.
    pub(super) fn speed_m_s(&self) -> f64 {
        self.velocity[0].norm() + self.velocity[1].norm() * self.extent_m
    }

    /// Kinetic energy, and potential energy over the scene's xy-plane under `gravity_m_s2`, J.
    pub(super) fn energy_j(&self, gravity_m_s2: f64) -> f64 {
        let [linear, angular] = &self.velocity;
        let [inertia, _] = self.inertia_in_scene();
        let moving = 0.5 * self.mass_kg * linear.norm_squared();
        let turning = 0.5 * angular.dot(&(inertia * angular));
        moving + turning + self.mass_kg * gravity_m_s2 * self.centre().z
    }

    /// Counts `step_s` without motion, unless an instrument is near.
    pub(super) fn rest(&mut self, is_near: bool, step_s: f64) {
        if is_near || self.speed_m_s() > REST_M_S {
            self.wake();
            return;
        }
        self.still_s += step_s;
        if self.still_s >= REST_S {
            self.asleep = true;
            self.velocity = [Vector3::zeros(); 2];
        }
    }

    pub(super) const fn wake(&mut self) {
        self.asleep = false;
        self.still_s = 0.0;
    }

    pub(super) const fn is_asleep(&self) -> bool {
        self.asleep
    }

    /// Every number that decides the future, for hashing.
    pub(super) fn state(&self) -> [f64; 15] {
        let q = self.pose.rotation.quaternion().coords;
        let t = self.pose.translation.vector;
        let [linear, angular] = self.velocity;
        let asleep = f64::from(u8::from(self.asleep));
        [
            q.x,
            q.y,
            q.z,
            q.w,
            t.x,
            t.y,
            t.z,
            linear.x,
            linear.y,
            linear.z,
            angular.x,
            angular.y,
            angular.z,
            asleep,
            self.still_s,
        ]
    }
}
