//! The simulated world: arms, things that they can grip, a soft flap, and ground, a millisecond at
//! a time.

mod arm;
mod chain;
mod config;
mod contact;
mod convert;
mod detect;
mod drape;
mod newton;
mod scenery;
mod shapes;
mod soft;
mod stage;
mod stick;
mod thing;

use hal::{ArmCommand, ArmState, Pose, TimeNs};
use nalgebra::Vector3;

use crate::plant::{AxisVector, DriveSetpoint};
use crate::tissue::Tissue;
use arm::ArmUnit;
use drape::Drape;
use stage::{Stage, TOUCH_N};

pub use arm::{ArmBodies, ArmStart};
pub use config::{Surface, WorldConfig};
pub use scenery::{Collider, CollisionMask, Flap, Ground, RigidBody, Scenery, Shape, SoftOrgan};
pub use shapes::FINGER_THICKNESS_M;
pub use thing::REST_M_S;

/// Arms over things on some ground.
///
/// Drives, things and the contacts between instruments, things and ground are solved together, in
/// every sub-step of a millisecond: an instrument that meets something is held up by it as far as
/// its drives give way. (Only a flap's pull reaches the drives a millisecond later; it is soft.)
/// Nothing ever attaches a thing: it is held by friction or not at all.
pub struct World {
    arms: Vec<ArmUnit>,
    stage: Stage,
    drape: Option<Drape>,
}

/// What the fingers of one arm feel of one thing or of the flap.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Grasp {
    /// Sum of normal forces on the left finger, N; of a flap, without the pull of what it holds,
    /// which is along the pads as well.
    pub left_force_n: f64,
    /// The same on the right finger, N.
    pub right_force_n: f64,
    /// Whether both fingers press on the thing; of a flap, whether the jaw holds it.
    pub both_touch: bool,
    /// Deepest overlap of a finger and the thing, m.
    pub penetration_m: f64,
}

impl World {
    /// Arms at rest over `scenery`, whose things and flap must not overlap the fingers.
    #[must_use]
    pub fn new(config: &WorldConfig, scenery: &Scenery, arms: &[ArmStart]) -> Self {
        let arms: Vec<ArmUnit> = arms
            .iter()
            .map(|start| ArmUnit::new(config, start))
            .collect();
        let flap = scenery.flap.as_ref();
        Self {
            stage: Stage::new(config, scenery, arms.len()),
            drape: flap.map(|flap| Drape::new(flap, &scenery.ground, &arms)),
            arms,
        }
    }

    /// How many arms there are. Functions that take the number of an arm or a thing panic if there
    /// is none.
    #[must_use]
    pub const fn arm_count(&self) -> usize {
        self.arms.len()
    }

    /// What the sensors of an arm say now; see [`crate::plant::Plant::measured`].
    #[must_use]
    pub fn measured(&self, arm: usize, stamp: TimeNs) -> ArmState {
        self.arms[arm].measured(stamp)
    }

    /// Takes a setpoint for an arm, which holds until the next one. Before the first the arm holds
    /// its initial position.
    pub fn command(&mut self, arm: usize, command: &ArmCommand) {
        self.arms[arm].command(command);
    }

    /// Takes set-points for the drives of an arm that are commanded one by one, which hold until
    /// the next ones.
    pub fn lead(&mut self, arm: usize, setpoint: &DriveSetpoint) {
        self.arms[arm].lead(setpoint);
    }

    /// Position and velocity that an arm's drives follow, and whether they are enabled; see
    /// [`crate::plant::Plant::setpoint`].
    #[must_use]
    pub fn setpoint(&self, arm: usize) -> (AxisVector, AxisVector, bool) {
        self.arms[arm].setpoint()
    }

    /// Advances exactly one millisecond.
    pub fn step(&mut self) {
        self.stage.step(&mut self.arms);
        if let Some(drape) = &mut self.drape {
            drape.step(&self.arms);
            for (index, arm) in self.arms.iter_mut().enumerate() {
                arm.feel(&drape.wrenches(index));
            }
        }
    }

    /// How many things there are.
    #[must_use]
    pub const fn thing_count(&self) -> usize {
        self.stage.thing_count()
    }

    /// True pose of a thing's frame in the scene.
    #[must_use]
    pub fn thing_in_scene(&self, thing: usize) -> Pose {
        self.stage.thing(thing).pose
    }

    /// Linear (m/s, of the centre of mass) and angular velocity (rad/s) of a thing in the scene.
    #[must_use]
    pub fn thing_velocity(&self, thing: usize) -> [Vector3<f64>; 2] {
        self.stage.thing(thing).velocity
    }

