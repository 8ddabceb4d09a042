//! A millisecond of the rigid world: finds contacts, and solves drives, things and contacts together in every sub-step.
//!
//! What is near nothing is not solved: an arm in the air is its drives alone, and a thing that lies still sleeps.

use nalgebra::{Point3, Vector3};

use super::arm::{ArmUnit, PartPoses};
use super::config::{Surface, WorldConfig};
use super::contact::{Contact, Row, Side, THING_DOF, frame};
use super::convert::{engine_pose, our_vector};
use super::detect::{Detector, First, Found};
use super::newton::{Axis, Masses, Newton};
use super::scenery::{Ground, Meets, Scenery};
use super::shapes::{Body, WRIST_RADIUS_M, instrument, sample_points};
use super::soft;
use super::stick::Memory;
use super::thing::Moving;
use crate::plant::AXIS_COUNT;

/// Least force that counts as touching, N.
pub(super) const TOUCH_N: f64 = 1e-3;
/// Distance at which surfaces that stand still are looked at, m.
const REACH_M: f64 = 3e-4;
/// Time for which surfaces that move are looked at beforehand, s.
const REACH_S: f64 = 2e-3;
/// Distance of an instrument at which a thing wakes, m.
const WAKE_M: f64 = 2e-3;
/// Length of a step, s.
const STEP_S: f64 = 1e-3;
const PARTS: usize = 3;

/// What one part of the instrument feels of one thing.
#[derive(Clone, Copy, Debug)]
pub(super) struct Touch {
    /// Sum of the normal forces, N.
    pub(super) force_n: f64,
    /// Deepest overlap, m.
    pub(super) penetration_m: f64,
    /// Sum of the contact points weighed by their forces, N m; the force's share is the middle of the touch.
    weighed_points: Vector3<f64>,
}

impl Touch {
    const NONE: Self = Self {
        force_n: 0.0,
        penetration_m: 0.0,
        weighed_points: Vector3::new(0.0, 0.0, 0.0),
    };

    /// The middle of the touch in the scene, if there is one.
    fn middle(&self) -> Option<Point3<f64>> {
        (self.force_n > TOUCH_N).then(|| Point3::from(self.weighed_points / self.force_n))
    }

    fn add(&mut self, contact: &Contact, force_n: f64, gap_m: f64) {
        self.force_n += force_n;
        self.weighed_points += contact.point * force_n;
        self.penetration_m = self.penetration_m.max(-gap_m);
    }
}

/// What one arm's instrument knows of the things and the ground.
struct Instrument {
    /// What left and right finger remember of each thing.
    memories: Vec<[Memory; 2]>,
    /// What the parts felt of each thing in the newest step, in the order of [`PartPoses`].
    touches: Vec<[Touch; PARTS]>,
    /// Sum of the normal forces of the ground on the parts in the newest step, N.
    ground_n: f64,
    /// Deepest overlap of a part and the ground, m.
    ground_m: f64,
}

/// A thing with what it meets others with.
struct ThingOnStage {
    moving: Moving,
    pieces: Vec<(Body, Meets)>,
    /// Sum of the normal forces of the ground in the newest step, N.
    ground_n: f64,
    /// Deepest overlap with the ground, m.
    ground_m: f64,
}

/// Everything rigid but the arms' drives.
pub(super) struct Stage {
    grip: Surface,
    ground_surface: Surface,
    press: Surface,
    gravity: Vector3<f64>,
    ground: Ground,
    solids: Vec<Body>,
    parts: [Body; PARTS],
    samples: [Vec<Point3<f64>>; PARTS],
    instruments: Vec<Instrument>,
    things: Vec<ThingOnStage>,
    detector: Detector,
    contacts: Vec<Contact>,
    rows: Vec<Row>,
    masses: Masses,
    newton: Newton,
}

