//! What a step's contacts did: what instruments and things felt, and what the fingers remember.

use hal::TICK_S;
use nalgebra::{Point3, Vector3};

use super::{PARTS, Stage};
use crate::world::arm::ArmUnit;
use crate::world::contact::{Contact, Side};

/// Least force that counts as touching, N.
pub(in crate::world) const TOUCH_N: f64 = 1e-3;

/// What one part of the instrument feels of one thing.
#[derive(Clone, Copy, Debug)]
pub(in crate::world) struct Touch {
    /// Sum of the normal forces, N.
    pub(in crate::world) force_n: f64,
    /// Deepest overlap, m.
    pub(in crate::world) penetration_m: f64,
    /// Sum of the contact points weighed by their forces, N m; the force's share is the middle of
    /// the touch.
    weighed_points: Vector3<f64>,
}

impl Touch {
    pub(super) const NONE: Self = Self {
        force_n: 0.0,
        penetration_m: 0.0,
        weighed_points: Vector3::new(0.0, 0.0, 0.0),
    };

    /// The middle of the touch in the scene, if there is one.
    pub(super) fn middle(&self) -> Option<Point3<f64>> {
        (self.force_n > TOUCH_N).then(|| Point3::from(self.weighed_points / self.force_n))
    }

    pub(super) fn add(&mut self, contact: &Contact, force_n: f64, gap_m: f64) {
        self.force_n += force_n;
        self.weighed_points += contact.point * force_n;
        self.penetration_m = self.penetration_m.max(-gap_m);
    }
}

impl Stage {
    /// Takes in what the step's contacts did.
    pub(super) fn take_in(&mut self, arms: &[ArmUnit]) {
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
            let force_n = row.impulse / TICK_S;
            match contact.sides {
                [Side::Part { arm, part }, Side::RigidBody(thing)] => {
                    let touch = &mut self.instruments[arm].touches[thing][part];
                    touch.add(contact, force_n, row.gap_m);
                }
                [_, Side::Part { arm, .. }] => {
                    let instrument = &mut self.instruments[arm];
                    instrument.ground_n += force_n;
                    instrument.ground_m = instrument.ground_m.max(-row.gap_m);
                }
                [_, Side::RigidBody(thing)] => {
                    let thing = &mut self.things[thing];
                    thing.ground_n += force_n;
                    // Soft ground beside hard one gives way as it should.
                    if self.solids.is_empty() || contact.surface == self.hard[0] {
                        thing.ground_m = thing.ground_m.max(-row.gap_m);
                    }
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
                matches!(contact.sides, [Side::Part { .. }, Side::RigidBody(of)] if of == index)
            });
            if !thing.moving.is_asleep() {
                thing.moving.rest(is_near, TICK_S);
            }
        }
    }
}