    /// Makes a thing slide along the ground, as a tug at a thread would: sets its velocity along
    /// the scene's x and y, m/s, and about z, rad/s, and leaves the rest of its motion as it is.
    pub fn nudge(&mut self, thing: usize, velocity_m_s: [f64; 2], turn_rad_s: f64) {
        let [mut linear, mut angular] = self.thing_velocity(thing);
        [linear.x, linear.y] = velocity_m_s;
        angular.z = turn_rad_s;
        self.stage.throw(thing, &[linear, angular]);
    }

    /// Wakes a sleeping thing, for as long as one that just came to rest stays awake.
    pub fn wake(&mut self, thing: usize) {
        self.stage.wake(thing);
    }

    /// Kinetic energy of a thing and its potential energy over the scene's xy-plane, J.
    #[must_use]
    pub fn energy_j(&self, thing: usize) -> f64 {
        self.stage.energy_j(thing)
    }

    /// Whether fingers or wrist of an arm touched a thing in the newest step.
    #[must_use]
    pub fn is_touched(&self, arm: usize, thing: usize) -> bool {
        let touch = self.stage.touch(arm, thing);
        touch.iter().any(|part| part.force_n > 0.0)
    }

    /// Largest penetration depth of a thing and the ground in the newest step, m.
    #[must_use]
    pub fn sunk_m(&self, thing: usize) -> f64 {
        self.stage.sunk_m(thing)
    }

    /// True pose of an arm's tip frame in the scene, from the simulator's own chain.
    #[must_use]
    pub fn tip_in_scene(&self, arm: usize) -> Pose {
        self.arms[arm].chain.tip
    }

    /// Where to draw an arm's instrument.
    #[must_use]
    pub fn body_poses(&self, arm: usize) -> ArmBodies {
        self.arms[arm].bodies()
    }

    /// Sum of the normal contact forces between the ground and an arm's instrument in the newest
    /// step, N.
    #[must_use]
    pub fn ground_force_n(&self, arm: usize) -> f64 {
        self.stage.ground_force_n(arm)
    }

    /// Sum of the normal contact forces between the ground and a thing in the newest step, N; its
    /// weight included.
    #[must_use]
    pub fn thing_ground_force_n(&self, thing: usize) -> f64 {
        self.stage.thing_ground_force_n(thing)
    }

    /// Contact between the fingers of an arm and a thing in the newest step.
    #[must_use]
    pub fn grasp(&self, arm: usize, thing: usize) -> Grasp {
        let [left, right, _] = self.stage.touch(arm, thing);
        Grasp {
            left_force_n: left.force_n,
            right_force_n: right.force_n,
            both_touch: left.force_n > TOUCH_N && right.force_n > TOUCH_N,
            penetration_m: left.penetration_m.max(right.penetration_m),
        }
    }

    /// The soft flap, if there is one.
    #[must_use]
    pub fn tissue(&self) -> Option<&Tissue> {
        self.drape.as_ref().map(Drape::tissue)
    }

    /// What the arms are to handle, in the scene: the first thing or, where there is none, the
    /// flap's mark.
    #[must_use]
    pub fn subject_in_scene(&self) -> Pose {
        match self.tissue() {
            Some(tissue) if self.thing_count() == 0 => tissue.mark_in_scene(),
            _ => self.thing_in_scene(0),
        }
    }

    /// Contact between the fingers of an arm and the subject in the newest step.
    #[must_use]
    pub fn subject_grasp(&self, arm: usize) -> Grasp {
        match &self.drape {
            Some(drape) if self.thing_count() == 0 => drape.grasp(arm),
            _ => self.grasp(arm, 0),
        }
    }

    /// Largest penetration depth of the first thing and the ground in the newest step, m; 0 without
    /// a thing.
    #[must_use]
    pub fn subject_sunk_m(&self) -> f64 {
        if self.thing_count() == 0 {
            return 0.0;
        }
        self.sunk_m(0)
    }

    /// Hash of the complete state, bit by bit.
    #[must_use]
    pub fn state_hash(&self) -> u64 {
        let arms = self.arms.iter().flat_map(ArmUnit::state);
        let things = (0..self.thing_count()).flat_map(|thing| self.stage.thing(thing).state());
        let tissue = self.drape.iter().flat_map(Drape::state);
        let rigid = arms.chain(self.stage.memory_numbers()).chain(things);
        let numbers = rigid.chain(tissue);
        // FNV-1a over 64-bit words.
        numbers.fold(0xcbf2_9ce4_8422_2325, |hash, number| {
            (hash ^ number.to_bits()).wrapping_mul(0x0000_0100_0000_01b3)
        })
    }
}

#[cfg(test)]
mod tests;
