//! The simulated world of one arm: drives, instrument, needle and tissue, a millisecond at a time.

mod chain;
mod config;
mod convert;
mod press;
mod solids;
mod stage;
mod stick;

use hal::{ArmCommand, ArmState, JOINT_COUNT, JointVector, Pose, TimeNs};
use nalgebra::{Point3, Vector3};

use crate::needle::NeedleShape;
use crate::organ::OrganShape;
use crate::plant::{AXIS_COUNT, AxisVector, Load, Plant};
use chain::Chain;
use stage::{PartPoses, Stage, TOUCH_N};

pub use config::{Press, Surface, WorldConfig};

/// One arm over one needle on one organ.
///
/// The instrument's parts go where the drives take them and push the needle out of their way; what the needle and the
/// tissue push back reaches the drives as joint efforts in the next millisecond. The drives' reflected inertia is
/// thousands of times the needle's mass, which is what makes that exchange stable. Nothing ever attaches the needle: it
/// is held by friction or not at all.
pub struct World {
    config: WorldConfig,
    organ: OrganShape,
    scene_from_rcm: Pose,
    plant: Plant,
    chain: Chain,
    stage: Stage,
    pressing: Pressing,
    load: Load,
}

/// Poses of the instrument's parts in the scene frame, for drawing.
#[derive(Clone, Copy, Debug)]
pub struct ArmBodies {
    /// Shaft: origin on the wrist-pitch axis, the shaft behind it along -z.
    pub shaft: Pose,
    /// Wrist: origin on the wrist-pitch axis, the wrist-yaw axis at x = 9.1 mm.
    pub wrist: Pose,
    /// Left finger: origin on the wrist-yaw axis, z along the finger, inner face in the xz-plane, body at y > 0.
    pub finger_left: Pose,
    /// Right finger: like the left one with its body at y < 0.
    pub finger_right: Pose,
}

/// What the fingers feel of the needle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Grasp {
    /// Sum of normal forces on the left finger, N.
    pub left_force_n: f64,
    /// Sum of normal forces on the right finger, N.
    pub right_force_n: f64,
    /// Whether both fingers press on the needle.
    pub both_touch: bool,
    /// Deepest overlap of a finger and the needle, m.
    pub penetration_m: f64,
}

/// Sample points of the instrument and what the tissue does to them, for each part.
struct Pressing {
    left: [Point3<f64>; 5],
    right: [Point3<f64>; 5],
    wrist: [Point3<f64>; 2],
}

impl World {
    /// An arm at rest at `joints0` with its jaw at `jaw0`, and a needle at `needle_in_scene0`, which must not overlap
    /// the fingers.
    #[must_use]
    pub fn new(
        config: &WorldConfig,
        needle: &NeedleShape,
        organ: &OrganShape,
        scene_from_rcm: Pose,
        joints0: JointVector,
        jaw0: f64,
        needle_in_scene0: Pose,
    ) -> Self {
        let chain = Chain::new(&scene_from_rcm, &joints0);
        let stage = Stage::new(
            config,
            needle,
            organ,
            &needle_in_scene0,
            &part_poses(&chain, jaw0),
        );
        Self {
            config: *config,
            organ: *organ,
            scene_from_rcm,
            plant: Plant::new(&config.plant, &joints0, jaw0),
            pressing: Pressing::new(&chain, jaw0),
            load: Load {
                efforts: [0.0; AXIS_COUNT],
                squeeze_damping: config.squeeze_damping_n_m_s,
            },
            chain,
            stage,
        }
    }

    /// What the arm's sensors say now; see [`Plant::measured`].
    #[must_use]
    pub fn measured(&self, stamp: TimeNs) -> ArmState {
        self.plant.measured(stamp)
    }

    /// Takes a setpoint, which holds until the next one. Before the first the arm holds its initial position.
    pub fn command(&mut self, command: &ArmCommand) {
        self.plant.command(command);
    }

    /// The setpoint that the drives follow; see [`Plant::setpoint`].
    #[cfg(test)]
    pub(crate) fn setpoint(&self) -> (AxisVector, AxisVector, bool) {
        self.plant.setpoint()
    }

    /// Advances exactly one millisecond.
    pub fn step(&mut self) {
        self.plant.step(&self.load);
        let joints = self.plant.joints();
        let jaw = joints[JOINT_COUNT];
        self.chain = Chain::new(
            &self.scene_from_rcm,
            &JointVector::from_column_slice(&joints[..JOINT_COUNT]),
        );
        self.stage.step(
            &part_poses(&self.chain, jaw),
            &self.chain.tip.translation.vector,
        );
        self.load.efforts = self.joint_load(jaw);
    }