impl Stage {
    /// The things, the ground and one instrument for each of `arm_count` arms.
    pub(super) fn new(config: &WorldConfig, scenery: &Scenery, arm_count: usize) -> Self {
        let solids = match &scenery.ground {
            Ground::Organ(_) | Ground::Bed(_) => Vec::new(),
            Ground::Solids(solids) => solids.iter().map(Body::of).collect(),
        };
        let things = scenery.things.iter().map(|thing| ThingOnStage {
            moving: Moving::new(thing),
            pieces: thing
                .pieces
                .iter()
                .map(|piece| (Body::of(&piece.shape), piece.meets))
                .collect(),
            ground_n: 0.0,
            ground_m: 0.0,
        });
        let things: Vec<_> = things.collect();
        let instruments = (0..arm_count).map(|_| Instrument {
            memories: vec![[Memory::default(); 2]; things.len()],
            touches: vec![[Touch::NONE; PARTS]; things.len()],
            ground_n: 0.0,
            ground_m: 0.0,
        });
        Self {
            grip: config.grip,
            ground_surface: config.ground,
            press: config.press,
            gravity: Vector3::new(0.0, 0.0, -config.gravity_m_s2),
            ground: scenery.ground.clone(),
            solids,
            parts: instrument(),
            samples: core::array::from_fn(sample_points),
            instruments: instruments.collect(),
            things,
            detector: Detector::default(),
            contacts: Vec::new(),
            rows: Vec::new(),
            masses: Masses::default(),
            newton: Newton::default(),
        }
    }

    /// Advances one millisecond, drives included.
    pub(super) fn step(&mut self, arms: &mut [ArmUnit]) {
        let poses: Vec<PartPoses> = arms.iter().map(ArmUnit::part_poses).collect();
        self.find_contacts(arms, &poses);
        let coupled: Vec<usize> = (0..arms.len())
            .filter(|&arm| self.touches_arm(arm))
            .collect();
        for (index, arm) in arms.iter_mut().enumerate() {
            if !coupled.contains(&index) {
                arm.drive();
            }
        }
        let awake: Vec<usize> = (0..self.things.len())
            .filter(|&thing| !self.things[thing].moving.is_asleep())
            .collect();
        if !(coupled.is_empty() && awake.is_empty()) {
            self.solve(arms, &coupled, &awake);
        }
        for &arm in &coupled {
            arms[arm].follow();
        }
        self.take_in(arms);
    }

    /// What the parts of an arm felt of one thing in the newest step.
    pub(super) fn touch(&self, arm: usize, thing: usize) -> &[Touch; PARTS] {
        &self.instruments[arm].touches[thing]
    }

    /// Sum of the normal forces of the ground on the parts of an arm in the newest step, N.
    pub(super) fn ground_force_n(&self, arm: usize) -> f64 {
        self.instruments[arm].ground_n
    }

    /// Deepest overlap of a part of an arm's instrument and the ground in the newest step, m.
    #[cfg(test)]
    pub(super) fn part_sunk_m(&self, arm: usize) -> f64 {
        self.instruments[arm].ground_m
    }

    /// Sum of the normal forces of the ground on a thing in the newest step, N.
    pub(super) fn thing_ground_force_n(&self, thing: usize) -> f64 {
        self.things[thing].ground_n
    }

