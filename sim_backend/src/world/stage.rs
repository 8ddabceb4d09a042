//! The physics engine's side of the world: steps it, and reads what the instruments feel.

use hal::Pose;
use nalgebra::{Point3, Vector3};
use rapier3d_f64::dynamics::{
    FrictionModel, IntegrationParameters, RigidBodyHandle, SpringCoefficients,
};
use rapier3d_f64::geometry::{ColliderHandle, ContactPair};
use rapier3d_f64::pipeline::PhysicsWorld;

use super::chain::Wrench;
use super::config::WorldConfig;
use super::contacts::is_solved;
use super::convert::{engine_pose, engine_vector, our_pose, our_vector};
use super::scenery::Scenery;
use super::solids::{Part, finger, insert_ground, insert_part, insert_thing, wrist};
use super::stick::{Memory, Recall};

/// Least force that counts as touching, N.
pub(super) const TOUCH_N: f64 = 1e-3;

/// What one part of the instrument feels of one thing.
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

/// The instrument of one arm in the engine.
struct Instrument {
    parts: [Part; 3],
    poses: PartPoses,
    /// What left and right finger remember of each thing.
    memories: Vec<[Memory; 2]>,
    /// What the parts felt of each thing in the newest step, in the order of [`PartPoses`].
    touches: Vec<[Touch; 3]>,
}

/// The engine with everything in it.
pub(super) struct Stage {
    engine: PhysicsWorld,
    instruments: Vec<Instrument>,
    things: Vec<RigidBodyHandle>,
}

impl Stage {
    /// The things, the ground and one instrument for each of `arms`.
    pub(super) fn new(config: &WorldConfig, scenery: &Scenery, arms: &[PartPoses]) -> Self {
        let mut engine = PhysicsWorld::new();
        engine.gravity = engine_vector(&Vector3::new(0.0, 0.0, -config.gravity_m_s2));
        engine.integration_parameters = parameters(config);
        // The order of insertion is part of the physics: things, ground, instruments.
        let things: Vec<_> = scenery
            .things
            .iter()
            .map(|thing| insert_thing(&mut engine, config, thing))
            .collect();
        insert_ground(&mut engine, config, &scenery.ground);
        let instruments = arms
            .iter()
            .map(|poses| Instrument::new(&mut engine, config, poses, things.len()))
            .collect();
        Self {
            engine,
            instruments,
            things,
        }
    }

    /// Moves the instruments within one step and lets the things follow, except those that lie still with no instrument
    /// near them: they stay as they are. Each arm gives the poses of its parts and the
    /// point about which moments are then taken.
    pub(super) fn step(&mut self, arms: impl Iterator<Item = (PartPoses, Vector3<f64>)>) {
        let before: Vec<Pose> = (0..self.things.len())
            .map(|thing| self.thing_in_scene(thing))
            .collect();
        let mut recall = Recall::default();
        let mut centres = Vec::with_capacity(self.instruments.len());
        for (instrument, (poses, centre)) in self.instruments.iter_mut().zip(arms) {
            instrument.remember(&mut recall, &self.things, &before);
            instrument.go(&mut self.engine, &poses);
            centres.push(centre);
        }
        self.engine.step_with_events(&recall, &());
        self.wake_what_is_near();
        for thing in 0..self.things.len() {
            let pose = self.thing_in_scene(thing);
            for (arm, centre) in centres.iter().enumerate() {
                let parts = self.instruments[arm].parts.each_ref();
                let touches = parts.map(|part| self.touch_of(part.collider, thing, centre));
                self.instruments[arm].take_in(thing, &pose, touches);
            }
        }
    }

    /// What the parts of an arm felt of each thing in the newest step.
    pub(super) fn touches(&self, arm: usize) -> impl Iterator<Item = &[Touch; 3]> {
        self.instruments[arm].touches.iter()
    }

    /// What the parts of an arm felt of one thing in the newest step.
    pub(super) fn touch(&self, arm: usize, thing: usize) -> &[Touch; 3] {
        &self.instruments[arm].touches[thing]
    }

