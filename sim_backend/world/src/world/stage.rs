//! A millisecond of the rigid world: finds contacts, and solves drives, things and contacts
//! together in every sub-step.
//!
//! Only bodies in or near contact are solved: an arm in the air is its drives alone, and a resting
//! thing sleeps.

mod find;
mod rows;
mod taken;

use hal::TICK_S;
use nalgebra::{Point3, Vector3};

use super::arm::{ArmUnit, PartPoses};
use super::config::{Surface, WorldConfig};
use super::contact::{Contact, Row, Side, THING_DOF};
use super::detect::Detector;
use super::newton::{Axis, Masses, Newton};
use super::scenery::{CollisionMask, Ground, Scenery};
use super::shapes::{Body, instrument, sample_points};
use super::stick::Memory;
use super::thing::Moving;
use crate::plant::AXIS_COUNT;

pub(super) use taken::{TOUCH_N, Touch};

const PARTS: usize = 3;

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
    pieces: Vec<(Body, CollisionMask)>,
    /// Sum of the normal forces of the ground in the newest step, N.
    ground_n: f64,
    /// Deepest overlap with the ground, m; where some of that is hard, with the hard ground alone.
    ground_m: f64,
}

/// Everything rigid but the arms' drives.
pub(super) struct Stage {
    grip: Surface,
    /// Contact of hard ground with things and with instruments.
    hard: [Surface; 2],
    /// Contact of soft ground with things and with instruments, if there is any.
    soft: Option<[Surface; 2]>,
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
            Ground::Solids(solids) | Ground::OrganWithSolids(_, solids) => {
                solids.iter().map(Body::of).collect()
            }
        };
        let (hard, soft) = ([config.ground, config.press], soft_contact(config, scenery));
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
            hard,
            soft,
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
    pub(super) fn throw(&mut self, thing: usize, velocity: &[Vector3<f64>; 2]) {
        let moving = &mut self.things[thing].moving;
        moving.velocity = *velocity;
        moving.wake();
    }

    /// Wakes a sleeping thing, for as long as one that just came to rest stays awake.
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

    /// Solves the sub-steps of the arms `coupled` and the things `awake`.
    fn solve(&mut self, arms: &mut [ArmUnit], coupled: &[usize], awake: &[usize]) {
        let inertias: Vec<_> = awake
            .iter()
            .map(|&thing| self.things[thing].moving.inertia_in_scene())
            .collect();
        let substeps = arms.first().map_or(SUBSTEPS_ALONE, ArmUnit::substeps);
        let step_s = TICK_S / f64::from(substeps);
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
}

/// Contact of soft ground with things and with instruments; none where all ground is hard.
fn soft_contact(config: &WorldConfig, scenery: &Scenery) -> Option<[Surface; 2]> {
    match &scenery.ground {
        Ground::Organ(_) | Ground::Bed(_) => Some([config.ground, config.press]),
        Ground::OrganWithSolids(soft, _) => Some([soft.ground, soft.press]),
        Ground::Solids(_) => None,
    }
}

/// Sub-steps of a world without arms.
const SUBSTEPS_ALONE: u32 = 4;
