//! Where instruments, things and ground meet in a step, and what wakes.
//!
//! The order of contacts is fixed, which repeatable runs need: for each thing its contacts with the
//! instruments and, if it is awake, with the ground, hard before soft; then each instrument's with
//! the ground. Contacts are looked for within 0.3 mm plus the distance that both sides travel in 2
//! ms; a contact whose gap does not close gets no force.

use nalgebra::Vector3;
use rapier3d_f64::math::Pose as EnginePose;

use super::{PARTS, Stage};
use crate::world::arm::{ArmUnit, PartPoses};
use crate::world::config::Surface;
use crate::world::contact::{Contact, Side};
use crate::world::convert::{engine_pose, our_vector};
use crate::world::detect::{First, Found};
use crate::world::scenery::CollisionMask;
use crate::world::shapes::WRIST_RADIUS_M;
use crate::world::soft;

/// Distance at which surfaces that stand still are looked at, m.
const REACH_M: f64 = 3e-4;
/// Time for which surfaces that move are looked at beforehand, s.
const REACH_S: f64 = 2e-3;
/// Distance of an instrument at which a thing wakes, m.
const WAKE_M: f64 = 2e-3;

impl Stage {
    /// Finds the contacts of a step, and wakes things that an instrument is near.
    pub(super) fn find_contacts(&mut self, arms: &[ArmUnit], poses: &[PartPoses]) {
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
    ///
    /// The grip's memory, of where a thing stuck to this part, turns into the contact's homing and
    /// spin.
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
                    if *meets == CollisionMask::Ground {
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
                        [Side::Part { arm, part }, Side::RigidBody(index)],
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
    ///
    /// Only the thing's pieces with [`CollisionMask::Ground`] meet soft ground, each as a ball.
    fn meet_ground(&mut self, index: usize) {
        let thing = &self.things[index];
        let pose = thing.moving.pose;
        let carrier = engine_pose(&pose);
        let reach_m = REACH_M + REACH_S * thing.moving.speed_m_s();
        let sides = [Side::Ground, Side::RigidBody(index)];
        self.detector.clear();
        for solid in &self.solids {
            let first = First::new(solid, &EnginePose::IDENTITY);
            let relative = first.relative(&carrier);
            for (piece, meets) in &thing.pieces {
                if *meets != CollisionMask::Instrument {
                    self.detector.pair(&first, piece, &relative, reach_m);
                }
            }
        }
        self.detector.reduce();
        let found = self.detector.found.iter();
        self.contacts
            .extend(found.map(|found| contact(sides, found, &self.hard[0])));
        if let Some([surface, _]) = &self.soft {
            for (piece, meets) in &thing.pieces {
                if *meets == CollisionMask::Ground {
                    let centre = our_vector(carrier.transform_point(piece.centre));
                    let met = soft::meet(&self.ground, &centre, piece.radius_m, reach_m);
                    self.contacts
                        .extend(met.map(|found| contact(sides, &found, surface)));
                }
            }
        }
    }

    /// Contacts of an instrument and the ground.
    ///
    /// Sample points of each part meet soft ground: bare points of the fingers, balls of the
    /// wrist's radius at both its ends.
    fn press_ground(&mut self, arm: usize, poses: &PartPoses, reach_m: f64) {
        for (part, pose) in poses.iter().enumerate() {
            let sides = [Side::Ground, Side::Part { arm, part }];
            self.detector.clear();
            let carrier = engine_pose(pose);
            for solid in &self.solids {
                let first = First::new(solid, &EnginePose::IDENTITY);
                let relative = first.relative(&carrier);
                self.detector
                    .pair(&first, &self.parts[part], &relative, reach_m);
            }
            self.detector.reduce();
            let found = self.detector.found.iter();
            self.contacts
                .extend(found.map(|found| contact(sides, found, &self.hard[1])));
            if let Some([_, surface]) = &self.soft {
                let radius_m = if part == PARTS - 1 {
                    WRIST_RADIUS_M
                } else {
                    0.0
                };
                let met = self.samples[part].iter().filter_map(|point| {
                    soft::meet(&self.ground, &(pose * point).coords, radius_m, reach_m)
                });
                self.contacts
                    .extend(met.map(|found| contact(sides, &found, surface)));
            }
        }
    }
}

/// A contact without memory: friction aims at rest.
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