    /// Deepest overlap of a thing and the ground.
    pub(super) fn sunk_m(&self, thing: usize) -> f64 {
        self.things[thing].ground_m
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

    /// A thing in motion.
    pub(super) fn thing(&self, thing: usize) -> &Moving {
        &self.things[thing].moving
    }

    /// Kinetic energy of a thing and its potential energy over the scene's xy-plane, J.
    pub(super) fn energy_j(&self, thing: usize) -> f64 {
        self.things[thing].moving.energy_j(-self.gravity.z)
    }

    /// Throws a thing: linear velocity of its centre of mass, m/s, and angular velocity, rad/s.
    #[cfg(test)]
    pub(super) fn throw(&mut self, thing: usize, velocity: &[Vector3<f64>; 2]) {
        self.things[thing].moving.velocity = *velocity;
        self.wake(thing);
    }

    /// Lets a thing be calculated for as long again as one that just came to lie still.
    #[cfg(test)]
    pub(super) fn wake(&mut self, thing: usize) {
        self.things[thing].moving.wake();
    }

    /// The contacts of the newest step.
    #[cfg(test)]
    pub(super) fn contacts(&self) -> &[Contact] {
        &self.contacts
    }

    /// Changes the friction between instruments and things.
    #[cfg(test)]
    pub(super) const fn set_grip_friction(&mut self, friction: f64) {
        self.grip.friction = friction;
    }

    fn touches_arm(&self, arm: usize) -> bool {
        self.contacts.iter().any(|contact| {
            let mut sides = contact.sides.iter();
            sides.any(|side| matches!(side, Side::Part { arm: of, .. } if *of == arm))
        })
    }

    fn find_contacts(&mut self, arms: &[ArmUnit], poses: &[PartPoses]) {
        self.contacts.clear();
        let speeds: Vec<f64> = arms.iter().map(ArmUnit::tip_speed_m_s).collect();
        for thing in 0..self.things.len() {
            let near = self.meet_instruments(thing, poses, &speeds);
            let moving = &mut self.things[thing].moving;
            if near {
                moving.wake();
            }
            if !moving.is_asleep() {
                self.meet_ground(thing);
            }
        }
        for (arm, parts) in poses.iter().enumerate() {
            self.press_ground(arm, parts, REACH_M + REACH_S * speeds[arm]);
        }
    }

    /// Contacts of a thing and the instruments; whether one of these is near.
    fn meet_instruments(&mut self, index: usize, poses: &[PartPoses], speeds: &[f64]) -> bool {
        let Self {
            things,
            parts,
            detector,
            contacts,
            instruments,
            ..
        } = self;
        let thing = &things[index];
        let pose = thing.moving.pose;
        let carrier = engine_pose(&pose);
        let mut is_near = false;
        for (arm, part_poses) in poses.iter().enumerate() {
            let reach_m = REACH_M + REACH_S * (speeds[arm] + thing.moving.speed_m_s());
            let wake_m = reach_m.max(WAKE_M);
            for (part, body) in parts.iter().enumerate() {
                let first = First::new(body, &engine_pose(&part_poses[part]));
                let relative = first.relative(&carrier);
                detector.clear();
                for (piece, meets) in &thing.pieces {
                    if *meets == Meets::Ground {
                        continue;
                    }
                    let centre = relative.transform_point(piece.centre);
                    if first.is_near(centre, piece.radius_m + wake_m) {
                        is_near = true;
                        detector.pair(&first, piece, &relative, reach_m);
                    }
                }
                detector.reduce();
                let memory = instruments[arm].memories[index].get(part);
                for found in &detector.found {
                    let mut contact = contact(
                        [Side::Part { arm, part }, Side::Thing(index)],
                        found,
                        &self.grip,
                    );
                    if let Some(memory) = memory {
                        let poses = (&part_poses[part], &pose);
                        (contact.homing, contact.spin) =
                            memory.homing(poses, &found.point, &found.normal);
                    }
                    contacts.push(contact);
                }
            }
        }
        is_near
    }

    /// Contacts of a thing and the ground.
    fn meet_ground(&mut self, index: usize) {
        let thing = &self.things[index];
        let pose = thing.moving.pose;
        let carrier = engine_pose(&pose);
        let reach_m = REACH_M + REACH_S * thing.moving.speed_m_s();
        let sides = [Side::Ground, Side::Thing(index)];
        self.detector.clear();
        for solid in &self.solids {
            let first = First::new(solid, &rapier3d_f64::math::Pose::IDENTITY);
            let relative = first.relative(&carrier);
            for (piece, meets) in &thing.pieces {
                if *meets != Meets::Instrument {
                    self.detector.pair(&first, piece, &relative, reach_m);
                }
            }
        }
        self.detector.reduce();
        if self.solids.is_empty() {
            for (piece, meets) in &thing.pieces {
                if *meets != Meets::Instrument {
                    let centre = our_vector(carrier.transform_point(piece.centre));
                    let met = soft::meet(&self.ground, &centre, piece.radius_m, reach_m);
                    self.detector.found.extend(met);
                }
            }
        }
        let found = self.detector.found.iter();
        self.contacts
            .extend(found.map(|found| contact(sides, found, &self.ground_surface)));
    }

    /// Contacts of an instrument and the ground.
    fn press_ground(&mut self, arm: usize, poses: &PartPoses, reach_m: f64) {
        for (part, pose) in poses.iter().enumerate() {
            let sides = [Side::Ground, Side::Part { arm, part }];
            self.detector.clear();
            if self.solids.is_empty() {
                let radius_m = if part == PARTS - 1 {
                    WRIST_RADIUS_M
                } else {
                    0.0
                };
                let points = self.samples[part].iter();
                let met = points.filter_map(|point| {
                    soft::meet(&self.ground, &(pose * point).coords, radius_m, reach_m)
                });
                self.detector.found.extend(met);
            } else {
                let carrier = engine_pose(pose);
                for solid in &self.solids {
                    let first = First::new(solid, &rapier3d_f64::math::Pose::IDENTITY);
                    let relative = first.relative(&carrier);
                    self.detector
                        .pair(&first, &self.parts[part], &relative, reach_m);
                }
                self.detector.reduce();
            }
            let found = self.detector.found.iter();
            self.contacts
                .extend(found.map(|found| contact(sides, found, &self.press)));
        }
    }

    /// Solves the sub-steps of the arms `coupled` and the things `awake`.
    fn solve(&mut self, arms: &mut [ArmUnit], coupled: &[usize], awake: &[usize]) {
        let inertias: Vec<_> = awake
            .iter()
            .map(|&thing| self.things[thing].moving.inertia_in_scene())
            .collect();
        let substeps = arms.first().map_or(SUBSTEPS_ALONE, ArmUnit::substeps);
        let step_s = STEP_S / f64::from(substeps);
        let drives = AXIS_COUNT * coupled.len();
        for substep in 0..substeps {
            self.masses.drives.clear();
            for &arm in coupled {
                let free = arms[arm].begin(step_s);
                self.masses.drives.extend((0..AXIS_COUNT).map(|axis| Axis {
                    free: free.velocity[axis],
                    inertia: free.inertia[axis],
                    dry: free.stuck[axis] * free.inertia[axis],
                }));
            }
            self.masses.things.clear();
            for (&thing, inertia) in awake.iter().zip(&inertias) {
                let moving = &self.things[thing].moving;
                let free = moving.free(inertia, &self.gravity, step_s);
                self.masses.things.push(free);
            }
            if substep == 0 {
                self.make_rows(arms, (coupled, awake), &inertias);
            }
            let velocity = &mut self.newton.velocity;
            velocity.clear();
            for &arm in coupled {
                velocity.extend_from_slice(arms[arm].velocities());
            }
            for &thing in awake {
                let [linear, angular] = &self.things[thing].moving.velocity;
                velocity.extend_from_slice(linear.as_slice());
                velocity.extend_from_slice(angular.as_slice());
            }
            self.newton.solve(&self.masses, &mut self.rows, step_s);
            let found = &self.newton.velocity;
            for (slot, &arm) in coupled.iter().enumerate() {
                let at = AXIS_COUNT * slot;
                let velocity = core::array::from_fn(|axis| found[at + axis]);
                arms[arm].finish(&velocity, step_s);
            }
            for (slot, &thing) in awake.iter().enumerate() {
                let at = drives + THING_DOF * slot;
                self.things[thing].moving.advance(&found[at..], step_s);
            }
        }
    }

    /// The contacts with their Jacobians, which hold for the whole step.
    fn make_rows(
        &mut self,
        arms: &[ArmUnit],
        (coupled, awake): (&[usize], &[usize]),
        inertias: &[[nalgebra::Matrix3<f64>; 2]],
    ) {
        self.rows.clear();
        for (number, contact) in self.contacts.iter().enumerate() {
            let axes = frame(&contact.normal);
            let (mut arm, mut thing) = (None, None);
            let mut mobility = 0.0;
            for (side, sign) in contact.sides.iter().zip([-1.0, 1.0]) {
                match *side {
                    Side::Ground => {}
                    Side::Part { arm: of, part } => {
                        let Some(slot) = coupled.iter().position(|&arm| arm == of) else {
                            continue;
                        };
                        let rows = arms[of].jacobian(part, &contact.point, &axes);
                        let patch_m = contact.surface.patch_m;
                        let scales = [sign, sign, sign, sign * patch_m];
                        let mut scale = scales.into_iter();
                        let rows = rows.map(|row| {
                            let scale = scale.next().unwrap_or_default();
                            row.map(|entry| scale * entry)
                        });
                        let drives = &self.masses.drives[AXIS_COUNT * slot..];
                        for row in &rows[1..3] {
                            for (entry, drive) in row.iter().zip(drives) {
                                mobility += 0.5 * entry * entry / drive.inertia;
                            }
                        }
                        arm = Some((slot, rows));
                    }
                    Side::Thing(of) => {
                        let Some(slot) = awake.iter().position(|&thing| thing == of) else {
                            continue;
                        };
                        let moving = &self.things[of].moving;
                        let lever = contact.point - moving.centre();
                        let row = |push: Vector3<f64>, turn: Vector3<f64>| {
                            [push.x, push.y, push.z, turn.x, turn.y, turn.z]
                        };
                        let [n, t, u] =
                            axes.map(|axis| row(axis * sign, lever.cross(&axis) * sign));
                        let spin = axes[0] * (sign * contact.surface.patch_m);
                        let rows = [n, t, u, row(Vector3::zeros(), spin)];
                        for axis in &axes[1..] {
                            mobility += 0.5 * moving.mobility(&inertias[slot][1], &lever, axis);
                        }
                        thing = Some((slot, rows));
                    }
                }
            }
            self.rows
                .push(Row::new((number, contact), &axes, arm, thing, mobility));
        }
    }

    /// Takes in what the step's contacts did.
    fn take_in(&mut self, arms: &[ArmUnit]) {
        for instrument in &mut self.instruments {
            instrument.touches.fill([Touch::NONE; PARTS]);
            instrument.ground_n = 0.0;
            instrument.ground_m = 0.0;
        }
        for thing in &mut self.things {
            if !thing.moving.is_asleep() {
                thing.ground_n = 0.0;
                thing.ground_m = 0.0;
            }
        }
        for row in &self.rows {
            let contact = &self.contacts[row.contact];
            let force_n = row.impulse / STEP_S;
            match contact.sides {
                [Side::Part { arm, part }, Side::Thing(thing)] => {
                    let touch = &mut self.instruments[arm].touches[thing][part];
                    touch.add(contact, force_n, row.gap_m);
                }
                [_, Side::Part { arm, .. }] => {
                    let instrument = &mut self.instruments[arm];
                    instrument.ground_n += force_n;
                    instrument.ground_m = instrument.ground_m.max(-row.gap_m);
                }
                [_, Side::Thing(thing)] => {
                    let thing = &mut self.things[thing];
                    thing.ground_n += force_n;
                    thing.ground_m = thing.ground_m.max(-row.gap_m);
                }
                [_, Side::Ground] => {}
            }
        }
        self.rows.clear();
        for (arm, instrument) in arms.iter().zip(&mut self.instruments) {
            let poses = arm.part_poses();
            for (thing, touches) in instrument.touches.iter().enumerate() {
                let pose = &self.things[thing].moving.pose;
                for (side, memory) in instrument.memories[thing].iter_mut().enumerate() {
                    memory.update(&poses[side], pose, touches[side].middle());
                }
            }
        }
        for (index, thing) in self.things.iter_mut().enumerate() {
            let is_near = self.contacts.iter().any(|contact| {
                matches!(contact.sides, [Side::Part { .. }, Side::Thing(of)] if of == index)
            });
            if !thing.moving.is_asleep() {
                thing.moving.rest(is_near, STEP_S);
            }
        }
    }
}

/// Sub-steps of a world without arms.
const SUBSTEPS_ALONE: u32 = 4;

fn contact(sides: [Side; 2], found: &Found, surface: &Surface) -> Contact {
    Contact {
        sides,
        point: found.point,
        normal: found.normal,
        gap_m: found.gap_m,
        surface: *surface,
        homing: Vector3::zeros(),
        spin: 0.0,
    }
}