    /// Where the fingers remember the things, for hashing.
    pub(super) fn memory_numbers(&self) -> impl Iterator<Item = f64> + '_ {
        self.instruments
            .iter()
            .flat_map(|instrument| instrument.memories.iter().flatten())
            .filter_map(|memory| memory.finger_from_thing)
            .flat_map(|pose| {
                let q = pose.rotation.quaternion().coords;
                let t = pose.translation.vector;
                [t.x, t.y, t.z, q.x, q.y, q.z, q.w]
            })
    }

    pub(super) const fn thing_count(&self) -> usize {
        self.things.len()
    }

    pub(super) fn thing_in_scene(&self, thing: usize) -> Pose {
        self.engine
            .bodies
            .get(self.things[thing])
            .map_or_else(Pose::identity, |body| our_pose(body.position()))
    }

    /// Linear and angular velocity of a thing.
    pub(super) fn thing_velocity(&self, thing: usize) -> [Vector3<f64>; 2] {
        let velocity = self
            .engine
            .bodies
            .get(self.things[thing])
            .map(|body| [body.linvel(), body.angvel()]);
        velocity.map_or_else(|| [Vector3::zeros(); 2], |pair| pair.map(our_vector))
    }

    /// Whether a thing lies so still that it is not calculated, and for how long it has been still, s.
    pub(super) fn thing_rest(&self, thing: usize) -> (bool, f64) {
        let rest = self.engine.bodies.get(self.things[thing]).map(|body| {
            let activation = body.activation();
            (activation.sleeping, activation.time_since_can_sleep)
        });
        rest.unwrap_or_default()
    }

    /// Kinetic energy of a thing and its potential energy over the scene's xy-plane, J.
    pub(super) fn energy_j(&self, thing: usize) -> f64 {
        self.engine.bodies.get(self.things[thing]).map_or(0.0, |b| {
            b.kinetic_energy() - b.mass() * self.engine.gravity.dot(b.center_of_mass())
        })
    }

    /// Throws a thing: linear velocity of its centre of mass, m/s, and angular velocity, rad/s.
    pub(super) fn throw(&mut self, thing: usize, velocity: &[Vector3<f64>; 2]) {
        if let Some(body) = self.engine.bodies.get_mut(self.things[thing]) {
            body.set_linvel(engine_vector(&velocity[0]), true);
            body.set_angvel(engine_vector(&velocity[1]), true);
        }
    }

    /// Lets a thing be calculated for as long again as one that just came to lie still.
    #[cfg(test)]
    pub(super) fn wake(&mut self, thing: usize) {
        if let Some(body) = self.engine.bodies.get_mut(self.things[thing]) {
            body.wake_up(true);
        }
    }

    /// Where the contacts of the newest step were solved that an instrument has a part in, for each pair of faces on the
    /// first one's surface.
    #[cfg(test)]
    pub(super) fn instrument_contacts(&self) -> Vec<Vec<Vector3<f64>>> {
        let pairs = self.engine.narrow_phase.contact_pairs();
        let pairs = pairs.filter(|pair| {
            self.is_instrument(pair.collider1) || self.is_instrument(pair.collider2)
        });
        let manifolds = pairs.flat_map(|pair| pair.solver_manifolds().iter());
        manifolds
            .map(|manifold| {
                let contacts = manifold.data.solver_contacts.iter();
                contacts.map(|c| our_vector(c.anchor1)).collect()
            })
            .collect()
    }

    /// Changes the friction between an arm's fingers and things.
    #[cfg(test)]
    pub(super) fn set_grip_friction(&mut self, arm: usize, friction: f64) {
        use rapier3d_f64::dynamics::CoefficientCombineRule;
        for part in &self.instruments[arm].parts {
            if let Some(collider) = self.engine.colliders.get_mut(part.collider) {
                collider.set_friction(friction);
                collider.set_friction_combine_rule(CoefficientCombineRule::Min);
            }
        }
    }

    /// Deepest overlap of a thing and the ground.
    pub(super) fn sunk_m(&self, thing: usize) -> f64 {
        let Some(body) = self.engine.bodies.get(self.things[thing]) else {
            return 0.0;
        };
        let mut sunk_m: f64 = 0.0;
        for &collider in body.colliders() {
            for pair in self.engine.narrow_phase.contact_pairs_with(collider) {
                if self.is_instrument(pair.collider1) || self.is_instrument(pair.collider2) {
                    continue;
                }
                for point in pair.manifolds().iter().flat_map(|m| &m.points) {
                    sunk_m = sunk_m.max(-point.dist);
                }
            }
        }
        sunk_m
    }

    /// Keeps awake what an instrument may touch: only what lies alone may rest.
    fn wake_what_is_near(&mut self) {
        for part in self.instruments.iter().flat_map(|i| &i.parts) {
            for pair in self.engine.narrow_phase.contact_pairs_with(part.collider) {
                let other = other_of(pair, part.collider);
                let parent = self.engine.colliders.get(other).and_then(|c| c.parent());
                let thing = parent.filter(|body| self.things.contains(body));
                if let Some(body) = thing.and_then(|thing| self.engine.bodies.get_mut(thing)) {
                    body.wake_up(true);
                }
            }
        }
    }

    fn is_instrument(&self, collider: ColliderHandle) -> bool {
        let mut parts = self.instruments.iter().flat_map(|i| &i.parts);
        parts.any(|part| part.collider == collider)
    }

    fn touch_of(&self, part: ColliderHandle, thing: usize, centre: &Vector3<f64>) -> Touch {
        let mut touch = Touch::NONE;
        for pair in self.engine.narrow_phase.contact_pairs_with(part) {
            let other = other_of(pair, part);
            let body = self.engine.colliders.get(other).and_then(|c| c.parent());
            if body == Some(self.things[thing]) {
                self.add_pair(&mut touch, pair, part, centre);
            }
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
            for (index, point) in manifold.points.iter().enumerate() {
                touch.penetration_m = touch.penetration_m.max(-point.dist);
                // What is not solved any more keeps the impulse that it had.
                let solved = is_solved(&manifold.data.solver_contacts, index);
                if solved && point.data.impulse > 0.0 {
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

impl Instrument {
    fn new(
        engine: &mut PhysicsWorld,
        config: &WorldConfig,
        poses: &PartPoses,
        thing_count: usize,
    ) -> Self {
        let shapes = [finger(1.0), finger(-1.0), wrist()];
        let mut index = 0;
        let parts = shapes.map(|shape| {
            let part = insert_part(engine, config, shape, &poses[index]);
            index += 1;
            part
        });
        Self {
            parts,
            poses: *poses,
            memories: vec![[Memory::default(); 2]; thing_count],
            touches: vec![[Touch::NONE; 3]; thing_count],
        }
    }

    /// Tells the step's contacts where the fingers, still at the last step's poses, remember the things.
    fn remember(&self, recall: &mut Recall, things: &[RigidBodyHandle], in_scene: &[Pose]) {
        for ((memories, &thing), pose) in self.memories.iter().zip(things).zip(in_scene) {
            for (side, memory) in memories.iter().enumerate() {
                let finger = (self.parts[side].collider, &self.poses[side]);
                recall.add(finger, (thing, pose), memory);
            }
        }
    }

    fn go(&mut self, engine: &mut PhysicsWorld, poses: &PartPoses) {
        for (part, pose) in self.parts.iter().zip(poses) {
            if let Some(body) = engine.bodies.get_mut(part.body) {
                body.set_next_kinematic_position(engine_pose(pose));
            }
        }
        self.poses = *poses;
    }

    fn take_in(&mut self, thing: usize, in_scene: &Pose, touches: [Touch; 3]) {
        for (side, memory) in self.memories[thing].iter_mut().enumerate() {
            memory.update(&self.poses[side], in_scene, touches[side].middle());
        }
        self.touches[thing] = touches;
    }
}

fn other_of(pair: &ContactPair, one: ColliderHandle) -> ColliderHandle {
    if pair.collider1 == one {
        pair.collider2
    } else {
        pair.collider1
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