    /// True pose of the needle frame in the scene.
    #[must_use]
    pub fn needle_in_scene(&self) -> Pose {
        self.stage.needle_in_scene()
    }

    /// Linear (m/s, of the centre of mass) and angular velocity (rad/s) of the needle in the scene.
    #[must_use]
    pub fn needle_velocity(&self) -> [Vector3<f64>; 2] {
        self.stage.needle_velocity()
    }

    /// True pose of the tip frame in the scene, from the simulator's own chain.
    #[must_use]
    pub fn tip_in_scene(&self) -> Pose {
        self.chain.tip
    }

    /// Where to draw the instrument.
    #[must_use]
    pub fn body_poses(&self) -> ArmBodies {
        let jaw = self.plant.joints()[JOINT_COUNT];
        ArmBodies {
            shaft: self.chain.frames[3],
            wrist: self.chain.frames[4],
            finger_left: self.chain.finger(jaw, 1.0),
            finger_right: self.chain.finger(jaw, -1.0),
        }
    }

    /// What the fingers felt of the needle in the newest step.
    #[must_use]
    pub fn grasp(&self) -> Grasp {
        let [left, right, _] = self.stage.touches();
        Grasp {
            left_force_n: left.force_n,
            right_force_n: right.force_n,
            both_touch: left.force_n > TOUCH_N && right.force_n > TOUCH_N,
            penetration_m: left.penetration_m.max(right.penetration_m),
        }
    }

    /// Digest of every number that decides the future, bit by bit.
    #[must_use]
    pub fn state_hash(&self) -> u64 {
        let needle = self.needle_in_scene();
        let q = needle.rotation.quaternion().coords;
        let [linear, angular] = self.needle_velocity();
        let vectors = [needle.translation.vector, linear, angular];
        let numbers = self
            .plant
            .state()
            .chain(self.load.efforts)
            .chain(self.stage.memory_numbers());
        let numbers = numbers
            .chain(q.iter().copied())
            .chain(vectors.iter().flat_map(|v| v.iter().copied()));
        // FNV-1a over 64-bit words.
        numbers.fold(0xcbf2_9ce4_8422_2325, |hash, number| {
            (hash ^ number.to_bits()).wrapping_mul(0x0000_0100_0000_01b3)
        })
    }

    /// Joint efforts of everything that pushes at the instrument, jaw last.
    fn joint_load(&mut self, jaw: f64) -> AxisVector {
        let centre = self.chain.tip.translation.vector;
        let now = Pressing::new(&self.chain, jaw);
        let before = core::mem::replace(&mut self.pressing, now);
        let press = |points: &[Point3<f64>], before: &[Point3<f64>]| {
            press::pressed(&self.config.press, &self.organ, points, before, &centre)
        };
        let mut left = press(&self.pressing.left, &before.left);
        let mut right = press(&self.pressing.right, &before.right);
        let mut all = press(&self.pressing.wrist, &before.wrist);
        let touches = self.stage.touches();
        left.add(&touches[0].wrench);
        right.add(&touches[1].wrench);
        all.add(&touches[2].wrench);
        let hinge = self.chain.tip.rotation * Vector3::x();
        // Opening turns the left finger by -1/2 about the hinge and the right one by +1/2.
        let jaw_effort = 0.5 * hinge.dot(&(right.moment - left.moment));
        all.add(&left);
        all.add(&right);
        let joints = self.chain.joint_efforts(&all);
        core::array::from_fn(|axis| {
            if axis < JOINT_COUNT {
                joints[axis]
            } else {
                jaw_effort
            }
        })
    }
}

impl Pressing {
    fn new(chain: &Chain, jaw: f64) -> Self {
        Self {
            left: press::finger_points(&chain.finger(jaw, 1.0), 1.0),
            right: press::finger_points(&chain.finger(jaw, -1.0), -1.0),
            wrist: press::wrist_points(&chain.frames[4], &chain.tip),
        }
    }
}

fn part_poses(chain: &Chain, jaw: f64) -> PartPoses {
    [
        chain.finger(jaw, 1.0),
        chain.finger(jaw, -1.0),
        chain.frames[4],
    ]
}

#[cfg(test)]
mod tests;
